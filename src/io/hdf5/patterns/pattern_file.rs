//! Files of diffraction patterns (4D-STEM), one for each thickness and defocus. Their schema is here only.
//!
//! One HDF5 file that py4DSTEM, LiberTEM and HyperSpy open (end its name in `.emd`), laid out as EMD 1.0 (emdfile 0.0.16):
//! - `/datacube_root/datacube/data`: float32 fractions of the beam, or uint32 electrons, (y, x, ky, kx), uncompressed; k = 0 is at pixel
//!   n / 2 of each axis, x runs right and y down; `dim0` to `dim3` hold the axes in A and 1/A;
//! - in place of it, of sums over rings: `/datacube_root/radial/data`, (y, x, ring), with the angles of the rings' middles in mrad;
//! - `/datacube_root/metadatabundle/calibration`: what py4DSTEM calibrates by;
//! - `/entry/diffraction` (NXdata) leads to the same array by a link;
//! - `/vacuum/data`: the pattern of the beam without a specimen;
//! - `/` attributes: `format` ("stemgen patterns"), `format_version`, attributes of image files (request, settings, command), `energy_kev`,
//!   `semiangle_mrad`, `defocus_angstrom` (positive: underfocus) and `c10_angstrom` (its negative), `thickness_angstrom`,
//!   `pixel_mrad`, `max_angle_mrad`, `step_angstrom` and `origin_angstrom` (x, y), `coherent_tail`, `engine`,
//!   `ring_mrad` of rings, `electrons_per_pattern` and `seed` of counted electrons;
//! - `/specimen`: the atoms, as in image files.

use std::ops::Range;
use std::path::{Path, PathBuf};

use hdf5::{Dataset, Extents, File, Group};
use ndarray::{Array2, Array3, Array4, ArrayView4, Axis};

use super::hspy_patterns;
use super::pattern_format::PatternFormat;
use super::raw_patterns::{CsrWriter, EmpadWriter};
use crate::detect::{MOST_PIXELS, PatternDetector, PixelatedDetector, RadialBins};
use crate::engine::Scan;
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::io::hdf5::hdf5_create::{self, number, text};
use crate::io::hdf5::hdf5_guard::{
    Guarded, check_storage, damaged, number as number_of, pair, text as text_of,
};
use crate::io::hdf5::hdf5_open::{self, regular_file};
use crate::io::hdf5::images::image_file::{Origin, axes, write_origin, write_specimen};
use crate::io::hdf5::{At, hdf5_values};
use crate::setting::Setting;

/// Version of this schema.
const FORMAT_VERSION: i64 = 1;
const FORMAT: &str = "stemgen patterns";
const DATA: &str = "datacube_root/datacube/data";
const RINGS: &str = "datacube_root/radial/data";
/// A chunk holds neighbouring patterns of one row, up to about so many bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// What describes the patterns of a file.
#[derive(Debug, Clone)]
pub struct PatternHeader {
    /// The detector.
    pub detector: PatternDetector,
    /// Where probes stand.
    pub scan: Scan,
    /// Thickness of the specimen in Angstrom.
    pub thickness_angstrom: f64,
    /// Defocus in Angstrom; underfocus is positive.
    pub defocus_angstrom: f64,
    /// Energy of the beam in keV.
    pub energy_kev: f64,
    /// Semiangle of the probe in mrad.
    pub semiangle_mrad: f64,
    /// Electron wavelength in Angstrom.
    pub wavelength_angstrom: f64,
    /// Electrons of each pattern, and the seed, where they are counted.
    pub counted: Option<(f64, u64)>,
}

/// What only a writer knows of a file.
#[derive(Debug, Clone)]
pub(crate) struct PatternOrigin<'a> {
    /// Command, request and atoms.
    pub origin: &'a Origin<'a>,
    /// How waves were propagated.
    pub engine: String,
    /// Whether what windows cut off the probe was added.
    pub coherent_tail: bool,
    /// The beam without a specimen.
    pub vacuum: &'a Array2<f32>,
}

/// A file of patterns that is being written.
pub(crate) struct PatternWriter {
    path: PathBuf,
    sink: PatternSink,
}

/// What takes the patterns.
enum PatternSink {
    Hdf5(File, Dataset),
    SparseCsr(CsrWriter),
    Empad(EmpadWriter),
}

