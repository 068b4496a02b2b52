//! Reads world files.

use crate::errors::{Fault, OrRaise, error};
use crate::long_call::{Running, run};
use ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use stemgen::Setting;
use stemgen::files::{atomic_write, outputs::check_outputs};
use stemgen::io::WorldFile;
use stemgen::render::image_pictures::{self, GreyScale};
use stemgen::render::{Colormap, Overlay, WorldPart, WorldPicture};

use crate::words::choice;

/// Number of bytes for the name of a defect, and for a composition.
const DEFECT_NAME: usize = 16;
const COMPOSITION: usize = 32;

/// An open file, and the id of the process that opened it.
struct Opened {
    process: u32,
    file: WorldFile,
}

/// A world file. The first read opens it. In a forked process the next read opens it again.
#[pyclass(frozen, module = "stemworlds._core")]
pub struct WorldReader {
    path: PathBuf,
    opened: Mutex<Option<Opened>>,
}

impl WorldReader {
    fn opened(&self) -> Result<MutexGuard<'_, Option<Opened>>, Fault> {
        let mut guard = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        let process = std::process::id();
        if let Some(other) = guard.take_if(|opened| opened.process != process) {
            // The open file belongs to the parent process, so this process must not close it.
            std::mem::forget(other);
        }
        if guard.is_none() {
            *guard = Some(Opened { process, file: WorldFile::open(&self.path)? });
        }
        Ok(guard)
    }

    /// Calls `read` without the interpreter's lock.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        read: impl FnOnce(&WorldFile) -> Result<T, Fault> + Send,
    ) -> PyResult<T> {
        let found = py.detach(|| match &*self.opened()? {
            Some(opened) => read(&opened.file),
            None => Err(Fault::Internal("the file is not open".into())),
        });
        found.map_err(|fault| error(py, fault))
    }
}

type Rows = (usize, usize);

/// Calls `read` with the images of a detector. Without a name it uses the main detector.
fn on_detector<T>(
    world: &WorldFile,
    detector: Option<&str>,
    read: impl FnOnce(&WorldFile) -> Result<T, Fault>,
) -> Result<T, Fault> {
    match detector {
        None => read(world),
        Some(name) => read(&world.on_detector(name)?),
    }
}

