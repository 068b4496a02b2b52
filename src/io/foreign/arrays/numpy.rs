//! Reads NumPy's `.npy` (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>) and `.npz`.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use ndarray::{ArrayD, IxDyn, ShapeBuilder};
use zip::ZipArchive;

use super::number_type::NumberType;
use super::{ForeignArray, choose, held, nameless};
use crate::error::{Error, Result};

/// Largest size of a header in bytes; NumPy writes 128.
const LONGEST_HEADER: usize = 1 << 16;
/// Number of values that are decoded at a time.
const VALUES_AT_ONCE: usize = 1 << 16;

type Decoded<T> = std::result::Result<T, String>;

pub fn read_npy(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    nameless(path, name)?;
    let file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let bytes = file.metadata().map_err(|e| Error::io(path, "read", e))?.len();
    let data =
        decode(BufReader::new(file), bytes).map_err(|reason| unreadable(path, "array", &reason))?;
    Ok(ForeignArray::plain(path, "", data))
}

pub fn read_npz(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    let file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let refused = |reason: String| unreadable(path, "archive of arrays", &reason);
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|e| refused(e.to_string()))?;
    let mut names = Vec::new();
    let mut places = Vec::new();
    for i in 0..archive.len() {
        let Ok(mut entry) = archive.by_index(i) else { continue };
        let Ok(name) = entry.name().map(|name| key(&name)) else { continue };
        if NpyHeader::read(&mut entry).is_ok_and(|header| header.shape.len() >= 2) {
            names.push(name);
            places.push(i);
        }
    }
    let chosen = choose(path, &names, name)?.to_owned();
    let at = names.iter().position(|n| *n == chosen).unwrap_or(0);
    let data = entry(&mut archive, places[at]).map_err(refused)?;
    Ok(ForeignArray::plain(path, &chosen, data))
}

/// Returns the arrays of real numbers in an `.npz`, with their names; dimensions in the order of the file.
///
/// # Errors
/// The reason, for any bytes that are no archive.
pub fn unpack(bytes: &[u8]) -> Decoded<Vec<(String, ArrayD<f64>)>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let mut arrays = Vec::new();
    for i in 0..archive.len() {
        let found = archive.by_index(i).map_err(|e| e.to_string())?;
        let name = key(&found.name().map_err(|e| e.to_string())?);
        drop(found);
        if let Ok(data) = entry(&mut archive, i) {
            arrays.push((name, data));
        }
    }
    Ok(arrays)
}

fn key(name: &str) -> String {
    name.trim_end_matches(".npy").to_owned()
}

fn entry<R: Read + Seek>(archive: &mut ZipArchive<R>, index: usize) -> Decoded<ArrayD<f64>> {
    let entry = archive.by_index(index).map_err(|e| e.to_string())?;
    let bytes = entry.size();
    decode(entry, bytes)
}

fn unreadable(path: &Path, kind: &str, reason: &str) -> Error {
    Error::parse(
        path,
        0,
        format!("is no NumPy {kind} of real numbers ({})", reason.replace("error: ", "")),
    )
}

/// Header of an array, before its values.
#[derive(Debug, PartialEq)]
struct NpyHeader {
    number: NumberType,
    fortran: bool,
    shape: Vec<usize>,
    /// Number of bytes of the header.
    bytes: u64,
}

impl NpyHeader {
    fn read(from: &mut impl Read) -> Decoded<Self> {
        let mut start = [0; 8];
        from.read_exact(&mut start).map_err(|e| e.to_string())?;
        if &start[..6] != b"\x93NUMPY" {
            return Err("it does not begin with the mark of NumPy".into());
        }
        let mut size = [0; 4];
        let size_bytes = if start[6] == 1 { 2 } else { 4 };
        from.read_exact(&mut size[..size_bytes]).map_err(|e| e.to_string())?;
        let length = u32::from_le_bytes(size) as usize;
        if length > LONGEST_HEADER {
            return Err(format!(
                "its header announces {length} bytes, and at most {LONGEST_HEADER} are read"
            ));
        }
        let mut text = vec![0; length];
        from.read_exact(&mut text).map_err(|e| e.to_string())?;
        let text = String::from_utf8(text).map_err(|_| "its header is no text")?;
        Self::parse(&text, (8 + size_bytes + length) as u64).ok_or_else(|| {
            format!("its header is {}", text.trim().chars().take(120).collect::<String>())
        })
    }