/// Writes files of patterns, each of which appears complete or not at all: `fill` gets a writer for each. Existing files are replaced
/// only if `overwrite`. The endings of their names decide what they are ([`PatternFormat`]).
///
/// # Errors
/// [`Error::Io`], [`Error::Hdf5`], and errors of `fill`.
pub(crate) fn write_patterns(
    files: &[(PathBuf, PatternHeader)],
    overwrite: bool,
    origin: &PatternOrigin<'_>,
    fill: &mut dyn FnMut(&mut [PatternWriter]) -> Result<()>,
) -> Result<()> {
    next_file((files, overwrite, origin), Vec::new(), fill)
}

fn next_file(
    (files, overwrite, origin): (&[(PathBuf, PatternHeader)], bool, &PatternOrigin<'_>),
    mut open: Vec<PatternWriter>,
    fill: &mut dyn FnMut(&mut [PatternWriter]) -> Result<()>,
) -> Result<()> {
    let Some(((path, header), rest)) = files.split_first() else {
        fill(&mut open)?;
        return open.iter_mut().try_for_each(PatternWriter::end);
    };
    let mut parts = vec![path.clone()];
    parts.extend(PatternFormat::of(path)?.companions(path));
    together(&parts, overwrite, Vec::new(), &mut |temporaries| {
        let mut open = std::mem::take(&mut open);
        open.push(PatternWriter::new(temporaries, path, header, origin)?);
        next_file((rest, overwrite, origin), open, fill)
    })
}

/// Has `write` fill temporary files in place of several, which then get their names, the first last.
fn together(
    paths: &[PathBuf],
    overwrite: bool,
    mut temporaries: Vec<PathBuf>,
    write: &mut dyn FnMut(&[PathBuf]) -> Result<()>,
) -> Result<()> {
    let Some((path, rest)) = paths.split_first() else { return write(&temporaries) };
    atomic_write::write_with(path, overwrite, |temporary| {
        temporaries.push(temporary.to_owned());
        together(rest, overwrite, temporaries, write)
    })
}

impl PatternWriter {
    fn new(
        temporaries: &[PathBuf],
        path: &Path,
        header: &PatternHeader,
        origin: &PatternOrigin<'_>,
    ) -> Result<Self> {
        let temporary = &temporaries[0];
        let hdf5 = |write: &dyn Fn() -> hdf5::Result<(File, Dataset)>| {
            write().at(path).map(|(file, data)| PatternSink::Hdf5(file, data))
        };
        let sink = match PatternFormat::of(path)? {
            PatternFormat::Emd => hdf5(&|| emd(temporary, header, origin))?,
            PatternFormat::Hspy => hdf5(&|| hspy(temporary, path, header, origin))?,
            PatternFormat::SparseCsr => {
                PatternSink::SparseCsr(CsrWriter::new(temporaries, path, header, origin)?)
            }
            PatternFormat::Empad => {
                PatternSink::Empad(EmpadWriter::new(temporaries, path, header, origin)?)
            }
        };
        Ok(PatternWriter { path: path.to_owned(), sink })
    }

    /// Writes rows of fractions of the beam, from `first_row` on, (row, column, ky, kx). Rows come from the first to the last.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Hdf5`]; a sparse file, which holds counted electrons.
    pub(crate) fn fractions(&mut self, first_row: usize, rows: ArrayView4<'_, f32>) -> Result<()> {
        match &mut self.sink {
            PatternSink::Hdf5(_, data) => put_rows(data, first_row, rows).at(&self.path),
            PatternSink::Empad(frames) => frames.put(rows, |v| v),
            PatternSink::SparseCsr(_) => {
                let expected = "holds counted electrons";
                Err(Error::invalid(Setting::OutputName, self.path.display(), expected))
            }
        }
    }

    /// Writes rows of counted electrons, from `first_row` on, (row, column, ky, kx). Rows come from the first to the last.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Hdf5`].
    pub(crate) fn counts(&mut self, first_row: usize, rows: ArrayView4<'_, u32>) -> Result<()> {
        match &mut self.sink {
            PatternSink::Hdf5(_, data) => put_rows(data, first_row, rows).at(&self.path),
            PatternSink::Empad(frames) => frames.put(rows, |v| v as f32),
            PatternSink::SparseCsr(arrays) => arrays.counts(rows),
        }
    }

    fn end(&mut self) -> Result<()> {
        match &mut self.sink {
            PatternSink::Hdf5(file, _) => file.flush().at(&self.path),
            PatternSink::Empad(frames) => frames.end(),
            PatternSink::SparseCsr(arrays) => arrays.end(),
        }
    }
}

fn put_rows<T: hdf5::H5Type + Clone>(
    data: &Dataset,
    first_row: usize,
    rows: ArrayView4<'_, T>,
) -> hdf5::Result<()> {
    let end = first_row + rows.dim().0;
    match data.ndim() {
        3 => {
            let rings = rows.index_axis(Axis(2), 0);
            let at = ndarray::s![first_row..end, .., ..];
            data.write_slice(&rings.as_standard_layout(), at)
        }
        _ => {
            let at = ndarray::s![first_row..end, .., .., ..];
            data.write_slice(&rows.as_standard_layout(), at)
        }
    }
}

fn emd(
    temporary: &Path,
    header: &PatternHeader,
    origin: &PatternOrigin<'_>,
) -> hdf5::Result<(File, Dataset)> {
    let file = hdf5_create::file(temporary)?;
    write_origin(&file, FORMAT, FORMAT_VERSION, origin.origin)?;
    describe(&file, header, origin)?;
    if !origin.origin.sites.is_empty() {
        write_specimen(&hdf5_create::group(&file, "specimen")?, origin.origin)?;
    }
    let data = datacube(&file, header)?;
    write_entry(&file, header)?;
    let vacuum = hdf5_create::group(&file, "vacuum")?;
    let vacuum = vacuum.new_dataset_builder().with_data(origin.vacuum).create("data")?;
    text(&vacuum, "units", "fraction of the beam")?;
    Ok((file, data))
}

fn hspy(
    temporary: &Path,
    path: &Path,
    header: &PatternHeader,
    origin: &PatternOrigin<'_>,
) -> hdf5::Result<(File, Dataset)> {
    let (file, group) = hspy_patterns::begin(temporary, path, header, origin)?;
    let data = dataset(&group, header)?;
    Ok((file, data))
}

/// Bytes of the largest part of a file: its patterns.
pub fn data_bytes(header: &PatternHeader) -> u64 {
    let values = header.detector.values() as u64;
    header.scan.len() as u64 * values * size_of::<f32>() as u64
}

fn describe(file: &File, h: &PatternHeader, o: &PatternOrigin<'_>) -> hdf5::Result<()> {
    text(file, "emd_group_type", "file")?;
    number(file, "version_major", 1_i64)?;
    number(file, "version_minor", 0_i64)?;
    text(file, "authoring_program", "stemgen")?;
    text(file, "authoring_user", "")?;
    text(file, "UUID", "")?;
    number(file, "energy_kev", h.energy_kev)?;
    number(file, "semiangle_mrad", h.semiangle_mrad)?;
    number(file, "defocus_angstrom", h.defocus_angstrom)?;
    number(file, "c10_angstrom", -h.defocus_angstrom)?;
    number(file, "thickness_angstrom", h.thickness_angstrom)?;
    match h.detector {
        PatternDetector::Pixels(pixels) => number(file, "pixel_mrad", pixels.pixel_mrad())?,
        PatternDetector::Rings(rings) => number(file, "ring_mrad", rings.width_mrad)?,
    }
    number(file, "max_angle_mrad", h.detector.max_angle_mrad())?;
    array(file, "step_angstrom", &h.scan.step_angstrom)?;
    array(file, "origin_angstrom", &h.scan.origin_angstrom)?;
    text(file, "engine", &o.engine)?;
    number(file, "coherent_tail", o.coherent_tail)?;
    if let Some((electrons, seed)) = h.counted {
        number(file, "electrons_per_pattern", electrons)?;
        number(file, "seed", seed)?;
    }
    Ok(())
}

/// An axis of an array of patterns.
pub(crate) struct PatternAxis {
    /// Its name in EMD, and in NeXus and HyperSpy.
    pub names: [&'static str; 2],
    /// Its unit in EMD.
    pub unit: &'static str,
    /// First value and step.
    pub line: [f64; 2],
    pub count: usize,
}

/// The axes of an array of patterns.
pub(crate) fn axes_of(h: &PatternHeader) -> Vec<PatternAxis> {
    let ([x, y], [x0, y0]) = (h.scan.step_angstrom, h.scan.origin_angstrom);
    let [rows, columns] = h.scan.shape;
    let axis = |names, unit, line, count| PatternAxis { names, unit, line, count };
    let mut axes =
        vec![axis(["Ry", "y"], "A", [y0, y], rows), axis(["Rx", "x"], "A", [x0, x], columns)];
    match h.detector {
        PatternDetector::Pixels(pixels) => {
            let (n, k) = (pixels.pixels, pixels.pixel_k(h.wavelength_angstrom));
            let line = [-((n / 2) as f64) * k, k];
            axes.extend([["Qy", "ky"], ["Qx", "kx"]].map(|names| axis(names, "A^-1", line, n)));
        }
        PatternDetector::Rings(rings) => {
            let width = rings.width_mrad;
            axes.push(axis(["theta", "angle"], "mrad", [0.5 * width, width], rings.rings));
        }
    }
    axes
}

/// The array and its calibration, as EMD has them.
fn datacube(file: &File, h: &PatternHeader) -> hdf5::Result<Dataset> {
    let root = hdf5_create::group(file, "datacube_root")?;
    text(&root, "emd_group_type", "root")?;
    text(&root, "python_class", "Root")?;
    let (name, class) = match h.detector {
        PatternDetector::Pixels(_) => ("datacube", "DataCube"),
        PatternDetector::Rings(_) => ("radial", "Array"),
    };
    let group = hdf5_create::group(&root, name)?;
    text(&group, "emd_group_type", "array")?;
    text(&group, "python_class", class)?;
    let data = dataset(&group, h)?;
    text(&data, "units", units_of(h))?;
    for (i, axis) in axes_of(h).into_iter().enumerate() {
        let dim = places(axis.line, axis.count);
        let dim = group.new_dataset_builder().with_data(&dim).create(format!("dim{i}").as_str())?;
        text(&dim, "name", axis.names[0])?;
        text(&dim, "units", axis.unit)?;
    }
    calibration(&root, h)?;
    Ok(data)
}

/// What the values of a file are.
pub(crate) fn units_of(h: &PatternHeader) -> &'static str {
    if h.counted.is_some() { "electrons" } else { "fraction of the beam" }
}

/// The array itself, in chunks of neighbouring patterns of a row.
fn dataset(group: &Group, h: &PatternHeader) -> hdf5::Result<Dataset> {
    let shape: Vec<usize> = axes_of(h).iter().map(|axis| axis.count).collect();
    let bytes = h.detector.values() * size_of::<f32>();
    let mut chunk = shape.clone();
    chunk[0] = 1;
    chunk[1] = (CHUNK_BYTES / bytes).clamp(1, shape[1].max(1));
    let extents = Extents::from(shape);
    match h.counted {
        None => group.new_dataset::<f32>().shape(extents).chunk(chunk).create("data"),
        Some(_) => group.new_dataset::<u32>().shape(extents).chunk(chunk).create("data"),
    }
}

fn calibration(root: &Group, h: &PatternHeader) -> hdf5::Result<()> {
    let bundle = hdf5_create::group(root, "metadatabundle")?;
    text(&bundle, "emd_group_type", "metadatabundle")?;
    let group = hdf5_create::group(&bundle, "calibration")?;
    text(&group, "emd_group_type", "metadata")?;
    text(&group, "python_class", "Calibration")?;
    let put = |name: &str, value: f64| -> hdf5::Result<()> {
        let dataset = group.new_dataset::<f64>().create(name)?;
        dataset.write_scalar(&value)?;
        text(&dataset, "type", "number")
    };
    let k = match h.detector {
        PatternDetector::Pixels(pixels) => pixels.pixel_k(h.wavelength_angstrom),
        PatternDetector::Rings(rings) => 1e-3 * rings.width_mrad / h.wavelength_angstrom,
    };
    put("Q_pixel_size", k)?;
    put("R_pixel_size", h.scan.step_angstrom[0])?;
    put("energy", 1e3 * h.energy_kev)?;
    put("convergence_semiangle", h.semiangle_mrad)?;
    let words = [("Q_pixel_units", "A^-1"), ("R_pixel_units", "A"), ("_root_treepath", "")];
    for (name, value) in words {
        let dataset = group.new_dataset::<hdf5::types::VarLenUnicode>().create(name)?;
        let value: hdf5::types::VarLenUnicode =
            value.parse().map_err(|_| hdf5::Error::Internal("a NUL".into()))?;
        dataset.write_scalar(&value)?;
        text(&dataset, "type", "string")?;
    }
    let flip = group.new_dataset::<bool>().create("QR_flip")?;
    flip.write_scalar(&false)?;
    text(&flip, "type", "bool")?;
    let targets = hdf5_create::group(&group, "_target_paths")?;
    number(&targets, "length", 1_i64)?;
    text(&targets, "type", "list_of_strings")?;
    let target = targets.new_dataset::<hdf5::types::VarLenUnicode>().create("0")?;
    let value: hdf5::types::VarLenUnicode =
        (if h.detector.pixels().is_some() { "/datacube" } else { "/radial" })
            .parse()
            .map_err(|_| hdf5::Error::Internal("a NUL".into()))?;
    target.write_scalar(&value)
}

/// The array once more, as NeXus has it.
fn write_entry(file: &File, h: &PatternHeader) -> hdf5::Result<()> {
    text(file, "default", "entry")?;
    let entry = hdf5_create::group(file, "entry")?;
    text(&entry, "NX_class", "NXentry")?;
    text(&entry, "default", "diffraction")?;
    let group = hdf5_create::group(&entry, "diffraction")?;
    text(&group, "NX_class", "NXdata")?;
    text(&group, "signal", "data")?;
    let all = axes_of(h);
    axes(&group, &all.iter().map(|axis| axis.names[1]).collect::<Vec<_>>())?;
    let data = if h.detector.pixels().is_some() { DATA } else { RINGS };
    group.link_soft(&format!("/{data}"), "data")?;
    for axis in all {
        let values = places(axis.line, axis.count);
        let dataset = group.new_dataset_builder().with_data(&values).create(axis.names[1])?;
        let unit = match axis.unit {
            "A" => "angstrom",
            "A^-1" => "1/angstrom",
            other => other,
        };
        text(&dataset, "units", unit)?;
    }
    Ok(())
}

fn places([first, step]: [f64; 2], count: usize) -> Vec<f64> {
    (0..count).map(|i| first + i as f64 * step).collect()
}

fn array(at: &hdf5::Location, name: &str, values: &[f64]) -> hdf5::Result<()> {
    at.new_attr_builder().with_data(values).create(name).map(drop)
}

/// A file of patterns that this program wrote, read row by row.
pub struct PatternFile {
    path: PathBuf,
    data: Dataset,
    header: PatternHeader,
    /// The command that made it, as typed.
    pub command_line: Option<String>,
    /// The request that it was made from, as JSON.
    pub request: Option<String>,
    /// SHA-256 of the structure file that it was made from.
    pub structure_sha256: Option<String>,
    vacuum: Option<Dataset>,
}

impl PatternFile {
    /// Opens a file of patterns; `None` for other files.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Parse`] for a file that is damaged.
    pub fn open(path: &Path) -> Result<Option<Self>> {
        let bytes = regular_file(path)?;
        let Some(file) = hdf5_open::open_if_hdf5(path)? else { return Ok(None) };
        if text_of(&file, "format").as_deref() != Some(FORMAT) {
            return Ok(None);
        }
        let read = || -> Guarded<Self> {
            let rings = number_of::<f64>(&file, "ring_mrad").is_some();
            let data = file.dataset(if rings { RINGS } else { DATA }).map_err(damaged)?;
            check_storage(&data, bytes)?;
            let vacuum = file.dataset("vacuum/data").ok();
            if let Some(vacuum) = &vacuum {
                check_storage(vacuum, bytes)?;
            }
            Ok(PatternFile {
                path: path.to_owned(),
                header: header(&file, &data)?,
                data,
                command_line: text_of(&file, "command_line"),
                request: text_of(&file, "request"),
                structure_sha256: text_of(&file, "structure_sha256"),
                vacuum,
            })
        };
        read().map(Some).map_err(|fault| Error::parse(path, 0, fault))
    }

    /// What describes its patterns.
    pub fn header(&self) -> &PatternHeader {
        &self.header
    }

    /// The patterns of some rows, (row, column, ky, kx): fractions of the beam, or electrons. Of rings: (row, column, 1, ring).
    ///
    /// # Errors
    /// [`Error::Parse`] for damaged values.
    pub fn rows(&self, rows: Range<usize>) -> Result<Array4<f32>> {
        let mut ranges: Vec<Range<usize>> = self.data.shape().iter().map(|n| 0..*n).collect();
        ranges[0] = rows;
        let found = match self.header.detector {
            PatternDetector::Pixels(_) => self.part::<ndarray::Ix4>(&ranges),
            PatternDetector::Rings(_) => {
                let found: Guarded<Array3<f32>> = self.part(&ranges);
                found.map(|rings| rings.insert_axis(Axis(2)))
            }
        };
        found.map_err(|fault| Error::parse(&self.path, 0, format!("patterns: {fault}")))
    }

    fn part<D: ndarray::Dimension>(
        &self,
        ranges: &[Range<usize>],
    ) -> Guarded<ndarray::Array<f32, D>> {
        match self.header.counted {
            None => hdf5_values::part(&self.data, &self.path, ranges),
            Some(_) => hdf5_values::part::<u32, D>(&self.data, &self.path, ranges)
                .map(|counts| counts.mapv(|n| n as f32)),
        }
    }

    /// The beam without a specimen, if the file has it.
    ///
    /// # Errors
    /// [`Error::Parse`] for damaged values.
    pub fn vacuum(&self) -> Result<Option<Array2<f32>>> {
        let read = |dataset| hdf5_values::all(dataset, &self.path);
        let found = self.vacuum.as_ref().map(read).transpose();
        found.map_err(|fault| Error::parse(&self.path, 0, format!("/vacuum/data: {fault}")))
    }
}

/// What describes the patterns of a file.
fn header(file: &File, data: &Dataset) -> Guarded<PatternHeader> {
    let value = |name: &str, range: Range<f64>| {
        let found: Option<f64> = number_of(file, name);
        let inside = found.filter(|v| range.contains(v));
        inside.ok_or_else(|| format!("its attribute `{name}` is missing or invalid"))
    };
    let max_angle_mrad = value("max_angle_mrad", 1e-6..2e3)?;
    let (rows, columns, detector) = match data.shape()[..] {
        [rows, columns, ky, kx] if ky == kx && (2..=MOST_PIXELS).contains(&kx) => {
            let pixels = PixelatedDetector { pixels: kx, max_angle_mrad };
            (rows, columns, PatternDetector::Pixels(pixels))
        }
        [rows, columns, rings] => {
            let found = RadialBins::new(value("ring_mrad", 1e-6..2e3)?, max_angle_mrad);
            let found = found.ok().filter(|found| found.rings == rings);
            let found = found.ok_or_else(|| format!("holds {rings} rings, which do not fit its attributes `ring_mrad` and `max_angle_mrad`"))?;
            (rows, columns, PatternDetector::Rings(found))
        }
        _ => {
            return Err(format!(
                "holds an array of shape {:?}, not the patterns of a scan",
                data.shape()
            ));
        }
    };
    if rows == 0 || columns == 0 {
        return Err(format!("holds {rows} x {columns} patterns"));
    }
    let energy_kev = value("energy_kev", 1.0..1e4)?;
    let pairs = |name: &str| {
        let found = pair(file, name).filter(|p| p.iter().all(|v| v.is_finite()));
        found.ok_or_else(|| format!("its attribute `{name}` is missing or invalid"))
    };
    let electrons: Option<f64> = number_of(file, "electrons_per_pattern");
    let seed: Option<u64> = number_of(file, "seed");
    Ok(PatternHeader {
        detector,
        scan: Scan {
            origin_angstrom: pairs("origin_angstrom")?,
            step_angstrom: pairs("step_angstrom")?,
            shape: [rows, columns],
        },
        thickness_angstrom: value("thickness_angstrom", 0.0..1e9)?,
        defocus_angstrom: value("defocus_angstrom", -1e9..1e9)?,
        energy_kev,
        semiangle_mrad: value("semiangle_mrad", 0.0..2e3)?,
        wavelength_angstrom: value("wavelength_angstrom", 1e-6..1e3)?,
        counted: electrons.zip(seed),
    })
}
