//! Simulates, reads and writes the diffraction patterns of scans.

use crate::errors::{Fault, OrRaise};
use crate::long_call::{LongCall, Running, run};
use crate::request::{AtomArrays, Request};
use crate::simulate::check;
use ndarray::{Array2, Array4, Axis, s};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stemgen::Setting;
use stemgen::detect::{PatternDetector, PixelatedDetector, RadialBins, VirtualDetector};
use stemgen::engine::Scan;
use stemgen::files::outputs::check_outputs;
use stemgen::io::{PatternFile, PatternHeader, PatternRun, data_bytes};
use stemgen::live::{LiveRequest, LiveWorld};
use stemgen::render::html::CubePage;
use stemgen::simulation::{PatternBand, PatternValues, PatternsRequest, SimulationJob};

/// Patterns of one defocus and thickness: fractions of the beam, or counted electrons.
pub enum Cube {
    Fractions(Array4<f32>),
    Counts(Array4<u32>),
}

/// Patterns by defocus, then thickness, and the pattern of the beam without a specimen.
pub type Cubes = (Vec<(PatternHeader, Cube)>, Array2<f32>);

/// Simulates the patterns of a scan. Returns a list of dicts, by defocus, then thickness, with `data` (y, x, ky, kx) and its header.
#[pyfunction]
pub fn simulate_patterns(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    force: bool,
    running: Running,
) -> PyResult<Vec<Py<PyDict>>> {
    let work = move |call: &LongCall| -> Result<Cubes, Fault> {
        let job = request.job(atoms.as_ref())?;
        check(&job, force, call)?;
        let headers = headers(&job, force)?;
        let vacuum = job.vacuum_pattern()?;
        let mut cubes: Vec<Cube> = headers.iter().map(empty).collect();
        let each = headers.len() / job.plans().len();
        for (n, cubes) in cubes.chunks_mut(each).enumerate() {
            let mut take = |band: PatternBand<'_>| {
                cubes.iter_mut().enumerate().for_each(|(t, cube)| cube.put(&band, t));
                Ok(())
            };
            job.patterns(n, None, &mut take, call)?;
        }
        Ok((headers.into_iter().zip(cubes).collect(), vacuum))
    };
    dicts(py, run(py, running, work)?)
}

/// Simulates the patterns of a place of a live world. Returns a dict as [`simulate_patterns`] does; the place of the first probe is that in
/// the field.
pub fn record_patterns(
    world: &mut LiveWorld,
    asked: (&LiveRequest, &PatternsRequest),
    call: &LongCall,
) -> Result<Cubes, Fault> {
    let place = world.patterns_at(asked.0, asked.1)?;
    let mut headers = headers(place.job(), false)?;
    headers.truncate(1);
    for header in &mut headers {
        header.scan.origin_angstrom = place.origin_nm().map(|nm| 10.0 * nm);
    }
    let vacuum = place.job().vacuum_pattern()?;
    let mut cubes: Vec<Cube> = headers.iter().map(empty).collect();
    let mut take = |band: PatternBand<'_>| {
        cubes.iter_mut().for_each(|cube| cube.put(&band, 0));
        Ok(())
    };
    world.acquire_patterns(&place, &mut take, call)?;
    Ok((headers.into_iter().zip(cubes).collect(), vacuum))
}

/// The headers of a job's patterns. Refuses patterns that need more memory than is free, unless `force`.
fn headers(job: &SimulationJob, force: bool) -> Result<Vec<PatternHeader>, Fault> {
    let headers = PatternRun { job, output: Path::new(""), command_line: "" }.headers();
    if !force {
        let work = job.memory().map(|(bytes, _)| bytes).max().unwrap_or(0);
        let bytes = work + headers.iter().map(data_bytes).sum::<u64>();
        let remedy =
            "most of it is patterns: write them to a file (`out`), or take fewer probes or pixels";
        stemgen::engine::check_memory(bytes, remedy)?;
    }
    Ok(headers)
}

/// Makes a dict of each cube.
pub fn dicts(py: Python<'_>, (cubes, vacuum): Cubes) -> PyResult<Vec<Py<PyDict>>> {
    let dict = |(header, cube): (PatternHeader, Cube)| {
        let out = described(py, &header)?;
        match cube {
            Cube::Fractions(data) => out.set_item("data", data.into_pyarray(py))?,
            Cube::Counts(data) => out.set_item("data", data.into_pyarray(py))?,
        }
        out.set_item("vacuum", vacuum.clone().into_pyarray(py))?;
        Ok(out.unbind())
    };
    cubes.into_iter().map(dict).collect()
}

