//! Images of atoms.

use crate::errors::{Fault, Told};
use crate::guest::{Guest, Running, run};
use crate::microscope::{Microscope, Numerics, ScanOptions, length_unit, settings};
use crate::structures::{AtomsSource, SpecimenOptions};
use ndarray::{Array2, Array3, Axis};
use num_complex::Complex32;
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stemgen::Setting;
use stemgen::engine::{
    Cost, Plan, ProbeRaster, Scan, SourceBlur, check_memory, mean_diffraction,
    settings_for_accuracy, simulate_places as engine_places, simulate_series,
};
use stemgen::progress::Progress;
use stemgen::world::{Noise, check_countable};
use stemgen_cli::shared::{
    Conventional, PlanReport, Prepared, plane_wave, plane_wave_settings, threads,
};

/// All that decides an image.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Simulation {
    atoms: AtomsSource,
    specimen: SpecimenOptions,
    microscope: Microscope,
    numerics: Numerics,
    scan: ScanOptions,
    /// Electrons per square Angstrom.
    dose: Option<f64>,
    /// Go on though more memory is needed than is free.
    force: bool,
}

/// An image of one detector and defocus.
struct MadeImage {
    name: String,
    /// (thickness, y, x)
    data: Array3<f32>,
    counts: Option<Array3<u32>>,
    defocus_angstrom: f64,
    annulus_mrad: [f64; 2],
}

/// Plans that differ in the defocus.
struct Planned {
    specimen: Prepared,
    plans: Vec<Plan>,
    scan: Scan,
    warnings: Vec<String>,
    /// JSON.
    accuracy: Vec<String>,
}

impl Simulation {
    fn plans(&self, progress: &dyn Progress) -> Result<Planned, Fault> {
        let specimen = self.specimen.prepare(&self.atoms)?;
        if self.microscope.defocus_angstrom.is_empty() {
            let expected = "expected a length in A, or several".to_owned();
            return Err(Fault::Value(Setting::Aberration, "no defocus".into(), expected));
        }
        let (mut plans, mut accuracy) = (Vec::new(), Vec::new());
        let [x, y, _] = specimen.size;
        let (mut scan, mut warnings) = (None, specimen.warnings.clone());
        for defocus in &self.microscope.defocus_angstrom {
            let phonons = self.specimen.phonons();
            let mut settings = settings(&self.microscope, &self.numerics, phonons, *defocus)?;
            let mut plan = Plan::new(&settings, specimen.size, &specimen.heights)?;
            let (raster, left) = self.scan.scan([x, y], &settings.optics)?;
            if scan.is_none() {
                warnings.extend(left);
            }
            scan = Some(raster);
            if let Some(asked) = self.numerics.accuracy_percent {
                let frames = specimen.frames();
                let (chosen, found) = settings_for_accuracy(
                    asked,
                    &settings,
                    specimen.size,
                    &frames,
                    &raster,
                    progress,
                )?;
                settings = chosen;
                plan = Plan::new(&settings, specimen.size, &specimen.heights)?;
                accuracy.push(serde_json::to_string(&found)?);
            }
            plans.push(plan);
        }
        warnings.extend(plans.iter().take(1).flat_map(|plan| plan.warnings.clone()));
        warnings.extend(plans.first().and_then(Plan::narrow_cell));
        warnings.extend(self.microscope.doubts());
        let scan = scan.ok_or_else(|| Fault::Internal("no scan".into()))?;
        Ok(Planned { specimen, plans, scan, warnings, accuracy })
    }

    /// The name of an image: with its defocus in a series.
    fn name(&self, detector: &str, defocus: f64) -> String {
        match self.microscope.defocus_angstrom.len() {
            1 => detector.to_owned(),
            _ => format!("{detector}_defocus_{defocus}A"),
        }
    }

    fn check_memory(&self, planned: &Planned) -> Result<(), Fault> {
        for plan in planned.plans.iter().filter(|_| !self.force) {
            let cost = Cost::new(plan, &planned.scan);
            check_memory(cost.memory_bytes(threads()), cost.memory_remedy(threads()))?;
        }
        Ok(())
    }

