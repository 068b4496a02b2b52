//! Writes NumPy's `.npz`: named arrays in one file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use ndarray::ArrayViewD;
use ndarray_npy::WriteNpyExt;
use num_complex::Complex32;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::error::{Error, Result};
use crate::files::atomic_write;

/// Writes an `.npz`, array by array.
pub struct NpzWriter {
    zip: ZipWriter<BufWriter<File>>,
}

impl NpzWriter {
    /// Adds an array; `numpy.load` returns it under this name.
    ///
    /// # Errors
    /// [`Error::Io`] if writing fails.
    pub fn add<T: WriteNpyExt>(&mut self, name: &str, array: &T) -> std::io::Result<()> {
        let mut bytes = Vec::new();
        array.write_npy(&mut bytes).map_err(std::io::Error::other)?;
        self.member(name, &bytes)
    }

    /// Adds records: `fields` is NumPy's list of names and types, `values` the bytes of one record after the other.
    ///
    /// # Errors
    /// [`Error::Io`] if writing fails.
    pub fn add_records(
        &mut self,
        name: &str,
        fields: &str,
        count: usize,
        values: &[u8],
    ) -> std::io::Result<()> {
        self.member(name, &[&head(fields, &[count])[..], values].concat())
    }

    /// Adds an array of texts.
    ///
    /// # Errors
    /// [`Error::Io`] if writing fails.
    pub fn add_texts(&mut self, name: &str, texts: &[&str]) -> std::io::Result<()> {
        let length = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
        let padded = |text: &&str| {
            let letters = text.chars().map(u32::from).chain(std::iter::repeat(0));
            letters.take(length).flat_map(u32::to_le_bytes).collect::<Vec<u8>>()
        };
        let values: Vec<u8> = texts.iter().flat_map(padded).collect();
        self.add_records(name, &format!("'<U{length}'"), texts.len(), &values)
    }

    fn member(&mut self, name: &str, bytes: &[u8]) -> std::io::Result<()> {
        let options = SimpleFileOptions::default().large_file(true);
        self.zip.start_file(format!("{name}.npy"), options).map_err(std::io::Error::other)?;
        self.zip.write_all(bytes)
    }
}

/// Returns the header of a NumPy array (format 1.0); its length is a multiple of 64.
fn head(descr: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let shape = shape.trim_end();
    let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ({shape}), }}");
    let length = (10 + text.len() + 1).next_multiple_of(64);
    let padding = " ".repeat(length - 10 - text.len() - 1);
    let size = ((length - 10) as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &size[..], text.as_bytes(), padding.as_bytes(), b"\n"].concat()
}

/// Writes complex numbers as NumPy's `.npy` (complex64). The file appears complete or not at all; an existing one is replaced only if
/// `overwrite` is set.
///
/// # Errors
/// [`Error::Io`].
pub fn write_complex_npy(
    path: &Path,
    overwrite: bool,
    values: ArrayViewD<'_, Complex32>,
) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| {
        let write = || -> std::io::Result<()> {
            let mut file = BufWriter::new(File::create(temporary)?);
            file.write_all(&head("'<c8'", values.shape()))?;
            for value in values.iter() {
                file.write_all(&value.re.to_le_bytes())?;
                file.write_all(&value.im.to_le_bytes())?;
            }
            file.flush()
        };
        write().map_err(|e| Error::io(path, "write", e))
    })
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
