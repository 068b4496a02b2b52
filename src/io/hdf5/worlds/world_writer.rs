//! Writes a world file piece by piece.

use std::path::{Path, PathBuf};

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, Extents, File, Group, H5Type};
use ndarray::ArrayView2;
use rayon::prelude::*;

use super::schema;
use super::truth_writer::TruthWriter;
use crate::acquisition::{Acquisition, Exposure};
use crate::detect::{CentreOfMass, Detector};
use crate::error::{Error, Result};
use crate::io::hdf5::At;
use crate::io::hdf5::hdf5_create::{self, number, text};
use crate::io::hdf5::hdf5_filters::shuffled_and_deflated;
use crate::recipe::OVERVIEW_FACTOR;

const DEFLATE: u8 = 1;

/// Description of a world.
#[derive(Debug, Clone, Default)]
pub(crate) struct Header {
    /// Edge of a pixel in nm.
    pub pixel_size_nm: f64,
    /// Edge of a tile in pixels.
    pub tile_size_px: usize,
    /// Pixels that neighbouring tiles share.
    pub overlap_px: usize,
    /// Rows and columns of tiles.
    pub grid_shape: [usize; 2],
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Row and column of pixel (0, 0) in the full field.
    pub origin_px: [usize; 2],
    /// Thickness of the specimen in nm, if known.
    pub thickness_nm: Option<f64>,
    /// Electrons per square Angstrom, if known.
    pub dose: Option<f64>,
    /// Whether the tiles hold the noise of the dose, if known.
    pub noise: Option<bool>,
    /// Seed of all random numbers, if there are any.
    pub seed: Option<u64>,
    /// The detectors of a world with names for them, the main one first; otherwise empty.
    pub detectors: Vec<Detector>,
    /// Largest width and overlap of sub-tiles in nm.
    pub subtile_nm: Option<[f64; 2]>,
    /// Text attributes: name and value.
    pub texts: Vec<(&'static str, String)>,
    /// Other attributes that are numbers: name and value.
    pub numbers: Vec<(&'static str, f64)>,
}

/// A world file that is being written.
pub(crate) struct WorldWriter {
    path: PathBuf,
    file: File,
    detectors: Vec<Detector>,
    /// Group for the images: the file, or the group of a detector other than the main one.
    images: Group,
    tiles: Group,
    clean: Option<Group>,
    truth: TruthWriter,
    valid: Dataset,
}

impl WorldWriter {
    /// Creates an empty file to test whether HDF5 can; the file stays.
    ///
    /// # Errors
    /// [`Error::Hdf5`], [`Error::Io`].
    pub(crate) fn try_file(path: &Path) -> Result<()> {
        hdf5_create::file(path).at(path).map(drop)
    }

    /// Creates (or replaces) the file, and writes everything that does not depend on the image.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn create(path: &Path, header: &Header, keep_clean: bool) -> Result<Self> {
        let stride = header.tile_size_px - header.overlap_px;
        let shape = header.grid_shape.map(|n| n * stride + header.overlap_px);
        let make = || -> hdf5::Result<WorldWriter> {
            let file = hdf5_create::file(path)?;
            let metadata = hdf5_create::group(&file, schema::METADATA)?;
            write_header(&metadata, header)?;
            let tile = [header.tile_size_px.min(shape[0]), header.tile_size_px.min(shape[1])];
            let valid = compressed::<bool>(&file, schema::VALID_REGION, shape.into(), &tile)?;
            let (tiles, clean) = image_groups(&file, keep_clean, Detector::FRACTION_OF_BEAM)?;
            if !header.detectors.is_empty() {
                write_detectors(&file, &header.detectors, keep_clean)?;
            }
            Ok(WorldWriter {
                path: path.to_owned(),
                detectors: header.detectors.clone(),
                images: file.group("/")?,
                tiles,
                clean,
                truth: TruthWriter::create(&file, path, [shape, tile])?,
                valid,
                file,
            })
        };
        make().at(path)
    }

    /// Starts the images of another detector; its number counts from 0 for the main detector.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn next_detector(&mut self, number: usize, keep_clean: bool) -> Result<()> {
        let detector = self.detectors.get(number);
        let name = detector.map_or("", |d| d.name.as_str());
        let units = detector.map_or(Detector::FRACTION_OF_BEAM, Detector::units);
        let make = || -> hdf5::Result<(Group, (Group, Option<Group>))> {
            let group = self.file.group(&schema::detector_group(name))?;
            let groups = image_groups(&group, keep_clean, units)?;
            Ok((group, groups))
        };
        (self.images, (self.tiles, self.clean)) = make().at(&self.path)?;
        Ok(())
    }

