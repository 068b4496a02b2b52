//! Writes files of recordings. This is the only place where their schema is defined.
//!
//! - `/` attributes: `format` ("stemgen recording"), `format_version`, `stemgen_version`, `numerics_version`, `command_line`,
//!   `recipe` (TOML), `acquisition` (JSON), `seed`, `pixel_size_nm`, `origin_nm` (x, y: the first pixel in the world),
//!   `dose_electrons_per_angstrom2`, `beam_current_pa`, `electrons_per_pixel` (of one frame), `dwell_us`, `frames`, `clipped_pixels`;
//! - `/recording`: counts, (row, column) or (frame, row, column): uint8 or uint16 from a converter, uint32 where its frames are
//!   added, else float32;
//! - `/ideal`: float32 (row, column), the noise-free image at the pixels of the intended scan, in fractions of the beam;
//! - `/carbon_nm`: (frame), mean thickness of the carbon on the part at the beginning of each frame, if there is carbon or carbon grows;
//! - `/stages/moved`, `/stages/electrons`: (frame, row, column), the noise-free image where the beam was, and the electrons that
//!   hit the detector; on request;
//! - `/ground_truth`: as in a world, from the centre of the first pixel; with `columns/position_in_image`, (x, y) in pixels where each
//!   column appears ((frame, column, 2) if frames are kept), and `drift`: (line, 3), time in s and the drift (x, y) in nm;
//! - `/series`, in files of [`crate::live`] only, where `/recording` is a stack of recordings of one place, one after the other, and
//!   `/ideal` and `/ground_truth` are of the first: `ideal` (recording, row, column), `vacancies` (recording, column), `dose_before`
//!   (recording; mean electrons per square Angstrom on the place), `lost/ELEMENT` (recording), and the attribute `history` (JSON);
//! - `/detectors`, in files of several detectors, or of another than the main one: the attribute `names`, the first detector first, and a
//!   group for each detector with the attributes of worlds (`inner_mrad`, `outer_mrad`, `sector_degrees`, `centre_of_mass`). The group of
//!   the first links to `/recording` and `/ideal`. The other groups contain `recording`, `ideal`, `stages`, `series/ideal` and the attributes
//!   `acquisition` and `clipped_pixels` of their detector. Images of a centre of mass are float32 in mrad;
//! - `/entry`: a link to the recording, as NXdata with its axes; one for each detector.

use std::collections::BTreeMap;
use std::path::Path;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, H5Type};
use ndarray::{Array2, Array3, Axis};

use super::schema;
use super::truth_writer::TruthWriter;
use super::world_writer::write_angles;
use crate::acquisition::{Acquisition, Exposure, ScanFrame};
use crate::detect::Detector;
use crate::error::Result;
use crate::files::atomic_write;
use crate::io::hdf5::At;
use crate::io::hdf5::hdf5_create::{self, number, text};
use crate::numerics::NUMERICS_VERSION;

/// Version of this schema.
const FORMAT_VERSION: i64 = 1;
const DEFLATE: u8 = 1;
/// Longest edge of a chunk in pixels.
const CHUNK_PX: usize = 512;

/// The images of one detector.
#[derive(Debug, Clone)]
pub(crate) struct RecordedImages<'a> {
    /// The detector.
    pub detector: &'a Detector,
    /// The settings of scan and detector.
    pub acquisition: &'a Acquisition,
    /// Counts or mean angles: (frame, row, column).
    pub data: &'a Array3<f64>,
    /// The noise-free image, [row, column].
    pub ideal: &'a Array2<f32>,
    /// The noise-free image where the beam was, and the electrons: (frame, row, column).
    pub stages: Option<[&'a Array3<f32>; 2]>,
    /// Number of pixels that the converter clipped.
    pub clipped: u64,
    /// The noise-free image at the beginning of each recording of a series: (recording, row, column).
    pub series: Option<&'a Array3<f32>>,
}

/// Contents of a file of a recording, except the ground truth.
#[derive(Debug, Clone)]
pub(crate) struct RecordingFile<'a> {
    /// The command as typed.
    pub command_line: String,
    /// The recipe as TOML.
    pub recipe: String,
    /// The images of the first detector.
    pub first: RecordedImages<'a>,
    /// The images of the other detectors.
    pub others: Vec<RecordedImages<'a>>,
    /// Whether the file names its detectors.
    pub is_named: bool,
    /// The exposure: electrons and time.
    pub exposure: &'a Exposure,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The pixels of the intended scan.
    pub frame: &'a ScanFrame,
    /// Whether `data` is a stack of frames or of recordings; otherwise it holds one image.
    pub is_stack: bool,
    /// Whether each image of `data` is the sum of several frames.
    pub is_sum: bool,
    /// Mean thickness in nm of the carbon on the part at the beginning of each frame; empty without carbon.
    pub carbon_nm: &'a [f64],
    /// Changes from recording to recording of a series.
    pub series: Option<SeriesPart<'a>>,
}

