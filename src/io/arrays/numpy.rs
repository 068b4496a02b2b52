//! NumPy's `.npy` and `.npz`.

use std::io::{Cursor, Read};
use std::path::Path;

use ndarray::ArrayD;
use ndarray_npy::ReadNpyExt;

use super::{ForeignArray, choose, nameless};
use crate::error::{Error, Result};

pub fn read_npy(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    nameless(path, name)?;
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let data = decode(&bytes).map_err(|reason| unreadable(path, "array", &reason))?;
    Ok(ForeignArray::plain(path, "", data))
}

pub fn read_npz(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let arrays = unpack(&bytes).map_err(|e| unreadable(path, "archive of arrays", &e))?;
    let mut images: Vec<_> = arrays.into_iter().filter(|(_, data)| data.ndim() >= 2).collect();
    let names: Vec<String> = images.iter().map(|(key, _)| key.clone()).collect();
    let chosen = choose(path, &names, name)?;
    let at = names.iter().position(|n| n == chosen).unwrap_or(0);
    let (key, data) = images.swap_remove(at);
    Ok(ForeignArray::plain(path, &key, data))
}

/// The arrays of real numbers in an `.npz`, with their names; dimensions in the order of the file.
///
/// # Errors
/// The reason, for anything but an archive.
pub fn unpack(bytes: &[u8]) -> std::result::Result<Vec<(String, ArrayD<f64>)>, String> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let mut arrays = Vec::new();
    for i in 0..archive.len() {
        let mut entry = archive.by_index(i).map_err(|e| e.to_string())?;
        let key = entry.name().trim_end_matches(".npy").to_owned();
        let mut content = Vec::new();
        entry.read_to_end(&mut content).map_err(|e| e.to_string())?;
        if let Ok(data) = decode(&content) {
            arrays.push((key, data));
        }
    }
    Ok(arrays)
}

fn unreadable(path: &Path, kind: &str, reason: &str) -> Error {
    Error::parse(
        path,
        0,
        format!("is no NumPy {kind} of real numbers ({})", reason.replace("error: ", "")),
    )
}

/// An array of any type of real number.
fn decode(bytes: &[u8]) -> std::result::Result<ArrayD<f64>, String> {
    macro_rules! attempt {
        ($($kind:ty),*) => {
            $(if let Ok(array) = ArrayD::<$kind>::read_npy(Cursor::new(bytes)) {
                return Ok(array.mapv(|v| v as f64));
            })*
        };
    }
    let first = match ArrayD::<f64>::read_npy(Cursor::new(bytes)) {
        Ok(array) => return Ok(array),
        Err(e) => e.to_string(),
    };
    attempt!(f32, u8, u16, u32, u64, i8, i16, i32, i64);
    Err(first)
}
