//! Makes labelled samples on demand.

use crate::builds::CacheChoice;
use crate::errors::Fault;
use crate::long_call::{LongCall, Running, run};
use crate::recipes::checked;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};
use stemgen::imaging::{Cache, RegionImager};
use stemgen::progress::{InterruptOnly, Progress};
use stemgen::recipe::CheckedRecipe;
use stemgen::rng::{Purpose, words};
use stemgen::specimen::{Specimen, specimen};
use stemgen::world::{BuildOptions, SampleOptions, TrainingSample, training_sample};

/// Number of specimens in memory. A few are enough, since samples are requested in about the order of their numbers.
const KEPT: usize = 3;
/// Number of the draw that seeds specimens.
const SPECIMEN: u32 = 16;

/// The options of samples.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Drawing {
    toml: String,
    size_px: usize,
    pixel_nm: Option<[f64; 2]>,
    angle_rad: [f64; 2],
    dose: Option<[f64; 2]>,
    sigma_px: f64,
    seed: u64,
    all_detectors: bool,
    /// Number of samples after which a new specimen is laid out; `None` for one specimen.
    per_specimen: Option<u64>,
    cache: CacheChoice,
}

/// A specimen with its prepared imager.
struct Laid {
    number: u64,
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    imager: Box<dyn RegionImager>,
}

/// The data that all samples share.
struct Source {
    recipe: CheckedRecipe,
    options: SampleOptions,
    per_specimen: Option<u64>,
    cache: Cache,
    laid: Mutex<Vec<Arc<Laid>>>,
}

impl Source {
    fn new(drawing: &Drawing) -> Result<Self, Fault> {
        let recipe = checked(&drawing.toml)?;
        let (pixel, dose) = (recipe.field.pixel_nm(), recipe.dose.electrons_per_angstrom2);
        let options = SampleOptions {
            size_px: drawing.size_px,
            pixel_nm: drawing.pixel_nm.unwrap_or([pixel; 2]),
            angle_rad: drawing.angle_rad,
            dose: drawing.dose.unwrap_or([dose; 2]),
            sigma_px: drawing.sigma_px,
            seed: drawing.seed,
            all_detectors: drawing.all_detectors,
        };
        options.check(&recipe.field)?;
        let cache = drawing.cache.cache();
        let laid = Mutex::new(Vec::new());
        Ok(Source { recipe, options, per_specimen: drawing.per_specimen, cache, laid })
    }

    /// Returns the number of a sample's specimen.
    fn number(&self, index: u64) -> u64 {
        self.per_specimen.map_or(0, |each| index / each.max(1))
    }

    /// Returns a specimen. Lays it out and prepares it if it is not in memory.
    fn laid(&self, number: u64, progress: &dyn Progress) -> Result<Arc<Laid>, Fault> {
        // The lock is held while a specimen is prepared, so that only one thread computes its library.
        let mut laid = self.laid.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = laid.iter().find(|laid| laid.number == number) {
            return Ok(found.clone());
        }
        let recipe = match self.per_specimen {
            None => self.recipe.clone(),
            Some(_) => {
                let [low, high, ..] = words(self.options.seed, Purpose::Tile, SPECIMEN, number);
                // TOML has signed integers, so the seed has 63 bits.
                self.recipe.with_seed((u64::from(high) << 31) ^ u64::from(low))?
            }
        };
        let specimen = specimen(&recipe)?;
        let options = BuildOptions { cache: self.cache.clone(), ..BuildOptions::default() };
        let mut imager = options.policy(&recipe)?.imaging.imager(&recipe, &specimen)?;
        imager.prepare(progress)?;
        let made = Arc::new(Laid { number, recipe, specimen, imager });
        if laid.len() == KEPT {
            laid.remove(0);
        }
        laid.push(made.clone());
        Ok(made)
    }

    /// Makes the samples of these numbers in parallel.
    fn samples(&self, indices: &[u64], call: &LongCall) -> Result<Vec<TrainingSample>, Fault> {
        let mut of_each = Vec::with_capacity(indices.len());
        for index in indices {
            of_each.push((*index, self.laid(self.number(*index), call)?));
        }
        let make = |(index, laid): &(u64, Arc<Laid>)| -> Result<TrainingSample, Fault> {
            if call.interrupted() {
                return Err(stemgen::Error::Interrupted.into());
            }
            let Laid { recipe, specimen, imager, .. } = &**laid;
            let quiet = InterruptOnly(call);
            let (specimen, imager) = (&**specimen, &**imager);
            Ok(training_sample(recipe, specimen, imager, &self.options, *index, &quiet)?)
        };
        of_each.par_iter().map(make).collect()
    }
}

/// Makes labelled samples by their numbers.
#[pyclass(frozen, module = "stemworlds._core")]
pub struct TileSource(Arc<Source>);

#[pymethods]
impl TileSource {
    #[new]
    fn new(py: Python<'_>, options: Drawing, running: Running) -> PyResult<Self> {
        run(py, running, move |_| Ok(TileSource(Arc::new(Source::new(&options)?))))
    }

    /// Lays out the specimen of a sample, and computes the library of its images.
    fn prepare(&self, py: Python<'_>, index: u64, running: Running) -> PyResult<()> {
        let source = self.0.clone();
        run(py, running, move |call| source.laid(source.number(index), call).map(drop))
    }

    /// Makes the samples of these numbers. Returns a list of dicts.
    fn samples<'py>(
        &self,
        py: Python<'py>,
        indices: Vec<u64>,
        running: Running,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let source = self.0.clone();
        let samples = run(py, running, move |call| {
            let samples = source.samples(&indices, call)?;
            Ok(indices.into_iter().zip(samples).collect::<Vec<_>>())
        })?;
        samples.into_iter().map(|(index, sample)| listed(py, index, sample)).collect()
    }
}

fn listed(py: Python<'_>, index: u64, sample: TrainingSample) -> PyResult<Bound<'_, PyDict>> {
    let out = PyDict::new(py);
    let raster = sample.raster;
    let particles: Bound<'_, PyArray1<f64>> = sample.particles_px.concat().into_pyarray(py);
    out.set_item("index", index)?;
    out.set_item("centre_nm", raster.centre_nm)?;
    out.set_item("pixel_nm", raster.pixel_nm)?;
    out.set_item("angle_rad", raster.angle_rad)?;
    out.set_item("dose", sample.dose)?;
    out.set_item("electrons_per_pixel", sample.electrons_per_pixel)?;
    out.set_item("counts", sample.counts.into_pyarray(py))?;
    out.set_item("clean", sample.clean.into_pyarray(py))?;
    let others = PyDict::new(py);
    for other in sample.others {
        let counted = other.counted_mrad.map(|angles| angles.into_pyarray(py));
        let images = (other.counts.into_pyarray(py), other.clean.into_pyarray(py), counted);
        others.set_item(other.name, images)?;
    }
    out.set_item("others", others)?;
    out.set_item("heat_map", sample.heat_map.into_pyarray(py))?;
    out.set_item("class_mask", sample.class_mask.into_pyarray(py))?;
    out.set_item("phase_mask", sample.phase_mask.into_pyarray(py))?;
    out.set_item("positions_px", sample.positions_px.into_pyarray(py))?;
    out.set_item("columns", sample.columns.into_pyarray(py))?;
    out.set_item("particles_px", particles)?;
    out.set_item("morphologies", sample.morphologies)?;
    Ok(out)
}
