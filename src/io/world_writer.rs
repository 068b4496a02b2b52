//! Writes a world file piece by piece.

use std::path::{Path, PathBuf};

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, Extents, File, Group, H5Type};
use ndarray::{ArrayView1, ArrayView2};

use super::At;
use super::schema::{self, CompositionText, DefectName, MorphologyName};
use crate::error::{Error, Result};

/// Entries of a chunk of the ground truth.
const TRUTH_CHUNK: usize = 16_384;
const DEFLATE: u8 = 1;

/// What describes a world.
#[derive(Debug, Clone, Default)]
pub struct Header {
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
    /// Thickness of the specimen in nm.
    pub thickness_nm: f64,
    /// Electrons per square Angstrom.
    pub dose: f64,
    /// Whether the tiles hold noise.
    pub noise: bool,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Texts: name and value.
    pub texts: Vec<(&'static str, String)>,
}

/// What a polyline of the ground truth separates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LineKind<'a> {
    /// Two grains: rotation in degrees and coincidence index.
    Grains(f64, Option<u32>),
    /// Two phases: names left and right of it, and the width of the transition in nm.
    Phases([&'a str; 2], f64),
}

/// Particles, entry by entry.
#[derive(Debug, Clone, Default)]
pub struct ParticleBatch {
    /// Centres (x, y, z) in nm.
    pub centres: Vec<[f32; 3]>,
    /// Diameters in nm.
    pub diameters: Vec<f32>,
    /// Shapes.
    pub morphologies: Vec<MorphologyName>,
    /// Unit quaternions (w, x, y, z).
    pub orientations: Vec<[f32; 4]>,
}

/// Sites of some columns, in the order of the file.
#[derive(Debug, Clone, Default)]
pub struct TruthBatch {
    /// (x, y) in nm.
    pub positions: Vec<[f32; 2]>,
    /// Depth below the entrance surface in nm.
    pub z: Vec<f32>,
    /// Codes of [`schema::atom_type`].
    pub types: Vec<i32>,
    /// True where a defect.
    pub defects: Vec<bool>,
    /// Atomic numbers.
    pub numbers: Vec<i32>,
    /// Names of the defects.
    pub defect_names: Vec<DefectName>,
    /// Index of the column of each site.
    pub columns: Vec<i32>,
    /// (x, y) of each column in nm.
    pub column_positions: Vec<[f32; 2]>,
    /// Sites, vacancies and substitutions of each column.
    pub column_counts: [Vec<i32>; 3],
    /// Composition of each column.
    pub column_compositions: Vec<CompositionText>,
}

/// A world file being written.
pub struct WorldWriter {
    path: PathBuf,
    file: File,
    tiles: Group,
    clean: Option<Group>,
    truth: Truth,
    valid: Dataset,
}

struct Truth {
    group: Group,
    site_pairs: Dataset,
    z: Dataset,
    types: Dataset,
    defects: Dataset,
    numbers: Dataset,
    defect_names: Dataset,
    columns: Dataset,
    column_pairs: Dataset,
    column_counts: [Dataset; 3],
    column_compositions: Dataset,
    grain_boundaries: Group,
    phase_boundaries: Group,
}

impl WorldWriter {
    /// Makes an empty file to see whether HDF5 can; it stays.
    ///
    /// # Errors
    /// [`Error::Hdf5`], [`Error::Io`].
    pub(crate) fn try_file(path: &Path) -> Result<()> {
        File::create(path).at(path).map(drop)
    }

    /// Creates (or replaces) the file and all that does not depend on the image.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn create(path: &Path, header: &Header, keep_clean: bool) -> Result<Self> {
        let stride = header.tile_size_px - header.overlap_px;
        let shape = header.grid_shape.map(|n| n * stride + header.overlap_px);
        let make = || -> hdf5::Result<WorldWriter> {
            let file = File::create(path)?;
            let metadata = file.create_group(schema::METADATA)?;
            write_header(&metadata, header)?;
            let tile = [header.tile_size_px.min(shape[0]), header.tile_size_px.min(shape[1])];
            let valid = compressed::<bool>(&file, schema::VALID_REGION, shape.into(), &tile)?;
            let clean = keep_clean.then(|| file.create_group(schema::CLEAN)).transpose()?;
            if let Some(clean) = &clean {
                text(clean, "unit", "fraction of the incident beam")?;
            }
            Ok(WorldWriter {
                path: path.to_owned(),
                tiles: file.create_group(schema::TILES)?,
                clean,
                truth: Truth::create(&file)?,
                valid,
                file,
            })
        };
        make().at(path)
    }

    /// The linear scaling of all tiles: fraction of the beam = value * scale + offset.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn scaling(&self, scale: f64, offset: f64) -> Result<()> {
        let write = || {
            number(&self.tiles, "scale", scale)?;
            number(&self.tiles, "offset", offset)?;
            text(&self.tiles, "unit", "fraction of the incident beam = value * scale + offset")
        };
        write().at(&self.path)
    }

