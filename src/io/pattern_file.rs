//! Files of diffraction patterns (4D-STEM), one for each thickness and defocus. Their schema is here only.
//!
//! One HDF5 file that py4DSTEM, LiberTEM and HyperSpy open (end its name in `.emd`), laid out as EMD 1.0 (emdfile 0.0.16):
//! - `/datacube_root/datacube/data`: float32 fractions of the beam, or uint32 electrons, (y, x, ky, kx), uncompressed; k = 0 is at pixel
//!   n / 2 of each axis, x runs right and y down; `dim0` to `dim3` hold the axes in A and 1/A;
//! - `/datacube_root/metadatabundle/calibration`: what py4DSTEM calibrates by;
//! - `/entry/diffraction` (NXdata) leads to the same array by a link;
//! - `/vacuum/data`: the pattern of the beam without a specimen;
//! - `/` attributes: `format` ("stemgen patterns"), `format_version`, those of image files (request, settings, command), `energy_kev`,
//!   `semiangle_mrad`, `defocus_angstrom` (positive: underfocus) and `c10_angstrom` (its negative), `thickness_angstrom`,
//!   `pixel_mrad`, `max_angle_mrad`, `step_angstrom` and `origin_angstrom` (x, y), `coherent_tail`, `engine`,
//!   `electrons_per_pattern` and `seed` of counted electrons;
//! - `/specimen`: the atoms, as in image files.

use std::ops::Range;
use std::path::{Path, PathBuf};

use hdf5::{Dataset, Extents, File, Group};
use ndarray::{Array2, Array4, ArrayView4};

use super::At;
use super::hdf5_create;
use super::hdf5_guard::{
    Guarded, check_storage, damaged, number as number_of, pair, text as text_of,
};
use super::hdf5_values;
use super::image_file::{Origin, axes, write_origin, write_specimen};
use super::world_file::regular_file;
use super::world_writer::{number, text};
use crate::detect::{MOST_PIXELS, PixelatedDetector};
use crate::engine::Scan;
use crate::error::{Error, Result};
use crate::files::atomic_write;

/// Version of this schema.
const FORMAT_VERSION: i64 = 1;
const FORMAT: &str = "stemgen patterns";
const DATA: &str = "datacube_root/datacube/data";
/// A chunk holds neighbouring patterns of one row, up to about so many bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// What describes the patterns of a file.
#[derive(Debug, Clone)]
pub struct PatternHeader {
    /// The detector.
    pub detector: PixelatedDetector,
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
pub struct PatternOrigin<'a> {
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
pub struct PatternWriter {
    path: PathBuf,
    file: File,
    data: Dataset,
}

/// Writes files of patterns, each of which appears complete or not at all: `fill` gets a writer for each. Existing files are replaced
/// only if `overwrite`.
///
/// # Errors
/// [`Error::Io`], [`Error::Hdf5`], and those of `fill`.
pub fn write_patterns(
    files: &[(PathBuf, PatternHeader)],
    overwrite: bool,
    origin: &PatternOrigin<'_>,
    fill: &mut dyn FnMut(&mut [PatternWriter]) -> Result<()>,
) -> Result<()> {
    next_file(files, overwrite, origin, Vec::new(), fill)
}

fn next_file(
    files: &[(PathBuf, PatternHeader)],
    overwrite: bool,
    origin: &PatternOrigin<'_>,
    mut open: Vec<PatternWriter>,
    fill: &mut dyn FnMut(&mut [PatternWriter]) -> Result<()>,
) -> Result<()> {
    let Some(((path, header), rest)) = files.split_first() else {
        fill(&mut open)?;
        return open.iter().try_for_each(|writer| writer.file.flush().at(&writer.path));
    };
    atomic_write::write_with(path, overwrite, |temporary| {
        open.push(PatternWriter::new(temporary, path, header, origin)?);
        next_file(rest, overwrite, origin, open, fill)
    })
}

impl PatternWriter {
    fn new(
        temporary: &Path,
        path: &Path,
        header: &PatternHeader,
        origin: &PatternOrigin<'_>,
    ) -> Result<Self> {
        let write = || -> hdf5::Result<(File, Dataset)> {
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
        };
        let (file, data) = write().at(path)?;
        Ok(PatternWriter { path: path.to_owned(), file, data })
    }

    /// Writes rows of fractions of the beam, from `first_row` on, (row, column, ky, kx).
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn fractions(&self, first_row: usize, rows: ArrayView4<'_, f32>) -> Result<()> {
        self.rows(first_row, rows)
    }

    /// The same for counted electrons.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn counts(&self, first_row: usize, rows: ArrayView4<'_, u32>) -> Result<()> {
        self.rows(first_row, rows)
    }

    fn rows<T: hdf5::H5Type + Clone>(
        &self,
        first_row: usize,
        rows: ArrayView4<'_, T>,
    ) -> Result<()> {
        let end = first_row + rows.dim().0;
        let at = ndarray::s![first_row..end, .., .., ..];
        self.data.write_slice(&rows.as_standard_layout(), at).at(&self.path)
    }
}