/// Changes from recording to recording of a series.
#[derive(Debug, Clone)]
pub(crate) struct SeriesPart<'a> {
    /// Vacant sites of the columns of the ground truth at the beginning of each recording: (recording, column).
    pub vacancies: &'a Array2<i32>,
    /// Mean dose in electrons per square Angstrom on the place before each recording.
    pub dose_before: &'a [f64],
    /// Number of atoms that each recording removed, by element.
    pub lost: BTreeMap<String, Vec<u64>>,
    /// The actions so far, as JSON.
    pub history: String,
}

/// Writes a recording; `truth` adds the ground truth. The file appears complete or not at all; an existing file is replaced only if
/// `overwrite` is set.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Hdf5`], and errors of `truth`.
pub(crate) fn write_recording(
    path: &Path,
    overwrite: bool,
    recording: &RecordingFile,
    truth: &dyn Fn(&TruthWriter) -> Result<()>,
) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| {
        let file = hdf5_create::file(temporary).at(path)?;
        let shape = recording.frame.shape;
        write_header(&file, recording).at(path)?;
        write_images(&file, (recording, &recording.first)).at(path)?;
        let writer = TruthWriter::create(&file, path, [shape, chunk(shape)]).at(path)?;
        truth(&writer)?;
        if let Some(series) = &recording.series {
            write_series(&file, (recording, series)).at(path)?;
        }
        if recording.is_named {
            write_detectors(&file, recording).at(path)?;
        }
        write_entry(&file, recording).at(path)?;
        file.flush().at(path)
    })
}

fn chunk(shape: [usize; 2]) -> [usize; 2] {
    shape.map(|n| n.min(CHUNK_PX))
}

fn write_header(file: &File, r: &RecordingFile) -> hdf5::Result<()> {
    text(file, "format", "stemgen recording")?;
    number(file, "format_version", FORMAT_VERSION)?;
    text(file, "stemgen_version", env!("CARGO_PKG_VERSION"))?;
    number(file, "numerics_version", i64::from(NUMERICS_VERSION))?;
    text(file, "command_line", &r.command_line)?;
    text(file, "recipe", &r.recipe)?;
    text(file, "acquisition", &serde_json::to_string(r.first.acquisition).unwrap_or_default())?;
    number(file, "seed", r.seed)?;
    number(file, "pixel_size_nm", r.frame.pixel_nm)?;
    file.new_attr_builder().with_data(&r.frame.origin_nm).create("origin_nm")?;
    number(file, "dose_electrons_per_angstrom2", r.exposure.dose())?;
    number(file, "beam_current_pa", r.exposure.current_pa())?;
    number(file, "electrons_per_pixel", r.exposure.electrons_per_pixel)?;
    number(file, "dwell_us", r.exposure.dwell_us)?;
    number(file, "frames", r.exposure.frames as u64)?;
    number(file, "clipped_pixels", r.first.clipped)
}

/// Writes the images of a detector to its group, or to the file itself for the first.
fn write_images(to: &Group, (r, own): (&RecordingFile, &RecordedImages)) -> hdf5::Result<()> {
    match (own.acquisition.bits, r.is_sum) {
        _ if own.detector.is_deflection() => write_values::<f32>(to, (r, own), |v| v as f32)?,
        (32, _) => write_values::<f32>(to, (r, own), |v| v as f32)?,
        (_, true) => write_values::<u32>(to, (r, own), |v| v as u32)?,
        (8, false) => write_values::<u8>(to, (r, own), |v| v as u8)?,
        (_, false) => write_values::<u16>(to, (r, own), |v| v as u16)?,
    }
    let builder = to.new_dataset_builder().chunk(chunk(r.frame.shape)).shuffle().deflate(DEFLATE);
    let ideal = builder.with_data(own.ideal).create("ideal")?;
    text(&ideal, "units", own.detector.units())?;
    if !r.carbon_nm.is_empty() {
        let carbon = to.new_dataset_builder().with_data(r.carbon_nm).create("carbon_nm")?;
        text(&carbon, "units", "nm")?;
    }
    let Some(stages) = own.stages else { return Ok(()) };
    let group = hdf5_create::group(to, "stages")?;
    let names = [("moved", own.detector.units()), ("electrons", "electrons")];
    for ((name, units), data) in names.into_iter().zip(stages) {
        let [rows, columns] = chunk(r.frame.shape);
        let builder = group.new_dataset_builder().chunk([1, rows, columns]);
        let dataset = builder.shuffle().deflate(DEFLATE).with_data(data).create(name)?;
        text(&dataset, "units", units)?;
    }
    Ok(())
}

fn write_values<T: H5Type + Clone>(
    to: &Group,
    (r, own): (&RecordingFile, &RecordedImages),
    convert: impl Fn(f64) -> T,
) -> hdf5::Result<()> {
    let data = own.data.mapv(convert);
    let [rows, columns] = chunk(r.frame.shape);
    let builder = to.new_dataset_builder();
    let dataset = match r.is_stack {
        true => {
            let builder = builder.chunk([1, rows, columns]).shuffle().deflate(DEFLATE);
            builder.with_data(&data).create("recording")?
        }
        false => {
            let builder = builder.chunk([rows, columns]).shuffle().deflate(DEFLATE);
            builder.with_data(&data.index_axis(Axis(0), 0)).create("recording")?
        }
    };
    text(&dataset, "units", if own.detector.is_deflection() { "mrad" } else { "counts" })?;
    // With this attribute NeXus readers show an image at once.
    text(&dataset, "interpretation", "image")?;
    number(&dataset, "pixel_size_nm", r.frame.pixel_nm)
}