    /// A tile, normalised.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn tile(&self, row: usize, column: usize, pixels: ArrayView2<f32>) -> Result<()> {
        write_tile(&self.tiles, row, column, pixels).at(&self.path)
    }

    /// A noiseless tile, in fractions of the beam; nothing when the file has none.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn clean_tile(&self, row: usize, column: usize, pixels: ArrayView2<f32>) -> Result<()> {
        match &self.clean {
            Some(group) => write_tile(group, row, column, pixels).at(&self.path),
            None => Ok(()),
        }
    }

    /// The overview.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn overview(&self, pixels: ArrayView2<f32>) -> Result<()> {
        let write = || {
            let builder = self.file.new_dataset_builder().shuffle().deflate(DEFLATE);
            let dataset = builder.with_data(pixels).create(schema::OVERVIEW)?;
            number(&dataset, "factor", schema::OVERVIEW_FACTOR as u64)?;
            text(&dataset, "description", "stitched tiles, area average; edge blocks are partial")
        };
        write().at(&self.path)
    }

    /// Rows of the valid region, from row `first`.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn valid_rows(&self, first: usize, rows: ArrayView2<bool>) -> Result<()> {
        let selection = ndarray::s![first..first + rows.nrows(), ..];
        self.valid.write_slice(rows, selection).at(&self.path)
    }

    /// More sites and columns.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn append(&self, batch: &TruthBatch) -> Result<()> {
        self.truth.append(batch).at(&self.path)
    }

    /// A polyline between two grains or phases.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn boundary(&self, line: &[[f32; 2]], kind: LineKind) -> Result<()> {
        let group = match kind {
            LineKind::Grains(..) => &self.truth.grain_boundaries,
            LineKind::Phases(..) => &self.truth.phase_boundaries,
        };
        let write = || {
            let view = rows(line)?;
            let builder = group.new_dataset_builder().with_data(view);
            let dataset = builder.create(group.len().to_string().as_str())?;
            text(&dataset, "unit", "nm")?;
            match kind {
                LineKind::Grains(degrees, sigma) => {
                    number(&dataset, "misorientation_deg", degrees)?;
                    sigma.map_or(Ok(()), |s| number(&dataset, "sigma", s))
                }
                LineKind::Phases([left, right], sigma_nm) => {
                    text(&dataset, "left", left)?;
                    text(&dataset, "right", right)?;
                    number(&dataset, "sharpness_sigma_nm", sigma_nm)
                }
            }
        };
        write().at(&self.path)
    }

    /// Adds the phase map, to be filled row by row; `phases` are the names of its codes.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn create_phase_map(&self, phases: &[String]) -> Result<()> {
        let write = || {
            let (shape, chunk) = (self.valid.shape(), self.valid.chunk().unwrap_or_default());
            let name = schema::PHASE_MAP;
            let map = compressed::<i32>(&self.truth.group, name, shape.into(), &chunk)?;
            let codes: Vec<String> =
                phases.iter().enumerate().map(|(code, name)| format!("{code} {name}")).collect();
            text(&map, "codes", &codes.join(", "))
        };
        write().at(&self.path)
    }

    /// Rows of the phase map, from row `first`.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn phase_rows(&self, first: usize, rows: ArrayView2<i32>) -> Result<()> {
        let write = || {
            let map = self.truth.group.dataset(schema::PHASE_MAP)?;
            map.write_slice(rows, ndarray::s![first..first + rows.nrows(), ..])
        };
        write().at(&self.path)
    }

    /// All particles.
    ///
    /// # Errors
    /// [`Error::Hdf5`].
    pub fn particles(&self, particles: &ParticleBatch) -> Result<()> {
        let write = || {
            let group = self.truth.group.create_group(schema::PARTICLES)?;
            let new = || group.new_dataset_builder();
            let centres = new().with_data(rows(&particles.centres)?).create("centre")?;
            text(&centres, "unit", "nm")?;
            text(
                &centres,
                "axes",
                "(x, y, z): x with the column, y with the row, z with the beam",
            )?;
            let diameters = new().with_data(&particles.diameters).create("diameter")?;
            text(&diameters, "unit", "nm")?;
            new().with_data(&particles.morphologies).create("morphology")?;
            let turns = new().with_data(rows(&particles.orientations)?).create("orientation")?;
            text(
                &turns,
                "components",
                "unit quaternion (w, x, y, z) from the particle to the field",
            )
        };
        write().at(&self.path)
    }

    /// Adds the wall time, writes everything out and closes the file.
    ///
    /// # Errors
    /// [`Error::Hdf5`], [`Error::Io`].
    pub fn finish(self) -> Result<()> {
        let path = self.path.clone();
        self.file.flush().at(&path)?;
        drop(self);
        let sync = std::fs::File::open(&path).and_then(|f| f.sync_all());
        sync.map_err(|e| Error::io(&path, "write", e))
    }
}