    /// Writes the linear scaling of all tiles: a value in `units`, such as a fraction of the beam, is value * scale + offset.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn scaling(&self, scale: f64, offset: f64, units: &str) -> Result<()> {
        let write = || {
            number(&self.tiles, "scale", scale)?;
            number(&self.tiles, "offset", offset)?;
            text(&self.tiles, "unit", &format!("{units} = value * scale + offset"))
        };
        write().at(&self.path)
    }

    /// Writes the linear scaling of all tiles of a recorded image: value in its file = value * scale + offset. Fractions of the beam are
    /// not known.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn scaling_of_recorded(&self, scale: f64, offset: f64) -> Result<()> {
        let write = || {
            number(&self.tiles, "recorded_scale", scale)?;
            number(&self.tiles, "recorded_offset", offset)?;
            text(
                &self.tiles,
                "unit",
                "value in the recorded file = value * recorded_scale + recorded_offset; values beyond 0 and 1 are cut off",
            )
        };
        write().at(&self.path)
    }

    /// Writes a row of normalised tiles.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn tiles(&self, row: usize, tiles: &[ArrayView2<f32>]) -> Result<()> {
        write_tiles(&self.tiles, row, tiles).at(&self.path)
    }

    /// Writes a row of noiseless tiles, in fractions of the beam; does nothing if the file has no noiseless tiles.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn clean_tiles(&self, row: usize, tiles: &[ArrayView2<f32>]) -> Result<()> {
        match &self.clean {
            Some(group) => write_tiles(group, row, tiles).at(&self.path),
            None => Ok(()),
        }
    }

    /// Writes the overview.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn overview(&self, pixels: ArrayView2<f32>) -> Result<()> {
        let write = || {
            let builder = self.images.new_dataset_builder().shuffle().deflate(DEFLATE);
            let dataset = builder.with_data(pixels).create(schema::OVERVIEW)?;
            number(&dataset, "factor", OVERVIEW_FACTOR as u64)?;
            text(&dataset, "description", "stitched tiles, area average; edge blocks are partial")
        };
        write().at(&self.path)
    }

    /// Writes rows of the valid region, from row `first`.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn valid_rows(&self, first: usize, rows: ArrayView2<bool>) -> Result<()> {
        let selection = ndarray::s![first..first + rows.nrows(), ..];
        self.valid.write_slice(&rows.as_standard_layout(), selection).at(&self.path)
    }

    /// Writes the settings of the recording: counts of all frames = fraction of the beam * `counts[0]` + `counts[1]`.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub(crate) fn recorded(
        &self,
        acquisition: &Acquisition,
        exposure: &Exposure,
        counts: [f64; 2],
    ) -> Result<()> {
        let write = || {
            let metadata = self.file.group(schema::METADATA)?;
            let json = serde_json::to_string(acquisition).unwrap_or_default();
            text(&metadata, "acquisition", &json)?;
            number(&metadata, "beam_current_pa", exposure.current_pa())?;
            number(&metadata, "electrons_per_pixel", exposure.electrons_per_pixel)?;
            number(&metadata, "frames", exposure.frames as u64)?;
            number(&metadata, "counts_of_whole_beam", counts[0])?;
            number(&metadata, "counts_of_no_beam", counts[1])
        };
        write().at(&self.path)
    }

    /// Returns the writer of the ground truth.
    pub(crate) fn truth(&self) -> &TruthWriter {
        &self.truth
    }

    /// Writes all data out and closes the file.
    ///
    /// # Errors
    /// [`Error::Hdf5`], [`Error::Io`].
    pub(crate) fn finish(self) -> Result<()> {
        let path = self.path.clone();
        self.file.flush().at(&path)?;
        drop(self);
        let sync = std::fs::File::open(&path).and_then(|f| f.sync_all());
        sync.map_err(|e| Error::io(&path, "write", e))
    }
}