/// Writes the noise-free images of a series on one detector.
fn write_ideal_of_series(
    series: &Group,
    (r, own): (&RecordingFile, &RecordedImages),
) -> hdf5::Result<Option<Dataset>> {
    let Some(data) = own.series else { return Ok(None) };
    let [rows, columns] = chunk(r.frame.shape);
    let builder = series.new_dataset_builder().chunk([1, rows, columns]).shuffle().deflate(DEFLATE);
    let ideal = builder.with_data(data).create("ideal")?;
    text(&ideal, "units", own.detector.units())?;
    Ok(Some(ideal))
}

fn write_series(file: &File, (r, series): (&RecordingFile, &SeriesPart)) -> hdf5::Result<()> {
    let group = hdf5_create::group(file, "series")?;
    text(&group, "history", &series.history)?;
    // The library places what follows behind a dataset that is open, so it stays open.
    let _ideal = write_ideal_of_series(&group, (r, &r.first))?;
    group.new_dataset_builder().with_data(series.vacancies).create("vacancies")?;
    let dose = group.new_dataset_builder().with_data(series.dose_before).create("dose_before")?;
    text(&dose, "units", "electrons per square Angstrom")?;
    let lost = hdf5_create::group(&group, "lost")?;
    for (element, atoms) in &series.lost {
        lost.new_dataset_builder().with_data(atoms).create(element.as_str())?;
    }
    Ok(())
}

/// Creates a group for each detector, with the images of all but the first.
fn write_detectors(file: &File, r: &RecordingFile) -> hdf5::Result<()> {
    let all = hdf5_create::group(file, schema::DETECTORS)?;
    let images = || std::iter::once(&r.first).chain(&r.others);
    let names: Vec<VarLenUnicode> =
        images().filter_map(|one| one.detector.name.parse().ok()).collect();
    all.new_attr_builder().with_data(&names).create("names")?;
    for (n, own) in images().enumerate() {
        let group = hdf5_create::group(&all, &own.detector.name)?;
        write_angles(&group, own.detector)?;
        if n == 0 {
            for name in ["recording", "ideal"] {
                group.link_soft(&format!("/{name}"), name)?;
            }
            continue;
        }
        text(&group, "acquisition", &serde_json::to_string(own.acquisition).unwrap_or_default())?;
        number(&group, "clipped_pixels", own.clipped)?;
        write_images(&group, (r, own))?;
        if own.series.is_some() {
            write_ideal_of_series(&hdf5_create::group(&group, "series")?, (r, own))?;
        }
    }
    Ok(())
}

fn write_entry(file: &File, r: &RecordingFile) -> hdf5::Result<()> {
    text(file, "NX_class", "NXroot")?;
    text(file, "default", "entry")?;
    let entry = hdf5_create::group(file, "entry")?;
    text(&entry, "NX_class", "NXentry")?;
    text(&entry, "default", "recording")?;
    write_axes(&entry, ("recording", "/recording"), r)?;
    for own in &r.others {
        let name = &own.detector.name;
        let data = format!("/{}/recording", schema::detector_group(name));
        write_axes(&entry, (name, &data), r)?;
    }
    Ok(())
}

/// Writes a link to a recording as NXdata with its axes.
fn write_axes(entry: &Group, (name, data): (&str, &str), r: &RecordingFile) -> hdf5::Result<()> {
    let group = hdf5_create::group(entry, name)?;
    text(&group, "NX_class", "NXdata")?;
    text(&group, "signal", "data")?;
    // HyperSpy reads this attribute of the group: the last two axes belong to an image.
    text(&group, "interpretation", "image")?;
    group.link_soft(data, "data")?;
    let along = |k: usize, n: usize| -> Vec<f64> {
        (0..n).map(|i| r.frame.origin_nm[k] + i as f64 * r.frame.pixel_nm).collect()
    };
    let [rows, columns] = r.frame.shape;
    let mut axes = Vec::new();
    if r.is_stack {
        let name = if r.series.is_some() { "recording" } else { "frame" };
        axes.push((name, (0..r.first.data.len_of(Axis(0))).map(|f| f as f64).collect(), ""));
    }
    axes.push(("y", along(1, rows), "nm"));
    axes.push(("x", along(0, columns), "nm"));
    let names: Vec<VarLenUnicode> =
        axes.iter().filter_map(|(name, ..)| name.parse().ok()).collect();
    group.new_attr_builder().with_data(&names).create("axes")?;
    for (name, values, units) in axes {
        let dataset = group.new_dataset_builder().with_data(&values).create(name)?;
        text(&dataset, "units", units)?;
    }
    Ok(())
}