/// Simulates the patterns of a scan, and writes them to files. Returns their paths.
#[pyfunction]
pub fn write_patterns(
    py: Python<'_>,
    request: Request,
    atoms: Option<AtomArrays>,
    out: PathBuf,
    overwrite: bool,
    force: bool,
    running: Running,
) -> PyResult<Vec<PathBuf>> {
    let work = move |call: &LongCall| -> Result<Vec<PathBuf>, Fault> {
        let job = request.job(atoms.as_ref())?;
        check(&job, force, call)?;
        let asked = "stemworlds.simulate_patterns";
        let run = PatternRun { job: &job, output: &out, command_line: asked };
        let files: Vec<PathBuf> = run.files().into_iter().map(|(path, _)| path).collect();
        let inputs = job.request().structure.file().map(Path::to_path_buf);
        check_outputs(&run.outputs()?, inputs, overwrite)?;
        run.check_space()?;
        run.write(overwrite, call)?;
        Ok(files)
    };
    run(py, running, work)
}

/// A file of patterns, read row by row.
#[pyclass(frozen, module = "stemworlds._core")]
pub struct PatternReader(Arc<PatternFile>);

#[pymethods]
impl PatternReader {
    /// Opens a file that was written by this program.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = || -> Result<PatternReader, Fault> {
            match PatternFile::open(&path)? {
                Some(file) => Ok(PatternReader(Arc::new(file))),
                None => {
                    let fault = "is no file of patterns that stemgen wrote";
                    Err(stemgen::Error::parse(&path, 0, fault).into())
                }
            }
        };
        read().or_raise(py)
    }

    /// Returns the header of the patterns, with `vacuum`.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = described(py, self.0.header())?;
        let vacuum = self.0.vacuum().map_err(Fault::from).or_raise(py)?;
        out.set_item("vacuum", vacuum.map(|vacuum| vacuum.into_pyarray(py)))?;
        Ok(out)
    }

    /// Writes a page (HTML) of the patterns.
    fn page(
        &self,
        py: Python<'_>,
        title: String,
        out: PathBuf,
        overwrite: bool,
        running: Running,
    ) -> PyResult<()> {
        let file = Arc::clone(&self.0);
        run(py, running, move |call| {
            let read = |rows: Range<usize>| file.rows(rows);
            write_page(file.header(), title, &read, (&out, overwrite), call)
        })
    }

    /// Returns the patterns of the rows from `first` to `end`, without `end`.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        first: usize,
        end: usize,
    ) -> PyResult<Bound<'py, numpy::PyArray4<f32>>> {
        let rows = py.detach(|| self.0.rows(first..end).map_err(Fault::from)).or_raise(py)?;
        Ok(rows.into_pyarray(py))
    }
}

fn described<'py>(py: Python<'py>, h: &PatternHeader) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let [ky, kx] = h.detector.shape();
    out.set_item("shape", (h.scan.shape[0], h.scan.shape[1], ky, kx))?;
    out.set_item("step_angstrom", h.scan.step_angstrom)?;
    out.set_item("origin_angstrom", h.scan.origin_angstrom)?;
    out.set_item("max_angle_mrad", h.detector.max_angle_mrad())?;
    out.set_item("ring_mrad", h.detector.rings().map(|rings| rings.width_mrad))?;
    out.set_item("thickness_angstrom", h.thickness_angstrom)?;
    out.set_item("defocus_angstrom", h.defocus_angstrom)?;
    out.set_item("energy_kev", h.energy_kev)?;
    out.set_item("semiangle_mrad", h.semiangle_mrad)?;
    out.set_item("wavelength_angstrom", h.wavelength_angstrom)?;
    out.set_item("electrons_per_pattern", h.counted.map(|(electrons, _)| electrons))?;
    Ok(out)
}

fn empty(h: &PatternHeader) -> Cube {
    let ([rows, columns], [ky, kx]) = (h.scan.shape, h.detector.shape());
    match h.counted {
        None => Cube::Fractions(Array4::zeros((rows, columns, ky, kx))),
        Some(_) => Cube::Counts(Array4::zeros((rows, columns, ky, kx))),
    }
}

impl Cube {
    /// Copies the rows of a thickness to their places.
    fn put(&mut self, band: &PatternBand<'_>, thickness: usize) {
        match (self, &band.values) {
            (Cube::Fractions(data), PatternValues::Fractions(values)) => {
                let rows = values.index_axis(Axis(0), thickness);
                let at = band.first_row..band.first_row + rows.dim().0;
                data.slice_mut(s![at, .., .., ..]).assign(&rows);
            }
            (Cube::Counts(data), PatternValues::Counts(values)) => {
                let rows = values.index_axis(Axis(0), thickness);
                let at = band.first_row..band.first_row + rows.dim().0;
                data.slice_mut(s![at, .., .., ..]).assign(&rows);
            }
            // A job counts electrons in all of its patterns or in none, so the other cases do not occur.
            _ => {}
        }
    }
}

