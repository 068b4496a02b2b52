//! TIFF.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use ndarray::{ArrayD, IxDyn};
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};

use super::{ForeignArray, abtem_metadata, held, nameless, tiff_descriptions};
use crate::error::{Error, Result};

/// Pixels that a byte of a file may stand for: LZW and deflate pack up to some thousands of equal ones in one.
const LARGEST_EXPANSION: u64 = 4096;

pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    nameless(path, name)?;
    let file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let bytes = file.metadata().map_err(|e| Error::io(path, "read", e))?.len();
    let bad = |e: tiff::TiffError| {
        Error::parse(
            path,
            0,
            format!("is no readable TIFF ({})", e.to_string().replace("error: ", "")),
        )
    };
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(bad)?;
    let (mut pages, mut values, mut shape) = (0, Vec::new(), (0, 0));
    loop {
        let page = page(&mut decoder, bytes).map_err(bad)?;
        let Some((size, content)) = page else {
            let message = "holds colours; expected grey values. tifffile takes a last axis of 3 or 4 for \
                           colours: save one image at a time, or photometric=\"minisblack\"";
            return Err(Error::parse(path, 0, message));
        };
        held(&[pages + 1, size.1 as usize, size.0 as usize])
            .map_err(|reason| Error::parse(path, 0, reason))?;
        if pages > 0 && size != shape {
            return Err(Error::parse(path, 0, "holds images of different sizes"));
        }
        shape = size;
        values.extend(content);
        pages += 1;
        if !decoder.more_images() {
            break;
        }
        decoder.next_image().map_err(bad)?;
    }
    let (width, height) = (shape.0 as usize, shape.1 as usize);
    let dimensions = match pages {
        1 => IxDyn(&[height, width]),
        n => IxDyn(&[n, height, width]),
    };
    let data = ArrayD::from_shape_vec(dimensions, values)
        .map_err(|e| Error::parse(path, 0, format!("is a damaged TIFF ({e})")))?;
    let mut array = ForeignArray::plain(path, "", data);
    let descriptions = tiff_descriptions::all(path);
    let told = descriptions.iter().filter_map(|text| serde_json::from_str(text).ok());
    if let Some(metadata) = told.into_iter().find(abtem_metadata::describes) {
        abtem_metadata::describe(&mut array, &metadata);
    }
    Ok(array)
}

type TiffPage = ((u32, u32), Vec<f64>);

/// Size and values of the current page; `None` for colours.
fn page<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    file_bytes: u64,
) -> tiff::TiffResult<Option<TiffPage>> {
    if !matches!(decoder.colortype()?, ColorType::Gray(_)) {
        return Ok(None);
    }
    let size = decoder.dimensions()?;
    let announced = u64::from(size.0) * u64::from(size.1);
    if announced > file_bytes.saturating_mul(LARGEST_EXPANSION) {
        let reason = "its header announces more pixels than it can hold";
        return Err(tiff::TiffError::IoError(std::io::Error::other(reason)));
    }
    macro_rules! widened {
        ($values:expr) => {
            $values.into_iter().map(|v| v as f64).collect()
        };
    }
    let values = match decoder.read_image()? {
        DecodingResult::U8(v) => widened!(v),
        DecodingResult::U16(v) => widened!(v),
        DecodingResult::U32(v) => widened!(v),
        DecodingResult::U64(v) => widened!(v),
        DecodingResult::I8(v) => widened!(v),
        DecodingResult::I16(v) => widened!(v),
        DecodingResult::I32(v) => widened!(v),
        DecodingResult::I64(v) => widened!(v),
        DecodingResult::F16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => widened!(v),
        DecodingResult::F64(v) => v,
    };
    Ok(Some((size, values)))
}
