//! NumPy's `.npz`: named arrays in one file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use ndarray_npy::WriteNpyExt;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::error::{Error, Result};
use crate::files::atomic_write;

/// Writes an `.npz`, array by array.
pub struct NpzWriter {
    zip: ZipWriter<BufWriter<File>>,
}

impl NpzWriter {
    /// Adds an array; `numpy.load` has it under this name.
    ///
    /// # Errors
    /// [`Error::Io`] of what could not be written.
    pub fn add<T: WriteNpyExt>(&mut self, name: &str, array: &T) -> std::io::Result<()> {
        let options = SimpleFileOptions::default().large_file(true);
        let mut bytes = Vec::new();
        array.write_npy(&mut bytes).map_err(std::io::Error::other)?;
        self.zip.start_file(format!("{name}.npy"), options).map_err(std::io::Error::other)?;
        self.zip.write_all(&bytes)
    }
}

/// Writes an `.npz` that `fill` adds arrays to. It appears complete or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_npz(
    path: &Path,
    overwrite: bool,
    fill: impl FnOnce(&mut NpzWriter) -> std::io::Result<()>,
) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| {
        let fail = |e| Error::io(path, "write", e);
        let file = File::create(temporary).map_err(fail)?;
        let mut npz = NpzWriter { zip: ZipWriter::new(BufWriter::new(file)) };
        fill(&mut npz).map_err(fail)?;
        let done = npz.zip.finish().map_err(|e| fail(std::io::Error::other(e)))?;
        done.into_inner().map_err(|e| fail(e.into_error()))?;
        Ok(())
    })
}
