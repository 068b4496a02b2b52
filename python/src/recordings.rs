//! Records a place with the errors of scan and detector.

use crate::builds::CacheChoice;
use crate::checks::Field;
use crate::errors::Fault;
use crate::long_call::{LongCall, Running, run};
use crate::request::Parsed;
use ndarray::{Array2, Array3};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use stemgen::detect::Detector;
use stemgen::files::outputs::check_outputs;
use stemgen::progress::Progress;
use stemgen::world::{
    ColumnTruth, FieldRecording, RecordingJob, RecordingRequest, RecordingStages,
};

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
        recording.clipping_warnings().iter().for_each(|warning| call.warn(warning));
        Ok(recording)
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
    let first = (recording.data, recording.ideal, recording.stages, recording.clipped);
    let mut images = vec![detector_dict(py, &recording.detector, first)?];
    for one in recording.others {
        let values = (one.data, one.ideal, one.stages, one.clipped);
        images.push(detector_dict(py, &one.detector, values)?);
    }
    out.set_item("detectors", images)?;
    out.set_item("position_in_image", recording.position_in_image.into_pyarray(py))?;
    Ok(out.unbind())
}

/// Recorded values, noise-free image, stages and clipped pixels of a detector.
type Recorded = (Array3<f64>, Array2<f32>, Option<RecordingStages>, u64);

/// Converts the images of a detector to a dict.
fn detector_dict<'py>(
    py: Python<'py>,
    detector: &Detector,
    (data, ideal, stages, clipped): Recorded,
) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("name", &detector.name)?;
    out.set_item("mrad", detector.is_deflection())?;
    out.set_item("data", data.into_pyarray(py))?;
    out.set_item("ideal", ideal.into_pyarray(py))?;
    out.set_item("clipped", clipped)?;
    if let Some(stages) = stages {
        out.set_item("moved", stages.moved.into_pyarray(py))?;
        out.set_item("electrons", stages.electrons.into_pyarray(py))?;
    }
    Ok(out)
}
