//! Reads whole files.

use std::path::Path;

use crate::error::{Error, Result};

/// Reads the bytes of a file of at most `most` bytes. Folders, devices and pipes are refused: reading one may never end.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a path that is no file, or a larger file.
pub(crate) fn read(path: &Path, most: usize) -> Result<Vec<u8>> {
    check(path, most)?;
    std::fs::read(path).map_err(|e| Error::io(path, "read", e))
}

/// Refuses the paths that [`read`] refuses.
///
/// # Errors
/// As [`read`].
pub(crate) fn check(path: &Path, most: usize) -> Result<()> {
    let about = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if about.is_dir() {
        return Err(Error::io(path, "read", std::io::ErrorKind::IsADirectory.into()));
    }
    if !about.is_file() {
        return Err(Error::parse(path, 0, "is no regular file; save its contents to a file first"));
    }
    if about.len() > most as u64 {
        let message =
            format!("has {} bytes; at most {most} are read from a file of this kind", about.len());
        return Err(Error::parse(path, 0, message));
    }
    Ok(())
}

/// Reads a file of at most `most` bytes of text in UTF-8.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a larger file, and with the line of the first bytes that are no text.
pub fn read_text(path: &Path, most: usize) -> Result<String> {
    String::from_utf8(read(path, most)?).map_err(|e| {
        let valid = e.utf8_error().valid_up_to();
        let line = 1 + e.as_bytes()[..valid].iter().filter(|&&b| b == b'\n').count();
        Error::parse(path, line, "not UTF-8 text; save the file as plain text in UTF-8")
    })
}
