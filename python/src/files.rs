//! Images to files of other programs.

use crate::errors::{Fault, Told};
use ndarray::Array3;
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::Setting;
use stemgen::files::outputs::check_outputs;
use stemgen::io::hspy_file::write_hspy;
use stemgen::io::image_file::ImageStack;
use stemgen::io::tiff_file::{TiffDepth, write_tiff};

use crate::words::choice;

/// An image with its axes.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct StackOptions {
    name: String,
    data: StackData,
    units: String,
    step_angstrom: [f64; 2],
    origin_angstrom: [f64; 2],
    thicknesses_angstrom: Vec<f64>,
}

/// (thickness, y, x).
pub struct StackData(Array3<f32>);

impl<'a, 'py> FromPyObject<'a, 'py> for StackData {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let array: PyReadonlyArray3<'py, f32> = object.extract()?;
        Ok(StackData(array.as_array().to_owned()))
    }
}

impl StackOptions {
    fn stack(&self) -> Result<ImageStack<'_>, Fault> {
        let dim = self.data.0.dim();
        if self.data.0.is_empty() || dim.0 != self.thicknesses_angstrom.len() {
            let value = format!("{dim:?} with {} thicknesses", self.thicknesses_angstrom.len());
            let expected = "expected pixels, and an image for each thickness".to_owned();
            return Err(Fault::Value(Setting::ImageShape, value, expected));
        }
        Ok(ImageStack {
            name: &self.name,
            data: self.data.0.view(),
            units: &self.units,
            step_angstrom: self.step_angstrom,
            origin_angstrom: self.origin_angstrom,
            thicknesses_angstrom: &self.thicknesses_angstrom,
            defocus_angstrom: None,
            annulus_mrad: None,
        })
    }
}

/// Writes images for HyperSpy.
#[pyfunction]
pub fn save_hspy(
    py: Python<'_>,
    path: PathBuf,
    images: Vec<StackOptions>,
    overwrite: bool,
) -> PyResult<()> {
    let written = py.detach(|| -> Result<(), Fault> {
        check_outputs([&path], [] as [&PathBuf; 0], overwrite)?;
        let stacks = images.iter().map(StackOptions::stack).collect::<Result<Vec<_>, _>>()?;
        Ok(write_hspy(&path, overwrite, &stacks)?)
    });
    written.or_raise(py)
}

/// Writes an image as TIFF of 8, 16 or 32 bits.
#[pyfunction]
pub fn save_tiff(
    py: Python<'_>,
    path: PathBuf,
    image: StackOptions,
    bits: u8,
    overwrite: bool,
) -> PyResult<()> {
    let depths = [("8", TiffDepth::Bits8), ("16", TiffDepth::Bits16), ("32", TiffDepth::Bits32)];
    let written = py.detach(|| -> Result<(), Fault> {
        let depth = choice(Setting::Output, &bits.to_string(), &depths)?;
        check_outputs([&path], [] as [&PathBuf; 0], overwrite)?;
        Ok(write_tiff(&path, overwrite, &image.stack()?, depth)?)
    });
    written.or_raise(py)
}
