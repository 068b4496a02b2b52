//! Reads TIFF.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use ndarray::{ArrayD, IxDyn};
use tiff::ColorType;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::tiff_calibration::{self, Resolution};
use super::{
    ArrayAxis, ForeignArray, MOST_VALUES, abtem_metadata, held, nameless, tiff_descriptions,
};
use crate::error::{Error, Result};

/// Largest number of pixels per byte of a file: LZW and deflate pack up to some thousands of equal pixels into one.
const LARGEST_EXPANSION: u64 = 4096;

/// Largest size in bytes of the stored values of a page.
const LARGEST_PAGE_BYTES: usize = 8 * MOST_VALUES;
/// Codes: of a photometric interpretation whose zero is white, and of sample formats.
const WHITE_IS_ZERO: u16 = 0;
const UNSIGNED: u16 = 1;
const COMPLEX_FORMATS: [u16; 2] = [5, 6];

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
    let limits = {
        let mut limits = Limits::default();
        limits.decoding_buffer_size = LARGEST_PAGE_BYTES;
        // A page may consist of one strip.
        limits.intermediate_buffer_size = LARGEST_PAGE_BYTES;
        limits
    };
    let decoder = Decoder::new(BufReader::new(file)).map_err(bad)?;
    let mut decoder = decoder.with_limits(limits);
    let resolution = resolution(&mut decoder);
    let inverted = photometric(&mut decoder) == Some(WHITE_IS_ZERO);
    let (mut pages, mut values, mut shape) = (0, Vec::new(), (0, 0));
    loop {
        let page = page(&mut decoder, bytes).map_err(bad)?;
        let (size, content) = match page {
            TiffPage::Grey(size, content) => (size, content),
            TiffPage::Refused(reason) => return Err(Error::parse(path, 0, reason)),
        };
        held(&[pages + 1, size.1 as usize, size.0 as usize])
            .map_err(|reason| Error::parse(path, 0, reason))?;
        if pages > 0 && size != shape {
            return Err(Error::parse(path, 0, "holds images of different sizes"));
        }
        shape = size;
        // The values of a large image are moved, not copied.
        if pages == 0 {
            values = content
        } else {
            values.extend(content)
        }
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
    if inverted {
        array.notes.push("the file says that its zero is white: values count from black".into());
    }
    describe(&mut array, &tiff_descriptions::all(path), resolution);
    Ok(array)
}

/// Copies the calibration from the descriptions and the resolution. Only abTEM names axes.
fn describe(array: &mut ForeignArray, descriptions: &[String], resolution: Resolution) {
    let parsed = descriptions.iter().filter_map(|text| serde_json::from_str(text).ok());
    if let Some(metadata) = parsed.into_iter().find(abtem_metadata::describes) {
        abtem_metadata::describe(array, &metadata);
        return;
    }
    match tiff_calibration::sides(descriptions, resolution) {
        Ok([x, y]) => {
            let pages = array.data.ndim().saturating_sub(2);
            let side = |side| ArrayAxis { sampling_angstrom: Some(side), ..ArrayAxis::default() };
            let pages = std::iter::repeat_n(ArrayAxis::default(), pages);
            array.axes = Some(pages.chain([side(y), side(x)]).collect());
        }
        Err(why) => array.pixel_unsaid = why,
    }
}

fn photometric<R: Read + Seek>(decoder: &mut Decoder<R>) -> Option<u16> {
    decoder.find_tag_unsigned(Tag::PhotometricInterpretation).ok().flatten()
}

fn resolution<R: Read + Seek>(decoder: &mut Decoder<R>) -> Resolution {
    let mut side = |tag| match decoder.find_tag(tag).ok()?? {
        Value::Rational(n, d) => Some(f64::from(n) / f64::from(d)),
        _ => None,
    };
    let sides = side(Tag::XResolution).zip(side(Tag::YResolution));
    let per_unit = sides.map(|(x, y)| [x, y]).filter(|sides| sides.iter().all(|s| *s > 0.0));
    let unit = decoder.find_tag_unsigned(Tag::ResolutionUnit).ok().flatten();
    Resolution { per_unit, unit }
}

/// A page of a TIFF after decoding.
enum TiffPage {
    /// Width and height, and the values.
    Grey((u32, u32), Vec<f64>),
    /// Reason for refusing the page.
    Refused(&'static str),
}

const COLOURS: &str = "holds colours; expected grey values. tifffile takes a last axis of 3 or 4 for \
                       colours: save one image at a time, or photometric=\"minisblack\"";
const COMPLEX: &str =
    "holds complex numbers; expected grey values: save their modulus, or the image itself";
const WHITE_FRACTIONS: &str = "says that its zero is white (PhotometricInterpretation 0), of values that have no \
                               black: only unsigned whole numbers have; save it with photometric=\"minisblack\"";

/// Decodes the current page.
fn page<R: Read + Seek>(decoder: &mut Decoder<R>, file_bytes: u64) -> tiff::TiffResult<TiffPage> {
    let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat)?.unwrap_or_default();
    if formats.iter().any(|format| COMPLEX_FORMATS.contains(format)) {
        return Ok(TiffPage::Refused(COMPLEX));
    }
    if !matches!(decoder.colortype()?, ColorType::Gray(_)) {
        return Ok(TiffPage::Refused(COLOURS));
    }
    if photometric(decoder) == Some(WHITE_IS_ZERO)
        && formats.iter().any(|format| *format != UNSIGNED)
    {
        return Ok(TiffPage::Refused(WHITE_FRACTIONS));
    }
    let size = decoder.dimensions()?;
    let announced = u64::from(size.0) * u64::from(size.1);
    if announced > file_bytes.saturating_mul(LARGEST_EXPANSION) {
        let reason = "its header announces more pixels than it can hold";
        return Err(tiff::TiffError::IoError(std::io::Error::other(reason)));
    }
    if announced > MOST_VALUES as u64 {
        let (width, height) = size;
        let reason = format!("{width} x {height} pixels; at most {MOST_VALUES} are read");
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
    Ok(TiffPage::Grey(size, values))
}
