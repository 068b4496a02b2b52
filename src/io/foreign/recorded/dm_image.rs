//! Reads images of DigitalMicrograph's files (DM3, DM4).

use std::path::Path;

use ndarray::Array2;

use super::dm_tags::{DmArray, DmFile, DmTag, Tagged};
use super::{ImageChoice, RecordedFormat, RecordedImage, frame_of};
use crate::error::Result;
use crate::io::foreign::arrays::{NumberType, choose, held};
use crate::io::foreign::length_units::square_nm;

/// Number of values that are decoded at a time, so that a large image is not in memory twice.
const VALUES_AT_ONCE: u64 = 1 << 20;
/// Code of the values of thumbnails.
const COLOURS: f64 = 23.0;

/// An image of a file, before its values are read.
struct DmImage {
    name: String,
    /// Numbers of columns and rows, and the lengths of further axes.
    lengths: Vec<usize>,
    /// Code of the kind of its values.
    kind: f64,
    data: Option<DmArray>,
    tags: DmTag,
}

/// Reads an image.
///
/// # Errors
/// [`crate::Error::Io`]; [`crate::Error::Parse`] for a damaged file, and values that are no real numbers;
/// [`crate::Error::Choice`] where there are several images or frames.
pub(super) fn read(path: &Path, choice: &ImageChoice) -> Result<RecordedImage> {
    let mut file = DmFile::open(path)?;
    let tree = file.tree().map_err(|reason| file.refused(path, &reason))?;
    let mut images = images(&tree, &mut file);
    let names: Vec<String> = images.iter().map(|image| image.name.clone()).collect();
    let asked = choice.dataset.as_ref().filter(|name| names.contains(name));
    let name = match asked {
        // An image that is named, or the only one, is read even if its values are refused: the error then gives the reason.
        Some(name) => name.clone(),
        None => {
            let grey = |image: &&DmImage| number_type(image.kind, false).is_ok();
            let offered: Vec<String> = match images.len() {
                1 => names.clone(),
                _ => images.iter().filter(grey).map(|image| image.name.clone()).collect(),
            };
            choose(path, &offered, choice.dataset.as_deref())?.to_owned()
        }
    };
    let at = names.iter().position(|n| *n == name).unwrap_or(0);
    let mut image = images.swap_remove(at);
    while image.lengths.len() > 2 && image.lengths.last() == Some(&1) {
        image.lengths.pop();
    }
    let refuse = |file: &DmFile, reason: &str| Err(file.refused(path, reason));
    let (columns, rows, frames) = match image.lengths[..] {
        [columns, rows] => (columns, rows, 1),
        [columns, rows, frames] => (columns, rows, frames),
        ref other => {
            let found = format!("`{name}` has the lengths {other:?}; an image has two axes");
            return refuse(&file, &found);
        }
    };
    let frame = frame_of(path, &name, frames, choice.index)?;
    let pixels = image.frame([rows, columns], frame, &mut file);
    let pixels = match pixels {
        Ok(pixels) => pixels,
        Err(reason) => return refuse(&file, &format!("`{name}` {reason}")),
    };
    let side = |axis: &str, file: &mut DmFile| {
        let axis = image.tags.get(&["ImageData", "Calibrations", "Dimension", axis]);
        let scale = axis.and_then(|axis| axis.number(&["Scale"])).unwrap_or(0.0);
        (scale, file.text(axis.and_then(|axis| axis.get(&["Units"]))).unwrap_or_default())
    };
    let (x, y) = (side("#0", &mut file), side("#1", &mut file));
    let voltage = image.tags.number(&["ImageTags", "Microscope Info", "Voltage"]);
    let signal = image.tags.get(&["ImageTags", "DataBar", "Signal Name"]);
    Ok(RecordedImage {
        path: path.to_owned(),
        format: if file.is_dm4 { RecordedFormat::Dm4 } else { RecordedFormat::Dm3 },
        name,
        pixels,
        pixel_nm: square_nm([(x.0, &x.1), (y.0, &y.1)]),
        cells: None,
        energy_kev: voltage.map(|v| v * 1e-3).filter(|v| v.is_finite() && *v > 0.0),
        detector: file.text(signal).filter(|name| !name.is_empty()),
        notes: Vec::new(),
    })
}

