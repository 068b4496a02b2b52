//! Live worlds: specimens in memory that recordings change.

use crate::builds::CacheChoice;
use crate::errors::{Fault, OrRaise};
use crate::long_call::{Running, run};
use crate::pattern_cubes::{dicts, record_patterns};
use crate::recipes::checked;
use crate::recordings::{as_dict, tell_columns};
use crate::request::Parsed;
use ndarray::Array1;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use stemgen::Setting;
use stemgen::detect::Detector;
use stemgen::imaging::PixelRect;
use stemgen::live::{LiveOptions, LiveRequest, LiveSnapshot, LiveWorld};
use stemgen::progress::Progress;
use stemgen::recipe::{CheckedRecipe, Region};
use stemgen::simulation::PatternsRequest;
use stemgen::specimen::SiteKind;
use stemgen::world::{BuildOptions, ColumnTruth, RecordingRequest, SiteTruth};

/// The options of a live world.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Living {
    toml: String,
    most_dose: f64,
    cache: CacheChoice,
    detectors: Option<Vec<String>>,
}

/// A live world. Its calls run one after the other.
#[pyclass(frozen, module = "stemworlds._core")]
pub struct LiveField {
    world: Arc<Mutex<LiveWorld>>,
}

fn locked(world: &Mutex<LiveWorld>) -> MutexGuard<'_, LiveWorld> {
    world.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Refuses a region that is reversed or empty, or has an edge that is no number.
fn checked_region([x0, y0, x1, y1]: [f64; 4]) -> Result<(), Fault> {
    let ordered = x0 < x1 && y0 < y1 && [x0, y0, x1, y1].iter().all(|v| v.is_finite());
    if ordered {
        return Ok(());
    }
    let expected = "expected left < right and upper < lower edge, in nm".to_owned();
    Err(Fault::Value(Setting::Region, format!("{x0}, {y0}, {x1}, {y1}"), expected))
}

/// Returns the pixels of the built field that a region (left, upper, right and lower edge in nm) touches, counted in the full field.
fn pixels(recipe: &CheckedRecipe, region: [f64; 4]) -> Result<PixelRect, Fault> {
    let (field, [x0, y0, x1, y1]) = (&recipe.field, region);
    let (pixel, first) = (field.pixel_nm(), field.crop_origin_px());
    let shape = field.pixels(field.built_grid());
    checked_region(region)?;
    let range = |low: f64, high: f64, size: usize| {
        let clamp = |v: f64| v.clamp(0.0, size as f64) as usize;
        clamp((low / pixel + 0.5).floor())..clamp((high / pixel + 0.5).ceil())
    };
    let (rows, columns) = (range(y0, y1, shape[0]), range(x0, x1, shape[1]));
    if rows.is_empty() || columns.is_empty() {
        let [h, w] = shape.map(|n| n as f64 * pixel);
        let expected = format!("the field goes from 0, 0 to {w:.2}, {h:.2} nm");
        return Err(Fault::Value(Setting::Region, format!("{x0}, {y0}, {x1}, {y1}"), expected));
    }
    let first = [first[0] + rows.start, first[1] + columns.start];
    Ok(PixelRect::new(first, [rows.len(), columns.len()]))
}

/// Returns sites and columns as dicts of arrays.
fn truth(
    py: Python<'_>,
    sites: &[SiteTruth],
    columns: &[ColumnTruth],
    out: &Bound<'_, PyDict>,
) -> PyResult<()> {
    tell_columns(py, columns, out)?;
    let positions: Vec<[f32; 3]> = sites.iter().map(|s| s.position_nm).collect();
    let kind = |s: &SiteTruth| match s.kind {
        SiteKind::Pristine => 0,
        SiteKind::Vacancy => 1,
        SiteKind::Substitution => 2,
    };
    let number = |s: &SiteTruth| i32::from(s.number);
    let lists: [(&str, Array1<i32>); 3] = [
        ("types", sites.iter().map(kind).collect()),
        ("numbers", sites.iter().map(number).collect()),
        ("site_columns", sites.iter().map(|s| s.column as i32).collect()),
    ];
    out.set_item("site_positions_nm", ndarray::arr2(&positions).into_pyarray(py))?;
    for (name, list) in lists {
        out.set_item(name, list.into_pyarray(py))?;
    }
    Ok(())
}

/// Fills in what a request leaves open from the recipe of a world.
fn live_request(asked: &RecordingRequest, world: &LiveWorld) -> Result<LiveRequest, Fault> {
    let recipe = world.recipe();
    Ok(LiveRequest {
        part: asked.part(recipe)?,
        electrons: asked.electrons(recipe)?,
        acquisition: asked.table(recipe).resolved(),
        keep_frames: asked.keep_frames,
    })
}