/// Bytes of the largest part of a file: its patterns.
pub fn data_bytes(header: &PatternHeader) -> u64 {
    let n = header.detector.pixels as u64;
    header.scan.len() as u64 * n * n * size_of::<f32>() as u64
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
    number(file, "pixel_mrad", h.detector.pixel_mrad())?;
    number(file, "max_angle_mrad", h.detector.max_angle_mrad)?;
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

/// Name, unit, step, first value and length of the axes of an array of patterns.
fn axes_of(h: &PatternHeader) -> [(&'static str, &'static str, [f64; 2], usize); 4] {
    let n = h.detector.pixels;
    let k = h.detector.pixel_k(h.wavelength_angstrom);
    let first = -((n / 2) as f64) * k;
    let ([x, y], [x0, y0]) = (h.scan.step_angstrom, h.scan.origin_angstrom);
    let [rows, columns] = h.scan.shape;
    [
        ("Ry", "A", [y0, y], rows),
        ("Rx", "A", [x0, x], columns),
        ("Qy", "A^-1", [first, k], n),
        ("Qx", "A^-1", [first, k], n),
    ]
}

/// The array and its calibration, as EMD has them.
fn datacube(file: &File, h: &PatternHeader) -> hdf5::Result<Dataset> {
    let root = hdf5_create::group(file, "datacube_root")?;
    text(&root, "emd_group_type", "root")?;
    text(&root, "python_class", "Root")?;
    let group = hdf5_create::group(&root, "datacube")?;
    text(&group, "emd_group_type", "array")?;
    text(&group, "python_class", "DataCube")?;
    let all = axes_of(h);
    let shape = all.map(|axis| axis.3);
    let n = h.detector.pixels;
    let together = (CHUNK_BYTES / (n * n * size_of::<f32>())).clamp(1, h.scan.shape[1].max(1));
    let extents = Extents::from(shape.to_vec());
    let chunk = vec![1, together, n, n];
    let data = match h.counted {
        None => group.new_dataset::<f32>().shape(extents).chunk(chunk).create("data")?,
        Some(_) => group.new_dataset::<u32>().shape(extents).chunk(chunk).create("data")?,
    };
    text(&data, "units", if h.counted.is_some() { "electrons" } else { "fraction of the beam" })?;
    for (i, (name, unit, [first, step], count)) in all.into_iter().enumerate() {
        let dim = places([first, step], count);
        let dim = group.new_dataset_builder().with_data(&dim).create(format!("dim{i}").as_str())?;
        text(&dim, "name", name)?;
        text(&dim, "units", unit)?;
    }
    calibration(&root, h)?;
    Ok(data)
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
    put("Q_pixel_size", h.detector.pixel_k(h.wavelength_angstrom))?;
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
        "/datacube".parse().map_err(|_| hdf5::Error::Internal("a NUL".into()))?;
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
    axes(&group, &["y", "x", "ky", "kx"])?;
    group.link_soft(&format!("/{DATA}"), "data")?;
    let names = ["y", "x", "ky", "kx"];
    for (name, (_, unit, line, count)) in names.into_iter().zip(axes_of(h)) {
        let dataset = group.new_dataset_builder().with_data(&places(line, count)).create(name)?;
        text(&dataset, "units", if unit == "A" { "angstrom" } else { "1/angstrom" })?;
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
        let Ok(file) = File::open(path) else { return Ok(None) };
        if text_of(&file, "format").as_deref() != Some(FORMAT) {
            return Ok(None);
        }
        let read = || -> Guarded<Self> {
            let data = file.dataset(DATA).map_err(damaged)?;
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

    /// The patterns of some rows, (row, column, ky, kx): fractions of the beam, or electrons.
    ///
    /// # Errors
    /// [`Error::Parse`] for damaged values.
    pub fn rows(&self, rows: Range<usize>) -> Result<Array4<f32>> {
        let shape = self.data.shape();
        let ranges = [rows, 0..shape[1], 0..shape[2], 0..shape[3]];
        let found = match self.header.counted {
            None => hdf5_values::part(&self.data, &self.path, &ranges),
            Some(_) => hdf5_values::part::<u32, ndarray::Ix4>(&self.data, &self.path, &ranges)
                .map(|counts| counts.mapv(|n| n as f32)),
        };
        found.map_err(|fault| Error::parse(&self.path, 0, format!("/{DATA}: {fault}")))
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
    let [rows, columns, ky, kx] = data.shape()[..] else {
        return Err("holds no patterns of a scan".into());
    };
    if ky != kx || !(2..=MOST_PIXELS).contains(&kx) || rows == 0 || columns == 0 {
        return Err(format!("holds {rows} x {columns} patterns of {ky} x {kx} pixels"));
    }
    let value = |name: &str, range: Range<f64>| {
        let found: Option<f64> = number_of(file, name);
        let inside = found.filter(|v| range.contains(v));
        inside.ok_or_else(|| format!("its attribute `{name}` is missing, or no such value"))
    };
    let energy_kev = value("energy_kev", 1.0..1e4)?;
    let pairs = |name: &str| {
        let found = pair(file, name).filter(|p| p.iter().all(|v| v.is_finite()));
        found.ok_or_else(|| format!("its attribute `{name}` is missing, or no such value"))
    };
    let electrons: Option<f64> = number_of(file, "electrons_per_pattern");
    let seed: Option<u64> = number_of(file, "seed");
    Ok(PatternHeader {
        detector: PixelatedDetector {
            pixels: kx,
            max_angle_mrad: value("max_angle_mrad", 1e-6..2e3)?,
        },
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