/// Returns the images without thumbnails.
fn images(tree: &DmTag, file: &mut DmFile) -> Vec<DmImage> {
    let Some(list) = tree.get(&["ImageList"]) else { return Vec::new() };
    let thumbnails: Vec<f64> = match tree.get(&["Thumbnails"]) {
        Some(thumbnails) => {
            thumbnails.entries().filter_map(|t| t.number(&["ImageIndex"])).collect()
        }
        None => Vec::new(),
    };
    let mut images: Vec<DmImage> = Vec::new();
    for (number, tags) in list.entries().enumerate() {
        let kind = tags.number(&["ImageData", "DataType"]).unwrap_or(0.0);
        // Files without a list of thumbnails begin with a thumbnail.
        let first = thumbnails.is_empty() && number == 0 && kind == COLOURS;
        if thumbnails.contains(&(number as f64)) || first {
            continue;
        }
        let stated = file.text(tags.get(&["Name"])).filter(|name| !name.is_empty());
        let mut name = stated.unwrap_or_else(|| format!("image {number}"));
        if images.iter().any(|image| image.name == name) {
            name += &format!(" {number}");
        }
        let lengths = tags.get(&["ImageData", "Dimensions"]);
        let lengths = lengths.into_iter().flat_map(DmTag::entries);
        let length = |tag: &DmTag| tag.number(&[]).map_or(0, |n| n as usize);
        let data = match tags.get(&["ImageData", "Data"]) {
            Some(DmTag::Array(array)) => Some(*array),
            _ => None,
        };
        images.push(DmImage {
            name,
            lengths: lengths.map(length).collect(),
            kind,
            data,
            tags: tags.clone(),
        });
    }
    images
}

impl DmImage {
    /// Reads the values of one frame, [row, column].
    fn frame(
        &self,
        [rows, columns]: [usize; 2],
        frame: usize,
        file: &mut DmFile,
    ) -> Tagged<Array2<f64>> {
        let number = number_type(self.kind, file.big_endian())?;
        let values = held(&[rows, columns])? as u64;
        let size = number.bytes as u64;
        let data = self.data.ok_or("has no values")?;
        let frames = self.lengths.iter().skip(2).map(|n| *n as u64);
        let announced = frames.chain([values, size]).try_fold(1_u64, u64::checked_mul);
        let stored = data.count.checked_mul(data.entry_bytes);
        if announced.is_none() || announced != stored || data.code == 0 {
            return Err(format!(
                "has the lengths {:?} of {size} bytes each, and {} values of {} bytes",
                self.lengths, data.count, data.entry_bytes
            ));
        }
        let mut at = data.at + frame as u64 * values * size;
        let end = at + values * size;
        let mut decoded = Vec::with_capacity(rows * columns);
        while at < end {
            let length = (end - at).min(size * VALUES_AT_ONCE);
            let bytes = file.part(at, length)?;
            decoded.extend(bytes.chunks_exact(number.bytes).map(|b| number.decode(b)));
            at += length;
        }
        Array2::from_shape_vec((rows, columns), decoded).map_err(|e| e.to_string())
    }
}

/// Returns the type of an image's values.
fn number_type(kind: f64, big_endian: bool) -> Tagged<NumberType> {
    let name = match kind as i64 {
        1 => "int16",
        2 => "float32",
        6 | 14 => "uint8",
        7 => "int32",
        9 => "int8",
        10 => "uint16",
        11 => "uint32",
        12 => "float64",
        39 => "int64",
        40 => "uint64",
        3 | 5 | 13 => {
            return Err("holds complex numbers (a Fourier transform, perhaps); expected grey values: save its \
                        modulus, or the image itself"
                .into());
        }
        8 | 23 => {
            return Err(
                "holds colours; expected grey values: save the image before it was coloured".into(),
            );
        }
        other => return Err(format!("holds values of kind {other}, which is not known")),
    };
    NumberType::named(name, big_endian).ok_or_else(|| format!("holds {name}"))
}