impl Truth {
    fn create(file: &File) -> hdf5::Result<Self> {
        let group = file.create_group(schema::TRUTH)?;
        let columns = group.create_group(schema::COLUMNS)?;
        let list = (0..).into();
        let truth = Truth {
            site_pairs: position_list(&group, "atom_positions")?,
            z: growing::<f32>(&group, "atom_z", &list)?,
            types: growing::<i32>(&group, "atom_types", &list)?,
            defects: growing::<bool>(&group, "defect_mask", &list)?,
            numbers: growing::<i32>(&group, "atomic_numbers", &list)?,
            defect_names: growing::<DefectName>(&group, "defect_types", &list)?,
            columns: growing::<i32>(&group, "atom_columns", &list)?,
            column_pairs: position_list(&columns, "position")?,
            column_counts: [
                growing::<i32>(&columns, "number_of_sites", &list)?,
                growing::<i32>(&columns, "vacancies", &list)?,
                growing::<i32>(&columns, "substitutions", &list)?,
            ],
            column_compositions: growing::<CompositionText>(&columns, "composition", &list)?,
            grain_boundaries: group.create_group(schema::GRAIN_BOUNDARIES)?,
            phase_boundaries: group.create_group(schema::PHASE_BOUNDARIES)?,
            group,
        };
        text(&truth.z, "unit", "nm")?;
        text(&truth.z, "origin", "entrance surface; the beam runs along +z")?;
        text(&truth.types, "codes", "0 pristine, 1 vacancy, 2 substitution")?;
        text(&truth.numbers, "vacancies", "the element that is missing")?;
        text(&truth.columns, "refers_to", "rows of columns/*")?;
        text(&truth.group, "listing", "all lattice sites of the columns that lie in the field")?;
        Ok(truth)
    }