#[pymethods]
impl WorldReader {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let reader = WorldReader { path, opened: Mutex::new(None) };
        reader.with(py, |_| Ok(()))?;
        Ok(reader)
    }

    /// Closes the file. The next read opens it again.
    fn close(&self) {
        *self.opened.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Returns the metadata of the world as JSON.
    fn metadata(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |world| {
            let m = world.metadata();
            let facts = serde_json::json!({
                "pixel_nm": m.pixel_size_nm,
                "tile_size_px": m.tile_size_px,
                "overlap_px": m.overlap_px,
                "grid": m.grid_shape,
                "shape": world.shape(),
                "fov_nm": m.fov_nm,
                "scaling": m.scaling,
                "recipe": m.recipe,
                "version": m.version,
                "source": m.source,
                "engine": m.engine,
                "engine_parameters": m.engine_parameters,
                "material": m.material,
                "thickness_nm": m.thickness_nm,
                "dose_electrons_per_angstrom2": m.dose_electrons_per_angstrom2,
                "noise": m.noise,
                "seed": m.seed,
                "wall_time_s": m.wall_time_s,
                "has_clean": world.has_clean(),
                "detectors": world.detectors(),
                "phases": world.phase_names()?,
                "site_count": world.site_count()?,
            });
            Ok(facts.to_string())
        })
    }

    /// Returns a tile, [y, x].
    fn tile<'py>(
        &self,
        py: Python<'py>,
        row: usize,
        column: usize,
        clean: bool,
        detector: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let read = |world: &WorldFile| {
            let [rows, columns] = world.metadata().grid_shape;
            if row >= rows || column >= columns {
                let expected = format!("the world has {rows} x {columns} tiles, counted from 0");
                return Err(Fault::Value(Setting::Grid, format!("{row}, {column}"), expected));
            }
            if clean {
                // If there is no clean image, this call returns the reader's error.
                world.stitched_clean(0..1, 0..1)?;
                return Ok(world.clean_tile(row, column)?);
            }
            Ok(world.tile(row, column)?)
        };
        let tile = self.with(py, |world| on_detector(world, detector, read))?;
        Ok(tile.into_pyarray(py))
    }

    /// Returns the image of some rows and columns of pixels, [y, x].
    fn image<'py>(
        &self,
        py: Python<'py>,
        rows: Rows,
        columns: Rows,
        clean: bool,
        detector: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let read = |world: &WorldFile| {
            let (rows, columns) = (rows.0..rows.1, columns.0..columns.1);
            Ok(match clean {
                true => world.stitched_clean(rows, columns)?,
                false => world.stitched(rows, columns)?,
            })
        };
        let image = self.with(py, |world| on_detector(world, detector, read))?;
        Ok(image.into_pyarray(py))
    }

    /// Returns the overview, [y, x].
    fn overview<'py>(
        &self,
        py: Python<'py>,
        detector: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let read = |world: &WorldFile| Ok(world.overview()?);
        Ok(self.with(py, |world| on_detector(world, detector, read))?.into_pyarray(py))
    }

    /// Returns scale and offset of the images of a detector: fraction of the beam = value * scale + offset.
    fn scaling(&self, py: Python<'_>, detector: Option<&str>) -> PyResult<Option<[f64; 2]>> {
        let read = |world: &WorldFile| Ok(world.metadata().scaling);
        self.with(py, |world| on_detector(world, detector, read))
    }

    /// Returns the phases of pixels, [y, x]; `None` in a world of one phase.
    fn phase_map<'py>(
        &self,
        py: Python<'py>,
        rows: Rows,
        columns: Rows,
    ) -> PyResult<Option<Bound<'py, PyArray2<i32>>>> {
        let map =
            self.with(py, |world| Ok(world.phase_map(rows.0..rows.1, columns.0..columns.1)?))?;
        Ok(map.map(|map| map.into_pyarray(py)))
    }

    /// Returns the columns as a dict of arrays.
    fn columns(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let columns = self.with(py, |world| Ok(world.columns()?))?;
        let out = PyDict::new(py);
        let mut compositions = Vec::with_capacity(COMPOSITION * columns.len());
        let mut positions = Vec::with_capacity(columns.len());
        let mut counts = Vec::with_capacity(columns.len());
        for column in &columns {
            push_padded(&mut compositions, column.composition.as_bytes(), COMPOSITION);
            positions.push(column.position_nm);
            counts.push([column.sites, column.vacancies, column.substitutions]);
        }
        out.set_item("positions_nm", ndarray::arr2(&positions).into_pyarray(py))?;
        out.set_item("counts", ndarray::arr2(&counts).into_pyarray(py))?;
        out.set_item("compositions", PyBytes::new(py, &compositions))?;
        Ok(out.unbind())
    }

    /// Returns the lattice sites as a dict of arrays.
    fn sites(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let lists = self.with(py, |world| {
            let mut all = SiteArrays::default();
            world.for_each_chunk_of_sites(|_, truth| all.add(truth))?;
            Ok(all)
        })?;
        let out = PyDict::new(py);
        out.set_item("positions_nm", ndarray::arr2(&lists.positions).into_pyarray(py))?;
        out.set_item("z_nm", Array1::from(lists.z).into_pyarray(py))?;
        out.set_item("types", Array1::from(lists.types).into_pyarray(py))?;
        out.set_item("defects", Array1::from(lists.defects).into_pyarray(py))?;
        out.set_item("numbers", Array1::from(lists.numbers).into_pyarray(py))?;
        out.set_item("columns", Array1::from(lists.columns).into_pyarray(py))?;
        out.set_item("names", PyBytes::new(py, &lists.names))?;
        Ok(out.unbind())
    }

    /// Returns the particles as a dict of arrays.
    fn particles(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let particles = self.with(py, |world| Ok(world.particles()?))?;
        let out = PyDict::new(py);
        let names: Vec<&str> = particles.morphologies.iter().map(|name| name.as_str()).collect();
        out.set_item("centres_nm", ndarray::arr2(&particles.centres).into_pyarray(py))?;
        out.set_item("orientations", ndarray::arr2(&particles.orientations).into_pyarray(py))?;
        out.set_item("morphologies", names)?;
        out.set_item("diameters_nm", Array1::from(particles.diameters).into_pyarray(py))?;
        Ok(out.unbind())
    }

    /// Returns the boundaries of grains and phases, and planar faults: the parts that each separates, as text, and its corners (x, y) in nm.
    fn boundaries(&self, py: Python<'_>) -> PyResult<Vec<(String, Py<PyArray2<f32>>)>> {
        let lines = self.with(py, |world| Ok(world.boundary_lines()?))?;
        let array = |points: Vec<[f32; 2]>| ndarray::arr2(&points).into_pyarray(py).unbind();
        Ok(lines.into_iter().map(|line| (line.text, array(line.points_nm))).collect())
    }

    /// Returns the layers of a stack: phase, range in nm, strain along x, y and z, and turn about the beam in degrees.
    fn layers(&self, py: Python<'_>) -> PyResult<Vec<LayerFields>> {
        let rows = self.with(py, |world| Ok(world.layers()?))?;
        Ok(rows
            .into_iter()
            .map(|row| (row.phase, row.range_nm, row.strain, row.turn_deg))
            .collect())
    }

    /// Returns the dislocations: place (x, y) of the line and Burgers vector (x, y, z) in nm.
    fn dislocations(&self, py: Python<'_>) -> PyResult<Vec<([f32; 2], [f32; 3])>> {
        let rows = self.with(py, |world| Ok(world.dislocations()?))?;
        Ok(rows.into_iter().map(|row| (row.position_nm, row.burgers_nm)).collect())
    }

    /// Returns a picture of the whole world as PNG.
    fn png<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = self.with(py, |world| Ok(image_pictures::of_world(world)?))?;
        Ok(PyBytes::new(py, &bytes))
    }
}