fn write_header(group: &Group, h: &Header) -> hdf5::Result<()> {
    number(group, "pixel_size_nm", h.pixel_size_nm)?;
    number(group, "tile_size_px", h.tile_size_px as i64)?;
    number(group, "overlap_px", h.overlap_px as i64)?;
    let array = |name: &str, v: [usize; 2]| {
        group.new_attr_builder().with_data(&v.map(|n| n as i64)).create(name).map(drop)
    };
    array("grid_shape", h.grid_shape)?;
    array("origin_px_in_full_field", h.origin_px)?;
    group.new_attr_builder().with_data(&h.fov_nm).create("fov_nm")?;
    if let Some(nm) = h.thickness_nm {
        number(group, "thickness_nm", nm)?;
    }
    if let Some(dose) = h.dose {
        number(group, "dose_electrons_per_angstrom2", dose)?;
    }
    if let Some(noise) = h.noise {
        number(group, "noise", noise)?;
    }
    if let Some(seed) = h.seed {
        number(group, "seed", seed)?;
    }
    if let Some(nm) = h.subtile_nm {
        group.new_attr_builder().with_data(&nm).create("subtile_nm")?;
    }
    h.numbers.iter().try_for_each(|(name, value)| number(group, name, *value))?;
    h.texts.iter().try_for_each(|(name, value)| text(group, name, value))
}

/// Creates the groups of tiles, and of noiseless tiles if they are kept.
fn image_groups(
    group: &Group,
    keep_clean: bool,
    units: &str,
) -> hdf5::Result<(Group, Option<Group>)> {
    let clean = keep_clean.then(|| hdf5_create::group(group, schema::CLEAN)).transpose()?;
    if let Some(clean) = &clean {
        text(clean, "unit", units)?;
    }
    Ok((hdf5_create::group(group, schema::TILES)?, clean))
}

/// Creates a group for each detector. The group of the main detector links to its images, which lie at the place of the images of a single
/// detector.
fn write_detectors(file: &File, detectors: &[Detector], keep_clean: bool) -> hdf5::Result<()> {
    let all = hdf5_create::group(file, schema::DETECTORS)?;
    let names: Vec<VarLenUnicode> = detectors.iter().filter_map(|d| d.name.parse().ok()).collect();
    all.new_attr_builder().with_data(&names).create("names")?;
    for (n, detector) in detectors.iter().enumerate() {
        let group = hdf5_create::group(&all, &detector.name)?;
        write_angles(&group, detector)?;
        if n == 0 {
            let clean = keep_clean.then_some(schema::CLEAN);
            for name in [schema::TILES, schema::OVERVIEW].into_iter().chain(clean) {
                group.link_soft(&format!("/{name}"), name)?;
            }
        }
    }
    Ok(())
}

/// Writes the angles of a detector as attributes of its group.
pub(super) fn write_angles(group: &Group, detector: &Detector) -> hdf5::Result<()> {
    number(group, "inner_mrad", detector.inner_mrad)?;
    number(group, "outer_mrad", detector.outer_mrad)?;
    if let Some(sector) = detector.sector_degrees {
        group.new_attr_builder().with_data(&sector).create("sector_degrees")?;
    }
    match detector.centre_of_mass {
        Some(CentreOfMass::X) => text(group, schema::CENTRE_OF_MASS, "x"),
        Some(CentreOfMass::Y) => text(group, schema::CENTRE_OF_MASS, "y"),
        _ => Ok(()),
    }
}

/// Writes a row of tiles, which all threads pack.
fn write_tiles(group: &Group, row: usize, tiles: &[ArrayView2<f32>]) -> hdf5::Result<()> {
    let packed = tiles.par_iter().map(|tile| shuffled_and_deflated(tile.view(), DEFLATE));
    let packed: std::io::Result<Vec<Vec<u8>>> = packed.collect();
    let packed = packed.map_err(|e| e.to_string())?;
    for (column, (tile, bytes)) in tiles.iter().zip(&packed).enumerate() {
        let (height, width) = tile.dim();
        let name = schema::tile_name(row, column);
        let dataset = compressed::<f32>(group, &name, tile.dim().into(), &[height, width])?;
        hdf5_create::packed_chunk(&dataset, bytes)?;
    }
    Ok(())
}

pub(super) fn compressed<T: H5Type>(
    group: &Group,
    name: &str,
    shape: Extents,
    chunk: &[usize],
) -> hdf5::Result<Dataset> {
    let builder = group.new_dataset_builder().chunk(chunk.to_vec()).shuffle().deflate(DEFLATE);
    builder.empty::<T>().shape(shape).create(name)
}
