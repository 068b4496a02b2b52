//! Simulates images of atoms.

use crate::errors::{Fault, OrRaise};
use crate::long_call::{LongCall, Running, run};
use crate::request::{AtomArrays, Request};
use ndarray::{Array2, Array3, Array5, Axis};
use num_complex::Complex32;
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stemgen::engine::Plan;
use stemgen::progress::Progress;
use stemgen::simulation::{LengthUnit, SimulatedImage, SimulationJob};

/// Passes on warnings. Refuses a simulation that needs more memory than is free, unless `force` is set.
pub(crate) fn check(job: &SimulationJob, force: bool, call: &LongCall) -> Result<(), Fault> {
    job.warnings().iter().for_each(|warning| call.warn(&warning.message));
    if !force {
        job.check_memory()?;
    }
    Ok(())
}

/// Returns the facts that all images of a plan share.
fn shared_facts<'py>(
    py: Python<'py>,
    job: &SimulationJob,
    plan: &Plan,
) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("thicknesses_angstrom", plan.thicknesses_angstrom())?;
    out.set_item("box_angstrom", job.specimen().size_angstrom)?;
    out.set_item(
        "settings",
        serde_json::to_string(&plan.settings).map_err(Fault::from).or_raise(py)?,
    )?;
    out.set_item("band_limit_mrad", plan.band_limit_mrad)?;
    Ok(out)
}

/// Simulates images. Returns a dict with their shared facts, and with `images`, a list of dicts with `name`, `data`, `counts`,
/// `counted_mrad`, `units`, `defocus_angstrom`, `annulus_mrad`, `sector_degrees`.
#[pyfunction]
pub fn simulate(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    force: bool,
    running: Running,
) -> PyResult<Py<PyDict>> {
    let work = move |call: &LongCall| -> Result<(Vec<SimulatedImage>, SimulationJob), Fault> {
        let mut job = request.job(atoms.as_ref())?;
        job.choose_accuracy(call)?;
        check(&job, force, call)?;
        Ok((job.run(call)?, job))
    };
    let (images, job) = run(py, running, work)?;
    let mut listed = Vec::new();
    for image in images {
        let item = PyDict::new(py);
        item.set_item("name", image.name)?;
        item.set_item("data", image.data.into_pyarray(py))?;
        item.set_item("counts", image.counts.map(|counts| counts.into_pyarray(py)))?;
        item.set_item("counted_mrad", image.counted_mrad.map(|angles| angles.into_pyarray(py)))?;
        item.set_item("units", image.units)?;
        item.set_item("defocus_angstrom", image.defocus_angstrom)?;
        item.set_item("annulus_mrad", image.annulus_mrad)?;
        item.set_item("sector_degrees", image.sector_degrees)?;
        listed.push(item);
    }
    let accuracy = job.accuracies().iter().map(serde_json::to_string);
    let accuracy = accuracy.collect::<Result<Vec<_>, _>>().map_err(Fault::from).or_raise(py)?;
    let out = shared_facts(py, &job, &job.plans()[0])?;
    out.set_item("images", listed)?;
    out.set_item("electrons_per_pixel", job.electrons_per_pixel())?;
    out.set_item("strain_percent", job.specimen().strain_percent)?;
    out.set_item("step_angstrom", job.scan().step_angstrom)?;
    out.set_item("origin_angstrom", job.scan().origin_angstrom)?;
    out.set_item("accuracy", accuracy)?;
    Ok(out.unbind())
}

/// Simulates single probes at `places` (x, y) in `unit`. Returns a dict with their shared facts, and with `values`, a list of pairs of a
/// name and an array (thickness, place).
#[pyfunction]
pub fn simulate_places(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    places: Vec<[f64; 2]>,
    unit: Unit,
    force: bool,
    running: Running,
) -> PyResult<Py<PyDict>> {
    type Values = Vec<(String, Array2<f32>)>;
    let work = move |call: &LongCall| -> Result<(Values, Vec<[f64; 2]>, SimulationJob), Fault> {
        let job = request.job(atoms.as_ref())?;
        let [x, y, _] = job.specimen().size_angstrom;
        let unit = unit.0.angstrom([x, y]);
        let places: Vec<_> = places.iter().map(|p| [p[0] * unit[0], p[1] * unit[1]]).collect();
        check(&job, true, call)?;
        let series = job.probes(&places, force, call)?;
        let mut values = Vec::new();
        let mut names = job.image_names().into_iter();
        for images in &series {
            for row in images.data.axis_iter(Axis(1)) {
                let row = row.index_axis_move(Axis(1), 0).to_owned();
                values.push((names.next().unwrap_or_default(), row));
            }
        }
        Ok((values, places, job))
    };
    let (values, places, job) = run(py, running, work)?;
    let values: Vec<_> = values.into_iter().map(|(n, v)| (n, v.into_pyarray(py))).collect();
    let out = shared_facts(py, &job, &job.plans()[0])?;
    out.set_item("values", values)?;
    out.set_item("places_angstrom", places)?;
    Ok(out.unbind())
}

