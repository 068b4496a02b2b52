//! Files that are read as a whole.

use std::path::Path;

use crate::error::{Error, Result};

/// The bytes of a file of at most `most` bytes. Folders, devices and pipes are refused: one of them may never end.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for what is no file, or a larger one.
pub fn read(path: &Path, most: usize) -> Result<Vec<u8>> {
    check(path, most)?;
    std::fs::read(path).map_err(|e| Error::io(path, "read", e))
}

/// Refuses what [`read`] refuses.
///
/// # Errors
/// As [`read`].
pub fn check(path: &Path, most: usize) -> Result<()> {
    let about = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if about.is_dir() {
        return Err(Error::io(path, "read", std::io::ErrorKind::IsADirectory.into()));
    }
    if !about.is_file() {
        return Err(Error::parse(
            path,
            0,
            "is no regular file; save what it gives to a file first",
        ));
    }
    if about.len() > most as u64 {
        let message =
            format!("has {} bytes; at most {most} are read from such a file", about.len());
        return Err(Error::parse(path, 0, message));
    }
    Ok(())
}

/// As [`read`], for text in UTF-8.
///
/// # Errors
/// As [`read`]; [`Error::Parse`] with the line of what is no text.
pub fn read_text(path: &Path, most: usize) -> Result<String> {
    String::from_utf8(read(path, most)?).map_err(|e| {
        let valid = e.utf8_error().valid_up_to();
        let line = 1 + e.as_bytes()[..valid].iter().filter(|&&b| b == b'\n').count();
        Error::parse(path, line, "not UTF-8 text; save the file as plain text in UTF-8")
    })
}
