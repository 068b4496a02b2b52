//! Writes images to files of other programs.

use crate::errors::{Fault, OrRaise};
use ndarray::Array3;
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::Setting;
use stemgen::files::outputs::check_outputs;
use stemgen::io::{HspyFacts, ImageSeries, ImageStack, TiffDepth, write_hspy, write_tiff};

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
    defocus_angstrom: Option<f64>,
    annulus_mrad: Option<[f64; 2]>,
    sector_degrees: Option<[f64; 2]>,
    electrons_per_pixel: Option<f64>,
}

/// The metadata of images in a file for HyperSpy.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct HspyOptions {
    energy_kev: Option<f64>,
    semiangle_mrad: Option<f64>,
    tilt_mrad: Option<[f64; 2]>,
    defocus_angstrom: Option<f64>,
    dose: Option<f64>,
    settings: Option<String>,
}

/// Images as an array (thickness, y, x).
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
            defocus_angstrom: self.defocus_angstrom,
            annulus_mrad: self.annulus_mrad,
            sector_degrees: self.sector_degrees,
            electrons_per_pixel: self.electrons_per_pixel,
        })
    }
}

/// Writes images to a file for HyperSpy.
#[pyfunction]
pub fn save_hspy(
    py: Python<'_>,
    path: PathBuf,
    images: Vec<StackOptions>,
    about: HspyOptions,
    overwrite: bool,
) -> PyResult<()> {
    let facts = HspyFacts {
        energy_kev: about.energy_kev,
        semiangle_mrad: about.semiangle_mrad,
        tilt_mrad: about.tilt_mrad,
        defocus_angstrom: about.defocus_angstrom,
        dose: about.dose,
        texts: about.settings.into_iter().map(|settings| ("settings", settings)).collect(),
        ..HspyFacts::default()
    };
    let written = py.detach(|| -> Result<(), Fault> {
        check_outputs([&path], [] as [&PathBuf; 0], overwrite)?;
        let stacks = images.iter().map(StackOptions::stack).collect::<Result<Vec<_>, _>>()?;
        Ok(write_hspy(&path, overwrite, &stacks, &facts)?)
    });
    written.or_raise(py)
}

/// Writes one image, or the images of a series, as one TIFF of 8, 16 or 32 bits.
#[pyfunction]
pub fn save_tiff(
    py: Python<'_>,
    path: PathBuf,
    images: Vec<StackOptions>,
    bits: u8,
    overwrite: bool,
) -> PyResult<()> {
    let depths = [("8", TiffDepth::Bits8), ("16", TiffDepth::Bits16), ("32", TiffDepth::Bits32)];
    let written = py.detach(|| -> Result<(), Fault> {
        let depth = choice(Setting::Output, &bits.to_string(), &depths)?;
        check_outputs([&path], [] as [&PathBuf; 0], overwrite)?;
        let stacks = images.iter().map(StackOptions::stack).collect::<Result<Vec<_>, _>>()?;
        match &ImageSeries::group(&stacks)[..] {
            [series] => Ok(write_tiff(&path, overwrite, series, depth)?),
            several => {
                let expected = "expected one image, or the images of one series".to_owned();
                Err(Fault::Value(Setting::Output, several.len().to_string(), expected))
            }
        }
    });
    written.or_raise(py)
}