    fn images(&self, planned: &Planned, guest: &Guest) -> Result<Vec<MadeImage>, Fault> {
        let (scan, specimen) = (&planned.scan, &planned.specimen);
        let [x, y, _] = specimen.size;
        let source = self.microscope.source();
        let blur = source.map(|source| SourceBlur::new(source, scan, [x, y])).transpose()?;
        let wide = blur.as_ref().map_or(scan, |blur| blur.scan());
        let series = simulate_series(&planned.plans, &specimen.frames(), wide, guest)?;
        let mut made = Vec::new();
        let defoci = &self.microscope.defocus_angstrom;
        for ((plan, images), defocus) in planned.plans.iter().zip(&series).zip(defoci) {
            for (n, detector) in plan.settings.detectors.iter().enumerate() {
                let sharp = images.data.index_axis(Axis(1), n);
                let data = match &blur {
                    None => sharp.to_owned(),
                    Some(blur) => blurred(blur, sharp)?,
                };
                made.push(MadeImage {
                    name: self.name(&detector.name, *defocus),
                    counts: None,
                    data,
                    defocus_angstrom: *defocus,
                    annulus_mrad: [detector.inner_mrad, detector.outer_mrad],
                });
            }
        }
        self.count(&mut made, scan);
        Ok(made)
    }

    /// Counts electrons: each image and thickness has draws of its own.
    fn count(&self, images: &mut [MadeImage], scan: &Scan) {
        let Some(electrons_per_pixel) = self.electrons_per_pixel(scan) else { return };
        let full_width_px = scan.shape[1];
        for (n, image) in images.iter_mut().enumerate() {
            let (thicknesses, rows, columns) = image.data.dim();
            let mut counts = Array3::zeros((thicknesses, rows, columns));
            for (t, sharp) in image.data.outer_iter().enumerate() {
                let origin_px = [(n * thicknesses + t) * rows, 0];
                let seed = self.specimen.seed();
                let noise =
                    Noise { seed, electrons_per_pixel, origin_px, full_width_px, detector: 0 };
                counts.index_axis_mut(Axis(0), t).assign(&noise.counted(&sharp.to_owned()));
            }
            image.counts = Some(counts);
        }
    }

    fn electrons_per_pixel(&self, scan: &Scan) -> Option<f64> {
        let [x, y] = scan.step_angstrom;
        self.dose.map(|dose| dose * x * y)
    }

    /// Refuses a dose that is none, and one whose electrons cannot be counted.
    fn check_dose(&self, scan: &Scan) -> Result<(), Fault> {
        let [x, y] = scan.step_angstrom;
        match self.dose.filter(|dose| !(*dose > 0.0 && dose.is_finite())) {
            None => Ok(self.dose.map_or(Ok(()), |dose| check_countable(dose, x * y))?),
            Some(dose) => {
                let expected = "expected electrons per square Angstrom, above 0".to_owned();
                Err(Fault::Value(Setting::Dose, dose.to_string(), expected))
            }
        }
    }
}

/// Refuses places of probes that mean nothing: more than one cell outside a cell of `size` (x, y) in Angstrom, which repeats.
fn check_places(places: &[[f64; 2]], size: [f64; 2]) -> Result<(), Fault> {
    let near = |place: &[f64; 2]| (0..2).all(|k| (-size[k]..=2.0 * size[k]).contains(&place[k]));
    match places.iter().position(|place| !near(place)) {
        None => Ok(()),
        Some(number) => {
            let [x, y] = places[number];
            let expected = format!(
                "the cell of {:.3} x {:.3} A repeats, and this place is more than one cell outside; expected places in the \
                 cell (check the unit)",
                size[0], size[1]
            );
            let value = format!("places[{number}] at {x}, {y} A");
            Err(Fault::Value(Setting::Region, value, expected))
        }
    }
}

fn blurred(blur: &SourceBlur, sharp: ndarray::ArrayView3<f32>) -> Result<Array3<f32>, Fault> {
    let images: Vec<_> = sharp.outer_iter().map(|image| blur.image(image)).collect();
    let views: Vec<_> = images.iter().map(|image| image.view()).collect();
    ndarray::stack(Axis(0), &views).map_err(|e| Fault::Internal(e.to_string()))
}