fn write_page(
    header: &PatternHeader,
    title: String,
    rows: &dyn Fn(Range<usize>) -> stemgen::Result<Array4<f32>>,
    (out, overwrite): (&PathBuf, bool),
    call: &LongCall,
) -> Result<(), Fault> {
    check_outputs([out], [] as [&PathBuf; 0], overwrite)?;
    let Some(page) = CubePage::of(header, title) else {
        let expected = "expected pixels; sums over rings have no page";
        return Err(stemgen::Error::invalid(Setting::PatternPixels, "rings", expected).into());
    };
    Ok(page.page(rows, call)?.write(out)?)
}

/// Axes and parameters of patterns in memory. Pairs of lengths are (x, y).
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct CubeAxes {
    title: String,
    step_angstrom: [f64; 2],
    origin_angstrom: [f64; 2],
    max_angle_mrad: f64,
    thickness_angstrom: f64,
    defocus_angstrom: f64,
    energy_kev: f64,
    semiangle_mrad: f64,
    wavelength_angstrom: f64,
    electrons_per_pattern: Option<f64>,
}

/// Writes a page (HTML) of patterns in memory, `[y, x, ky, kx]`.
#[pyfunction]
pub fn write_pattern_page(
    py: Python<'_>,
    data: numpy::PyReadonlyArray4<'_, f32>,
    axes: CubeAxes,
    out: PathBuf,
    overwrite: bool,
    running: Running,
) -> PyResult<()> {
    let data = data.as_array().to_owned();
    let (rows, columns, _, pixels) = data.dim();
    let header = PatternHeader {
        detector: PixelatedDetector { pixels, max_angle_mrad: axes.max_angle_mrad }.into(),
        scan: Scan {
            origin_angstrom: axes.origin_angstrom,
            step_angstrom: axes.step_angstrom,
            shape: [rows, columns],
        },
        thickness_angstrom: axes.thickness_angstrom,
        defocus_angstrom: axes.defocus_angstrom,
        energy_kev: axes.energy_kev,
        semiangle_mrad: axes.semiangle_mrad,
        wavelength_angstrom: axes.wavelength_angstrom,
        counted: axes.electrons_per_pattern.map(|electrons| (electrons, 0)),
    };
    run(py, running, move |call| {
        let read = |rows: Range<usize>| Ok(data.slice(s![rows, .., .., ..]).to_owned());
        write_page(&header, axes.title, &read, (&out, overwrite), call)
    })
}

/// Integrates images of the centre of mass (x, y) in mrad. Returns the result in radians.
#[pyfunction]
pub fn integrated_centre_of_mass<'py>(
    py: Python<'py>,
    x: numpy::PyReadonlyArray2<'py, f32>,
    y: numpy::PyReadonlyArray2<'py, f32>,
    step_angstrom: [f64; 2],
    wavelength_angstrom: f64,
) -> PyResult<Bound<'py, numpy::PyArray2<f32>>> {
    let (x, y) = (x.as_array().to_owned(), y.as_array().to_owned());
    let found =
        stemgen::detect::integrated_centre_of_mass([&x, &y], step_angstrom, wavelength_angstrom);
    Ok(found.map_err(Fault::from).or_raise(py)?.into_pyarray(py))
}

/// Returns the share of each pixel's area on a ring, or on a sector of it. `detector` holds the number of pixels along an edge, the largest
/// angle, and the width of rings, if patterns are sums over rings.
#[pyfunction]
pub fn detector_weights<'py>(
    py: Python<'py>,
    detector: (usize, f64, Option<f64>),
    annulus_mrad: [f64; 2],
    sector_degrees: Option<[f64; 2]>,
    centre_mrad: [f64; 2],
) -> PyResult<Bound<'py, numpy::PyArray2<f32>>> {
    let name = "detector".to_owned();
    let wanted = VirtualDetector { name, annulus_mrad, sector_degrees, centre_mrad };
    let (pixels, max_angle_mrad, ring_mrad) = detector;
    let on = || match ring_mrad {
        None => Ok(PixelatedDetector { pixels, max_angle_mrad }.into()),
        Some(width) => RadialBins::new(width, max_angle_mrad).map(PatternDetector::Rings),
    };
    let weights = on().and_then(|on| on.weights(&wanted));
    Ok(weights.map_err(Fault::from).or_raise(py)?.into_pyarray(py))
}
