//! Makes worlds from recorded images.

use crate::long_call::{Running, run};
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::files::outputs::check_outputs;
use stemgen::io::recorded::{self, ImageChoice};
use stemgen::replay::{ReplayOptions, ReplayWorld};

/// The options of an import.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Importing {
    path: PathBuf,
    out: PathBuf,
    overwrite: bool,
    dataset: Option<String>,
    index: Option<usize>,
    pixel_nm: Option<f64>,
    spacing_nm: Option<f64>,
    contrast: [f64; 2],
}

/// Makes a world from a recorded image. Returns its summary as JSON.
#[pyfunction]
pub fn import_image(py: Python<'_>, options: Importing, running: Running) -> PyResult<String> {
    run(py, running, move |call| {
        check_outputs([&options.out], [&options.path], options.overwrite)?;
        let choice = ImageChoice { dataset: options.dataset.clone(), index: options.index };
        let replay = ReplayOptions {
            pixel_nm: options.pixel_nm,
            spacing_nm: options.spacing_nm,
            percentiles: options.contrast,
        };
        let world = ReplayWorld::new(recorded::read(&options.path, &choice)?, &replay)?;
        world.write(&options.out, options.overwrite, call)?;
        Ok(serde_json::to_string(world.facts())?)
    })
}