#[pymethods]
impl LiveField {
    #[new]
    fn new(py: Python<'_>, options: Living, running: Running) -> PyResult<Self> {
        let world = run(py, running, move |call| {
            let recipe = checked(&options.toml)?;
            let imaging = BuildOptions { cache: options.cache.cache(), ..BuildOptions::default() };
            let Living { most_dose, detectors, .. } = options;
            let live = LiveOptions { imaging, most_dose, detectors, ..LiveOptions::default() };
            Ok(LiveWorld::new(&recipe, recipe.seed, &live, call)?)
        })?;
        Ok(LiveField { world: Arc::new(Mutex::new(world)) })
    }

    /// Returns the noise-free image and the truth of a region, in a dict.
    fn look(&self, py: Python<'_>, region: [f64; 4], running: Running) -> PyResult<Py<PyDict>> {
        let world = Arc::clone(&self.world);
        let (tile, detectors) = run(py, running, move |_| {
            let world = locked(&world);
            let detectors: Vec<Detector> = world.detectors().cloned().collect();
            Ok((world.look(&pixels(world.recipe(), region)?)?, detectors))
        })?;
        let out = PyDict::new(py);
        truth(py, &tile.sites, &tile.columns, &out)?;
        out.set_item("pixel_nm", tile.pixel_nm)?;
        out.set_item("origin_nm", tile.origin_nm)?;
        let images = std::iter::once(tile.clean);
        let images = images.chain(tile.others.into_iter().map(|(_, image)| image));
        let mut all = Vec::new();
        for (detector, image) in detectors.iter().zip(images) {
            all.push((&detector.name, detector.units(), image.into_pyarray(py)));
        }
        out.set_item("images", all)?;
        Ok(out.unbind())
    }

    /// Records a place as `record_field` does, and changes the specimen.
    fn acquire(
        &self,
        py: Python<'_>,
        asked: Parsed<RecordingRequest>,
        running: Running,
    ) -> PyResult<Py<PyDict>> {
        let world = Arc::clone(&self.world);
        let recording = run(py, running, move |call| {
            let mut world = locked(&world);
            let request = live_request(&asked.0, &world)?;
            let recording = world.acquire(&request, call)?;
            recording.clipping_warnings().iter().for_each(|warning| call.warn(warning));
            Ok(recording)
        })?;
        as_dict(py, recording)
    }

    /// Simulates the patterns of a place, and changes the specimen. Returns a list with one dict, as `simulate_patterns` does.
    fn acquire_patterns(
        &self,
        py: Python<'_>,
        asked: Parsed<RecordingRequest>,
        detector: Parsed<PatternsRequest>,
        running: Running,
    ) -> PyResult<Vec<Py<PyDict>>> {
        let world = Arc::clone(&self.world);
        let cubes = run(py, running, move |call| {
            let mut world = locked(&world);
            let request = live_request(&asked.0, &world)?;
            record_patterns(&mut world, (&request, &detector.0), call)
        })?;
        dicts(py, cubes)
    }

    /// Returns the present truth of a region, in a dict.
    fn truth(&self, py: Python<'_>, region: [f64; 4]) -> PyResult<Py<PyDict>> {
        let [x0, y0, x1, y1] = region;
        checked_region(region).or_raise(py)?;
        let region = Region { x: [x0, x1], y: [y0, y1] };
        let found = py.detach(|| locked(&self.world).truth(&region));
        let out = PyDict::new(py);
        truth(py, &found.sites, &found.columns, &out)?;
        Ok(out.unbind())
    }

    /// Returns the mean dose of a region in electrons per square Angstrom.
    fn dose(&self, py: Python<'_>, region: [f64; 4]) -> PyResult<f64> {
        let [x0, y0, x1, y1] = region;
        checked_region(region).or_raise(py)?;
        let region = Region { x: [x0, x1], y: [y0, y1] };
        Ok(py.detach(|| locked(&self.world).mean_dose(&region)))
    }

    /// Returns all recordings as JSON.
    fn history(&self, py: Python<'_>) -> PyResult<String> {
        let text = py.detach(|| serde_json::to_string(locked(&self.world).history()));
        text.map_err(Fault::from).or_raise(py)
    }

    /// Returns the present state as JSON.
    fn snapshot(&self, py: Python<'_>) -> PyResult<String> {
        let text = py.detach(|| serde_json::to_string(&locked(&self.world).snapshot()));
        text.map_err(Fault::from).or_raise(py)
    }

    /// Restores a state from [`LiveField::snapshot`].
    fn restore(&self, py: Python<'_>, snapshot: &str) -> PyResult<()> {
        let restore = || -> Result<(), Fault> {
            let snapshot: LiveSnapshot = serde_json::from_str(snapshot).map_err(|e| {
                let expected = format!("is no snapshot of a live world: {e}");
                Fault::Value(Setting::Snapshot, "the text".into(), expected)
            })?;
            Ok(locked(&self.world).restore(&snapshot)?)
        };
        py.detach(restore).or_raise(py)
    }

    /// Returns the recipe, with its seed, as TOML.
    fn recipe(&self, py: Python<'_>) -> String {
        py.detach(|| locked(&self.world).recipe().to_toml())
    }
}