/// Simulates. Returns a dict: `images`, a list of dicts with `name`, `data`, `counts`, `defocus_angstrom`, `annulus_mrad`; and what
/// they share.
#[pyfunction]
pub fn simulate(py: Python<'_>, options: Simulation, running: Running) -> PyResult<Py<PyDict>> {
    let work = move |guest: &Guest| {
        let planned = options.plans(guest)?;
        options.check_dose(&planned.scan)?;
        planned.warnings.iter().for_each(|warning| guest.warn(warning));
        options.check_memory(&planned)?;
        let images = options.images(&planned, guest)?;
        let per_pixel = options.electrons_per_pixel(&planned.scan);
        Ok((images, planned, per_pixel))
    };
    let (images, planned, electrons_per_pixel) = run(py, running, work)?;
    let out = PyDict::new(py);
    let mut listed = Vec::new();
    for image in images {
        let item = PyDict::new(py);
        item.set_item("name", image.name)?;
        item.set_item("data", image.data.into_pyarray(py))?;
        item.set_item("counts", image.counts.map(|counts| counts.into_pyarray(py)))?;
        item.set_item("defocus_angstrom", image.defocus_angstrom)?;
        item.set_item("annulus_mrad", image.annulus_mrad)?;
        listed.push(item);
    }
    let plan = &planned.plans[0];
    out.set_item("images", listed)?;
    out.set_item("electrons_per_pixel", electrons_per_pixel)?;
    out.set_item("strain_percent", planned.specimen.strain_percent)?;
    out.set_item("step_angstrom", planned.scan.step_angstrom)?;
    out.set_item("origin_angstrom", planned.scan.origin_angstrom)?;
    out.set_item("thicknesses_angstrom", plan.thicknesses_angstrom())?;
    out.set_item("box_angstrom", planned.specimen.size)?;
    out.set_item("settings", serde_json::to_string(&plan.settings).map_err(Fault::from).told(py)?)?;
    out.set_item("band_limit_mrad", plan.band_limit_mrad)?;
    out.set_item("accuracy", planned.accuracy)?;
    Ok(out.unbind())
}

/// Simulates single probes at `places` (x, y) in `unit`. Returns a dict: `values`, a list of pairs of a name and an array (thickness,
/// place); and what they share.
#[pyfunction]
pub fn simulate_places(
    py: Python<'_>,
    options: Simulation,
    places: Vec<[f64; 2]>,
    unit: String,
    running: Running,
) -> PyResult<Py<PyDict>> {
    type Values = Vec<(String, Array2<f32>)>;
    let work = move |guest: &Guest| -> Result<(Values, Vec<[f64; 2]>, Planned), Fault> {
        let mut planned = options.plans(guest)?;
        let [x, y, _] = planned.specimen.size;
        let unit = length_unit(&unit, [x, y])?;
        let places: Vec<_> = places.iter().map(|p| [p[0] * unit[0], p[1] * unit[1]]).collect();
        check_places(&places, [x, y])?;
        // As many probes that share no waves, for an estimate of memory.
        let step_angstrom = [1e3, 0.0];
        planned.scan = Scan { step_angstrom, shape: [1, places.len()], ..planned.scan };
        planned.warnings.iter().for_each(|warning| guest.warn(warning));
        options.check_memory(&planned)?;
        let frames = planned.specimen.frames();
        let series = engine_places(&planned.plans, &frames, &places, guest)?;
        let mut values = Vec::new();
        let defoci = &options.microscope.defocus_angstrom;
        for ((plan, images), defocus) in planned.plans.iter().zip(&series).zip(defoci) {
            for (n, detector) in plan.settings.detectors.iter().enumerate() {
                let row = images.data.index_axis(Axis(1), n).index_axis_move(Axis(1), 0);
                values.push((options.name(&detector.name, *defocus), row.to_owned()));
            }
        }
        Ok((values, places, planned))
    };
    let (values, places, planned) = run(py, running, work)?;
    let plan = &planned.plans[0];
    let values: Vec<_> = values.into_iter().map(|(n, v)| (n, v.into_pyarray(py))).collect();
    let out = PyDict::new(py);
    out.set_item("values", values)?;
    out.set_item("places_angstrom", places)?;
    out.set_item("thicknesses_angstrom", plan.thicknesses_angstrom())?;
    out.set_item("box_angstrom", planned.specimen.size)?;
    out.set_item("settings", serde_json::to_string(&plan.settings).map_err(Fault::from).told(py)?)?;
    out.set_item("band_limit_mrad", plan.band_limit_mrad)?;
    Ok(out.unbind())
}