    fn append(&self, b: &TruthBatch) -> hdf5::Result<()> {
        append_pairs(&self.site_pairs, &b.positions)?;
        append(&self.z, &b.z)?;
        append(&self.types, &b.types)?;
        append(&self.defects, &b.defects)?;
        append(&self.numbers, &b.numbers)?;
        append(&self.defect_names, &b.defect_names)?;
        append(&self.columns, &b.columns)?;
        append_pairs(&self.column_pairs, &b.column_positions)?;
        for (dataset, counts) in self.column_counts.iter().zip(&b.column_counts) {
            append(dataset, counts)?;
        }
        append(&self.column_compositions, &b.column_compositions)
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
    number(group, "thickness_nm", h.thickness_nm)?;
    number(group, "dose_electrons_per_angstrom2", h.dose)?;
    number(group, "noise", h.noise)?;
    number(group, "seed", h.seed)?;
    h.texts.iter().try_for_each(|(name, value)| text(group, name, value))
}

fn write_tile(group: &Group, row: usize, col: usize, pixels: ArrayView2<f32>) -> hdf5::Result<()> {
    let builder = group.new_dataset_builder().chunk(pixels.dim()).shuffle().deflate(DEFLATE);
    let name = schema::tile_name(row, col);
    builder.with_data(&pixels.as_standard_layout()).create(name.as_str()).map(drop)
}

fn position_list(group: &Group, name: &str) -> hdf5::Result<Dataset> {
    let dataset = compressed::<f32>(group, name, (0.., 2).into(), &[TRUTH_CHUNK, 2])?;
    text(&dataset, "unit", "nm")?;
    text(
        &dataset,
        "origin",
        "(x, y): x with the column, y with the row, from the centre of pixel (0, 0)",
    )?;
    Ok(dataset)
}

fn growing<T: H5Type>(group: &Group, name: &str, shape: &Extents) -> hdf5::Result<Dataset> {
    compressed::<T>(group, name, shape.clone(), &[TRUTH_CHUNK])
}

fn compressed<T: H5Type>(
    group: &Group,
    name: &str,
    shape: Extents,
    chunk: &[usize],
) -> hdf5::Result<Dataset> {
    let builder = group.new_dataset_builder().chunk(chunk.to_vec()).shuffle().deflate(DEFLATE);
    builder.empty::<T>().shape(shape).create(name)
}

fn append<T: H5Type>(dataset: &Dataset, values: &[T]) -> hdf5::Result<()> {
    let start = dataset.shape().first().copied().unwrap_or(0);
    if values.is_empty() {
        return Ok(());
    }
    dataset.resize(start + values.len())?;
    dataset.write_slice(ArrayView1::from(values), start..start + values.len())
}

fn append_pairs(dataset: &Dataset, values: &[[f32; 2]]) -> hdf5::Result<()> {
    let start = dataset.shape().first().copied().unwrap_or(0);
    if values.is_empty() {
        return Ok(());
    }
    dataset.resize((start + values.len(), 2))?;
    dataset.write_slice(rows(values)?, ndarray::s![start..start + values.len(), ..])
}

fn rows<const N: usize>(values: &[[f32; N]]) -> hdf5::Result<ArrayView2<'_, f32>> {
    ArrayView2::from_shape((values.len(), N), values.as_flattened())
        .map_err(|e| hdf5::Error::Internal(e.to_string()))
}

pub(super) fn number<T: H5Type>(at: &hdf5::Location, name: &str, value: T) -> hdf5::Result<()> {
    at.new_attr::<T>().create(name)?.write_scalar(&value)
}

pub(super) fn text(at: &hdf5::Location, name: &str, value: &str) -> hdf5::Result<()> {
    let value: VarLenUnicode =
        value.parse().map_err(|_| hdf5::Error::Internal(format!("`{name}` holds a NUL")))?;
    number(at, name, value)
}