/// A unit of length: `"cell"`, `"nm"` or `"angstrom"`.
pub struct Unit(LengthUnit);

impl<'a, 'py> FromPyObject<'a, 'py> for Unit {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let word: String = object.extract()?;
        let known = [
            ("cell", LengthUnit::Cell),
            ("nm", LengthUnit::Nm),
            ("angstrom", LengthUnit::Angstrom),
            ("A", LengthUnit::Angstrom),
        ];
        let found = crate::words::choice(stemgen::Setting::Region, &word, &known);
        found.map(Unit).or_raise(object.py())
    }
}

/// Estimates size, memory and time of a simulation. Returns them as JSON. To choose the engine it may simulate a sample of probes, for at
/// most two seconds.
#[pyfunction]
pub fn plan_simulation(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    running: Running,
) -> PyResult<String> {
    run(py, running, move |call| {
        let mut job = request.job(atoms.as_ref())?;
        job.choose_quickly(call)?;
        let (specimen, scan) = (job.specimen(), job.scan());
        let mut report = serde_json::to_value(job.report()?)?;
        report["atoms"] = specimen.sites.len().into();
        report["composition"] = serde_json::to_value(specimen.composition())?;
        report["box_angstrom"] = serde_json::json!(specimen.size_angstrom);
        report["strain_percent"] = serde_json::json!(specimen.strain_percent);
        report["scan_shape"] = serde_json::json!(scan.shape);
        report["scan_step_angstrom"] = serde_json::json!(scan.step_angstrom);
        report["scan_origin_angstrom"] = serde_json::json!(scan.origin_angstrom);
        Ok(report.to_string())
    })
}

/// Propagates a plane wave. Returns a dict with `exit_waves` (configuration, y, x), and `images`, (y, x) for each defocus.
#[pyfunction]
pub fn simulate_plane_wave(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    force: bool,
    running: Running,
) -> PyResult<Py<PyDict>> {
    type Waves = (Array3<Complex32>, Vec<Array3<f32>>, [f64; 2]);
    let work = move |call: &LongCall| -> Result<Waves, Fault> {
        let job = request.job(atoms.as_ref())?;
        check(&job, force, call)?;
        let (_, waves) = job.plane_wave(call)?;
        Ok((waves.exit_waves, waves.images, job.scan().step_angstrom))
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

/// Makes the exit waves of probes at places (x, y) in Angstrom. Returns a dict with `data`, a list with an array (configuration, place,
/// thickness, y, x) for each defocus, `sampling_angstrom` (x, y), and `thicknesses_angstrom`.
#[pyfunction]
pub fn exit_waves(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    positions_angstrom: Vec<[f64; 2]>,
    force: bool,
    running: Running,
) -> PyResult<Py<PyDict>> {
    type Waves = (Vec<Array5<Complex32>>, [f64; 2], Vec<f64>);
    let work = move |call: &LongCall| -> Result<Waves, Fault> {
        let job = request.job(atoms.as_ref())?;
        let waves = job.exit_waves(&positions_angstrom, force, call)?;
        let [x, y, _] = job.specimen().size_angstrom;
        let (_, _, _, ny, nx) = waves[0].dim();
        Ok((waves, [x / nx as f64, y / ny as f64], job.plans()[0].thicknesses_angstrom()))
    };
    let (waves, sampling, thicknesses) = run(py, running, work)?;
    let waves: Vec<_> = waves.into_iter().map(|w| w.into_pyarray(py)).collect();
    let out = PyDict::new(py);
    out.set_item("data", waves)?;
    out.set_item("sampling_angstrom", sampling)?;
    out.set_item("thicknesses_angstrom", thicknesses)?;
    Ok(out.unbind())
}

/// Simulates the diffraction pattern of a probe at a place (x, y) in Angstrom. Returns a dict with `data` (ky, kx) in FFT order, and the
/// step (x, y) of its pixels in mrad.
#[pyfunction]
pub fn diffraction(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    position_angstrom: [f64; 2],
    force: bool,
    running: Running,
) -> PyResult<Py<PyDict>> {
    let work = move |call: &LongCall| -> Result<(Array2<f32>, [f64; 2], f64), Fault> {
        let job = request.job(atoms.as_ref())?;
        check(&job, force, call)?;
        let (pattern, step_mrad) = job.diffraction(position_angstrom, call)?;
        Ok((pattern, step_mrad, job.plans()[0].band_limit_mrad))
    };
    let (pattern, step_mrad, band_limit_mrad) = run(py, running, work)?;
    let out = PyDict::new(py);
    out.set_item("data", pattern.into_pyarray(py))?;
    out.set_item("step_mrad", step_mrad)?;
    out.set_item("band_limit_mrad", band_limit_mrad)?;
    Ok(out.unbind())
}