/// What a simulation would do and take, as JSON. Nothing is simulated but what an accuracy needs.
#[pyfunction]
pub fn plan_simulation(py: Python<'_>, options: Simulation, running: Running) -> PyResult<String> {
    run(py, running, move |guest| {
        let planned = options.plans(guest)?;
        let [x, y, _] = planned.specimen.size;
        let source = options.microscope.source();
        let blur = source.map(|source| SourceBlur::new(source, &planned.scan, [x, y]));
        let blur = blur.transpose()?;
        let scan = blur.as_ref().map_or(&planned.scan, |blur| blur.scan());
        let plan = &planned.plans[0];
        let raster = ProbeRaster::new(plan, scan)?;
        let cost = Cost::with_atoms(plan, scan, &planned.specimen.sites);
        let cost = cost.for_probes(raster.scan().len());
        let runs = planned.plans.len() * planned.specimen.frames().len();
        let mut report = PlanReport::new(plan, &cost, runs);
        report.warnings = planned.warnings.clone();
        let memory = check_memory(report.memory_bytes, cost.memory_remedy(threads()));
        report.warnings.extend(memory.err().map(|e| e.to_string()));
        let mut report = serde_json::to_value(report)?;
        report["atoms"] = planned.specimen.sites.len().into();
        report["composition"] = serde_json::to_value(planned.specimen.composition())?;
        report["box_angstrom"] = serde_json::json!(planned.specimen.size);
        report["strain_percent"] = serde_json::json!(planned.specimen.strain_percent);
        report["scan_shape"] = serde_json::json!(planned.scan.shape);
        report["scan_step_angstrom"] = serde_json::json!(planned.scan.step_angstrom);
        report["scan_origin_angstrom"] = serde_json::json!(planned.scan.origin_angstrom);
        Ok(report.to_string())
    })
}

/// What a plane wave becomes: a dict with `exit_waves` (configuration, y, x), and `images`, (y, x) for each defocus.
#[pyfunction]
pub fn simulate_plane_wave(
    py: Python<'_>,
    options: Simulation,
    running: Running,
) -> PyResult<Py<PyDict>> {
    type Waves = (Array3<Complex32>, Vec<Array3<f32>>, [f64; 2]);
    let work = move |guest: &Guest| -> Result<Waves, Fault> {
        let specimen = options.specimen.prepare(&options.atoms)?;
        if !specimen.more_frames.is_empty() {
            return Err(Fault::Words("a plane wave images one structure; leave frames out".into()));
        }
        let mut plans = Vec::new();
        for defocus in &options.microscope.defocus_angstrom {
            let phonons = options.specimen.phonons();
            let settings = settings(&options.microscope, &options.numerics, phonons, *defocus)?;
            let settings = plane_wave_settings(settings)?;
            plans.push(Plan::new(&settings, specimen.size, &specimen.heights)?);
        }
        let lenses: Vec<_> = plans.iter().map(|plan| plan.settings.optics.clone()).collect();
        let Some(plan) = plans.first() else { return Err(Fault::Words("no defocus".into())) };
        let doubts = specimen.warnings.iter().cloned().chain(options.microscope.doubts());
        plan.warnings.iter().cloned().chain(doubts).for_each(|warning| guest.warn(&warning));
        let Conventional { exit_waves, images } = plane_wave(plan, &lenses, &specimen, guest)?;
        Ok((exit_waves, images, plan.wave_grid.sampling_angstrom()))
    };
    let (waves, images, step_angstrom) = run(py, running, work)?;
    let out = PyDict::new(py);
    let image = |image: Array3<f32>| image.index_axis_move(Axis(0), 0).into_pyarray(py);
    let images: Vec<Bound<'_, PyArray2<f32>>> = images.into_iter().map(image).collect();
    let waves: Bound<'_, PyArray3<Complex32>> = waves.into_pyarray(py);
    out.set_item("exit_waves", waves)?;
    out.set_item("images", images)?;
    out.set_item("step_angstrom", step_angstrom)?;
    Ok(out.unbind())
}

/// The diffraction pattern of a probe at a place (x, y) in Angstrom: a dict with `data` (ky, kx) in FFT order, and the step (x, y) of
/// its pixels in mrad.
#[pyfunction]
pub fn diffraction(
    py: Python<'_>,
    options: Simulation,
    position_angstrom: [f64; 2],
    running: Running,
) -> PyResult<Py<PyDict>> {
    let work = move |guest: &Guest| -> Result<(Array2<f32>, [f64; 2], f64), Fault> {
        let planned = options.plans(guest)?;
        let plan = &planned.plans[0];
        planned.warnings.iter().for_each(|warning| guest.warn(warning));
        let [x, y, _] = planned.specimen.size;
        check_places(&[position_angstrom], [x, y])?;
        let pattern = mean_diffraction(plan, &planned.specimen.sites, position_angstrom, guest)?;
        let wavelength = plan.settings.optics.wavelength_angstrom();
        let step = plan.wave_grid.extent_angstrom.map(|extent| 1e3 * wavelength / extent);
        Ok((pattern, step, plan.band_limit_mrad))
    };
    let (pattern, step_mrad, band_limit_mrad) = run(py, running, work)?;
    let out = PyDict::new(py);
    out.set_item("data", pattern.into_pyarray(py))?;
    out.set_item("step_mrad", step_mrad)?;
    out.set_item("band_limit_mrad", band_limit_mrad)?;
    Ok(out.unbind())
}