/// A layer of a stack: phase, range in nm, strain along x, y and z, and turn about the beam in degrees.
type LayerFields = (String, [f32; 2], [f32; 3], f32);

/// Lists of sites.
#[derive(Default)]
struct SiteArrays {
    positions: Vec<[f32; 2]>,
    z: Vec<f32>,
    types: Vec<i32>,
    defects: Vec<bool>,
    numbers: Vec<i32>,
    columns: Vec<i32>,
    names: Vec<u8>,
}

impl SiteArrays {
    fn add(&mut self, truth: &stemgen::io::GroundTruth) {
        self.positions.extend(&truth.positions);
        self.z.extend(&truth.z);
        self.types.extend(&truth.types);
        self.defects.extend(&truth.defects);
        self.numbers.extend(&truth.numbers);
        self.columns.extend(&truth.columns);
        for name in &truth.defect_names {
            push_padded(&mut self.names, name.as_bytes(), DEFECT_NAME);
        }
    }
}

fn push_padded(out: &mut Vec<u8>, text: &[u8], length: usize) {
    let end = out.len() + length;
    out.extend(text.iter().take(length));
    out.resize(end, 0);
}

/// The options of a picture or page of a world.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct ViewOptions {
    world: PathBuf,
    out: PathBuf,
    html: bool,
    region_nm: Option<[f64; 4]>,
    clean: bool,
    colormap: String,
    contrast: [f64; 2],
    overlays: Vec<String>,
    size: u32,
    overwrite: bool,
}

impl ViewOptions {
    fn picture(&self) -> Result<WorldPicture, Fault> {
        use Colormap::{Gray, Inferno, Magma, Viridis};
        let colors = [("gray", Gray), ("viridis", Viridis), ("inferno", Inferno), ("magma", Magma)];
        let overlays = [
            ("defects", Overlay::Defects),
            ("phases", Overlay::Phases),
            ("boundaries", Overlay::Boundaries),
            ("particles", Overlay::Particles),
            ("columns", Overlay::Columns),
        ];
        let overlay = |name: &String| choice(Setting::Overlay, name, &overlays);
        Ok(WorldPicture {
            clean: self.clean,
            colormap: choice(Setting::Colormap, &self.colormap, &colors)?,
            contrast_percentiles: self.contrast,
            overlays: self.overlays.iter().map(overlay).collect::<Result<_, _>>()?,
            longest_side_px: self.size,
        })
    }
}

/// Draws a part of a world as PNG, or writes a page (HTML) of the world.
#[pyfunction]
pub fn view_world(py: Python<'_>, options: ViewOptions, running: Running) -> PyResult<()> {
    run(py, running, move |_| {
        let world = WorldFile::open(&options.world)?;
        let picture = options.picture()?;
        check_outputs([&options.out], [&options.world], options.overwrite)?;
        if !options.html {
            let part = WorldPart::of_region(&world, options.region_nm)?;
            return Ok(part.picture(&picture, &world)?.write_png(&options.out)?);
        }
        let title = options.world.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(picture.page(&world, title, options.region_nm)?.write(&options.out)?)
    })
}

/// Returns an image with pixels (x, y) in Angstrom as PNG.
#[pyfunction]
pub fn png<'py>(
    py: Python<'py>,
    image: numpy::PyReadonlyArray2<'py, f32>,
    step_angstrom: [f64; 2],
    scale_bar: bool,
    grey_bar: bool,
) -> PyResult<Bound<'py, PyBytes>> {
    let image: Array2<f32> = image.as_array().to_owned();
    let scale = GreyScale { scale_bar, grey_bar, limits: None };
    let bytes = py.detach(|| scale.png(image.view(), step_angstrom));
    Ok(PyBytes::new(py, &bytes.or_raise(py)?))
}

/// Writes bytes to a file. On an error no incomplete file remains.
#[pyfunction]
pub fn write_file(py: Python<'_>, path: PathBuf, bytes: &[u8], overwrite: bool) -> PyResult<()> {
    let write = || -> Result<(), Fault> {
        check_outputs([&path], [] as [&PathBuf; 0], overwrite)?;
        Ok(atomic_write::write(&path, bytes)?)
    };
    write().or_raise(py)
}
