//! Records a place with the errors of scan and detector.

use crate::builds::CacheChoice;
use crate::checks::Field;
use crate::errors::Fault;
use crate::long_call::{LongCall, Running, run};
use crate::request::Parsed;
use ndarray::Array2;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use stemgen::acquisition::clipping_warning;
use stemgen::files::outputs::check_outputs;
use stemgen::progress::Progress;
use stemgen::world::{ColumnTruth, FieldRecording, RecordingJob, RecordingRequest};

/// The options of a recording.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Recording {
    field: Field,
    request: Parsed<RecordingRequest>,
    cache: CacheChoice,
    out: Option<PathBuf>,
    overwrite: bool,
}

impl Recording {
    fn record(&self, call: &LongCall) -> Result<FieldRecording, Fault> {
        let (recipe, made) = self.field.resolve()?;
        check_outputs(&self.out, &self.field.world, self.overwrite)?;
        let field = (self.field.world.clone(), made);
        let job = RecordingJob::new(&recipe, field, &self.request.0)?;
        let (recording, _) = job.run(self.cache.cache(), call)?;
        if let Some(out) = &self.out {
            let (recipe, specimen) = (job.recipe(), job.specimen());
            recording.write(out, self.overwrite, recipe, specimen, "stemworlds.acquire")?;
        }
        warn_of_clipping(&recording, call);
        Ok(recording)
    }
}

/// Warns of pixels that the converter clipped.
pub fn warn_of_clipping(recording: &FieldRecording, progress: &dyn Progress) {
    let [rows, columns] = recording.frame.shape;
    let pixels = rows * columns * recording.exposure.frames;
    let bits = recording.options.acquisition.bits;
    if let Some(warning) = clipping_warning(recording.clipped, pixels, bits) {
        progress.warn(&warning);
    }
}

/// Records a place. Returns a dict of arrays and numbers.
#[pyfunction]
pub fn record_field(py: Python<'_>, options: Recording, running: Running) -> PyResult<Py<PyDict>> {
    let recording = run(py, running, move |call| options.record(call))?;
    as_dict(py, recording)
}

/// Adds the columns to a dict: places in nm, sites, vacancies and substitutions, compositions.
pub fn tell_columns(
    py: Python<'_>,
    columns: &[ColumnTruth],
    out: &Bound<'_, PyDict>,
) -> PyResult<()> {
    let positions: Vec<[f32; 2]> = columns.iter().map(|c| c.position_nm).collect();
    let count = |c: &ColumnTruth| [c.sites, c.vacancies, c.substitutions].map(|n| n as i32);
    let counts: Vec<[i32; 3]> = columns.iter().map(count).collect();
    let compositions: Vec<String> = columns.iter().map(ColumnTruth::composition).collect();
    out.set_item("positions_nm", ndarray::arr2(&positions).into_pyarray(py))?;
    out.set_item("counts", ndarray::arr2(&counts).into_pyarray(py))?;
    out.set_item("compositions", compositions)
}

/// Converts a recording to a dict of arrays and numbers.
pub fn as_dict(py: Python<'_>, recording: FieldRecording) -> PyResult<Py<PyDict>> {
    let out = PyDict::new(py);
    tell_columns(py, &recording.columns, &out)?;
    let drift: Array2<f64> = ndarray::arr2(&recording.drift);
    out.set_item("drift", drift.into_pyarray(py))?;
    out.set_item("pixel_nm", recording.frame.pixel_nm)?;
    out.set_item("origin_nm", recording.frame.origin_nm)?;
    out.set_item("dose", recording.exposure.dose())?;
    out.set_item("current_pa", recording.exposure.current_pa())?;
    out.set_item("electrons_per_pixel", recording.exposure.electrons_per_pixel)?;
    out.set_item("clipped", recording.clipped)?;
    if let Some(stages) = recording.stages {
        out.set_item("moved", stages.moved.into_pyarray(py))?;
        out.set_item("electrons", stages.electrons.into_pyarray(py))?;
    }
    out.set_item("position_in_image", recording.position_in_image.into_pyarray(py))?;
    out.set_item("ideal", recording.ideal.into_pyarray(py))?;
    out.set_item("data", recording.data.into_pyarray(py))?;
    Ok(out.unbind())
}