    /// Reads `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`.
    fn parse(text: &str, bytes: u64) -> Option<Self> {
        let after = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}'"))?;
            rest.trim_start().strip_prefix(':').map(str::trim_start)
        };
        let description = after("descr")?.strip_prefix('\'')?.split('\'').next()?;
        let order = after("fortran_order")?;
        let fortran = order.starts_with("True");
        if !fortran && !order.starts_with("False") {
            return None;
        }
        let (shape, _) = after("shape")?.strip_prefix('(')?.split_once(')')?;
        let lengths = shape.split(',').map(str::trim).filter(|length| !length.is_empty());
        let shape = lengths.map(|length| length.parse().ok()).collect::<Option<_>>()?;
        Some(NpyHeader { number: NumberType::described(description)?, fortran, shape, bytes })
    }
}

/// Decodes an array of any type of real number, from a file of `file_bytes` bytes.
fn decode(mut from: impl Read, file_bytes: u64) -> Decoded<ArrayD<f64>> {
    let header = NpyHeader::read(&mut from)?;
    let count = held(&header.shape)?;
    let (size, there) = (header.number.bytes, file_bytes.saturating_sub(header.bytes));
    if there != (count * size) as u64 {
        return Err(format!(
            "its header announces {:?} values of {size} bytes, and {there} bytes follow",
            header.shape
        ));
    }
    let mut values = Vec::with_capacity(count);
    let mut packed = vec![0; size * VALUES_AT_ONCE.min(count)];
    while values.len() < count {
        let part = &mut packed[..size * VALUES_AT_ONCE.min(count - values.len())];
        from.read_exact(part).map_err(|e| e.to_string())?;
        values.extend(part.chunks_exact(size).map(|number| header.number.decode(number)));
    }
    let shape = IxDyn(&header.shape).set_f(header.fortran);
    ArrayD::from_shape_vec(shape, values).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, values: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values);
        bytes
    }

    fn read(bytes: &[u8]) -> Decoded<ArrayD<f64>> {
        decode(bytes, bytes.len() as u64)
    }

    #[test]
    fn both_orders_are_read() {
        let values: Vec<u8> = [1_i16, 2, 3, 4, 5, 6].iter().flat_map(|v| v.to_le_bytes()).collect();
        let of = |fortran: &str| {
            let header =
                format!("{{'descr': '<i2', 'fortran_order': {fortran}, 'shape': (2, 3), }}\n");
            read(&file(&header, &values)).unwrap()
        };
        assert_eq!(of("False"), ndarray::arr2(&[[1., 2., 3.], [4., 5., 6.]]).into_dyn());
        assert_eq!(of("True"), ndarray::arr2(&[[1., 3., 5.], [2., 4., 6.]]).into_dyn());
    }

    #[test]
    fn headers_are_held_against_the_file() {
        let message = |shape: &str, values: usize| {
            let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
            read(&file(&header, &vec![0; values])).unwrap_err()
        };
        // Files of 128 bytes that claim 20 GB, and axes of length 0 that hide others.
        assert!(message("(50000, 50000)", 40).contains("at most"));
        assert!(message("(1099511627776, 0, 1099511627776)", 0).contains("at most"));
        assert!(message("(18446744073709551615, 3)", 0).contains("at most"));
        assert!(message("(99999999999999999999999, 3)", 0).contains("its header is"));
        assert!(message("(3, 4)", 95).contains("95 bytes follow"));
        assert!(message("(3, 4)", 97).contains("97 bytes follow"));
        assert!(message(&"(".repeat(60_000), 0).contains("its header is"));
        let mut long = file("", &[]);
        (long[6], long[8], long[9]) = (2, 255, 255);
        long.extend([255, 255]);
        assert!(read(&long).unwrap_err().contains("at most"), "{:?}", read(&long));
    }
}
