//! Recordings of a place, with the errors of scan and detector.

use crate::builds::CacheChoice;
use crate::checks::Field;
use crate::errors::Fault;
use crate::guest::{Guest, Running, run};
use crate::recipes::profile;
use ndarray::Array2;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;
use stemgen::Setting;
use stemgen::acquisition::{AcquisitionTable, clipping_warning};
use stemgen::files::outputs::check_outputs;
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::recipe::{CheckedRecipe, Recipe};
use stemgen::specimen::{Specimen, specimen};
use stemgen::world::noise_free::{refined, refinement};
use stemgen::world::{
    ColumnTruth, Electrons, FieldRecording, ImagerSource, RecordedPart, RecordingOptions,
    WorldSource, record,
};

/// Which part is recorded.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Place {
    region_nm: Option<[f64; 4]>,
    at_nm: Option<[f64; 2]>,
    zoom: Option<f64>,
    pixel_nm: Option<f64>,
}

/// How it is scanned.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct ScanChoice {
    profile: Option<String>,
    dose: Option<f64>,
    current_pa: Option<f64>,
    dwell_us: Option<f64>,
    frames: Option<usize>,
    /// Keep the frames one by one.
    pub keep_frames: bool,
}

/// What is recorded, and how.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Recording {
    field: Field,
    place: Place,
    scan: ScanChoice,
    stages: bool,
    seed: u64,
    cache: CacheChoice,
    out: Option<PathBuf>,
    overwrite: bool,
}

fn refuse<T>(setting: Setting, value: impl ToString, expected: &str) -> Result<T, Fault> {
    Err(Fault::Value(setting, value.to_string(), expected.to_owned()))
}

impl Place {
    /// The part of the field of a recipe.
    pub fn part(&self, recipe: &CheckedRecipe) -> Result<RecordedPart, Fault> {
        let own = recipe.field.pixel_nm();
        if self.zoom.is_some() && self.pixel_nm.is_some() {
            return refuse(
                Setting::RecordedPixelNm,
                "given",
                "zoom and pixel_nm both set it; give one",
            );
        }
        if let Some(zoom) = self.zoom.filter(|zoom| zoom.is_nan() || *zoom <= 0.0) {
            return refuse(Setting::RecordedPixelNm, format!("zoom {zoom}"), "expected above 0");
        }
        let pixel_nm = self.pixel_nm.unwrap_or(own / self.zoom.unwrap_or(1.0));
        if let Some([x0, y0, x1, y1]) = self.region_nm {
            if self.at_nm.is_some() {
                return refuse(
                    Setting::RecordedRegionNm,
                    "given",
                    "at_nm and region_nm both set the place; give one",
                );
            }
            if !(x1 > x0 && y1 > y0) {
                let value = format!("{x0}, {y0}, {x1}, {y1}");
                return refuse(
                    Setting::RecordedRegionNm,
                    value,
                    "expected left, upper, right and lower edge in nm",
                );
            }
            let centre_nm = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
            return Ok(RecordedPart { centre_nm, size_nm: [x1 - x0, y1 - y0], pixel_nm });
        }
        Ok(RecordedPart::tile_at(recipe, self.at_nm, pixel_nm))
    }
}

impl ScanChoice {
    /// The table `[acquisition]` of a recipe with the values that were given.
    pub fn table(&self, recipe: &CheckedRecipe) -> Result<AcquisitionTable, Fault> {
        let mut table = recipe.acquisition.unwrap_or_default();
        let profile = self.profile.as_deref().map(profile).transpose()?;
        table.profile = profile.or(table.profile);
        table.dwell_us = self.dwell_us.or(table.dwell_us);
        table.frames = self.frames.or(table.frames);
        Ok(table)
    }

    /// The dose.
    pub fn electrons(&self, recipe: &CheckedRecipe) -> Result<Electrons, Fault> {
        if self.dose.is_some() && self.current_pa.is_some() {
            return refuse(
                Setting::BeamCurrentPa,
                "given",
                "dose and current_pa both set it; give one",
            );
        }
        let dose = self.dose.unwrap_or(recipe.dose.electrons_per_angstrom2);
        Ok(self.current_pa.map_or(Electrons::Dose(dose), Electrons::CurrentPa))
    }
}

impl Recording {
    fn record(&self, guest: &Guest) -> Result<FieldRecording, Fault> {
        let (recipe, made) = self.field.resolve()?;
        let table = self.scan.table(&recipe)?;
        let recipe = Recipe { acquisition: Some(table), ..recipe.recipe().clone() }.checked()?;
        check_outputs(&self.out, &self.field.world, self.overwrite)?;
        let specimen: Arc<dyn Specimen> = specimen(&recipe)?;
        let part = self.place.part(&recipe)?;
        let options = RecordingOptions {
            acquisition: table.resolved(),
            electrons: self.scan.electrons(&recipe)?,
            seed: self.seed,
            keep_frames: self.scan.keep_frames,
            keep_stages: self.stages,
        };
        let parts = refinement(&recipe);
        let kept = match self.field.world.as_ref().filter(|_| parts == 1) {
            Some(path) => Some(WorldFile::open(path)?).filter(WorldFile::has_clean),
            None => None,
        };
        let recording = match &kept {
            Some(world) => {
                let source = WorldSource { world, recipe: &recipe };
                record(&recipe, &*specimen, &source, &part, &options, guest)?
            }
            None => {
                let fine = refined(&recipe, parts)?;
                let imaging = Field::imaging(&fine, made.as_ref(), self.cache.cache())?;
                let mut imager = imaging.imager(&fine, &specimen)?;
                imager.prepare(guest)?;
                let source = ImagerSource { imager: &*imager, recipe: &fine };
                record(&recipe, &*specimen, &source, &part, &options, guest)?
            }
        };
        if let Some(out) = &self.out {
            recording.write(out, self.overwrite, &recipe, &*specimen, "stemworlds.acquire")?;
        }
        warn_of_clipping(&recording, guest);
        Ok(recording)
    }
}

/// Tells of pixels that the converter cut off.
pub fn warn_of_clipping(recording: &FieldRecording, progress: &dyn Progress) {
    let [rows, columns] = recording.frame.shape;
    let pixels = rows * columns * recording.exposure.frames;
    let bits = recording.options.acquisition.bits;
    if let Some(warning) = clipping_warning(recording.clipped, pixels, bits) {
        progress.warn(&warning);
    }
}

/// Records a place: a dict of arrays and numbers.
#[pyfunction]
pub fn record_field(py: Python<'_>, options: Recording, running: Running) -> PyResult<Py<PyDict>> {
    let recording = run(py, running, move |guest| options.record(guest))?;
    told(py, recording)
}

/// Columns: places in nm, sites, vacancies and substitutions, compositions.
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

/// A recording as a dict of arrays and numbers.
pub fn told(py: Python<'_>, recording: FieldRecording) -> PyResult<Py<PyDict>> {
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
