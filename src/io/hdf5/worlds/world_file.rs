//! Reads a world file.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::slice;

use hdf5::{Dataset, File, H5Type};
use ndarray::{Array, Array1, Array2, Dimension, s};

use super::schema::{self, DefectName};
use super::world_metadata::{WorldMetadata, not_a_world, read_metadata};
use crate::error::{Error, Result};
use crate::io::hdf5::hdf5_guard::{self, check_storage};
use crate::io::hdf5::hdf5_open::{self, regular_file};
use crate::io::hdf5::hdf5_values::{self, Plain};
use crate::plane;
use crate::recipe::OVERVIEW_FACTOR;
use crate::setting::Setting;

/// Sites of a world, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct GroundTruth {
    /// Positions (x, y) in nm from the centre of pixel (0, 0).
    pub positions: Vec<[f32; 2]>,
    /// Depth in nm; this and the following lists are empty if the file lacks them.
    pub z: Vec<f32>,
    /// Codes of [`crate::io::atom_type`].
    pub types: Vec<i32>,
    /// Whether each site is a defect.
    pub defects: Vec<bool>,
    /// Atomic numbers.
    pub numbers: Vec<i32>,
    /// Names of the defects.
    pub defect_names: Vec<String>,
    /// Index of the column.
    pub columns: Vec<i32>,
}

/// A world file, open for reading.
pub struct WorldFile {
    pub(super) path: PathBuf,
    pub(super) file: File,
    /// Size of the file in bytes.
    pub(super) bytes: u64,
    pub(super) metadata: WorldMetadata,
    /// Path of the group of the detector whose images are read, with `/` behind it; empty for the main detector.
    pub(super) images: String,
}

/// Lists of the ground truth with one entry for each site.
const SITE_LISTS: [&str; 6] =
    ["defect_mask", "atom_z", "atomic_numbers", "defect_types", "atom_columns", "atom_types"];
/// Largest relative difference of lengths that count as equal.
const SAME_FIELD: f64 = 1e-6;

impl WorldFile {
    /// Opens a world, and checks that it is a complete world. All data of a world are in its file: links to other files are refused, and so
    /// are lists that are larger than a file of this size can hold.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Invalid`] for a foreign, truncated or incomplete file.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = regular_file(path)?;
        let broken = "is not HDF5, or is truncated; copy or build it again";
        let file =
            hdf5_open::open(path).map_err(|e| not_a_world(path, hdf5_open::reason(&e, broken)))?;
        hdf5_guard::datasets(&file).map_err(|fault| not_a_world(path, fault))?;
        let metadata = read_metadata(path, &file)?;
        let images = String::new();
        let world = WorldFile { path: path.to_owned(), file, bytes, metadata, images };
        world.check()?;
        Ok(world)
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that all pixels of a part of the image are finite; the error names the place of the first that is not. The part's first pixel
    /// is `first` (row, column).
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub(crate) fn check_finite(
        &self,
        part: &Array2<f32>,
        first: [usize; 2],
        clean: bool,
    ) -> Result<()> {
        let Some(((row, column), value)) = part.indexed_iter().find(|(_, v)| !v.is_finite()) else {
            return Ok(());
        };
        let m = &self.metadata;
        let at = [first[0] + row, first[1] + column];
        let tile = plane::per_axis(at, m.grid_shape, |px, tiles| {
            (px / (m.tile_size_px - m.overlap_px)).min(tiles - 1)
        });
        let group = if clean { schema::CLEAN } else { schema::TILES };
        let (name, group) = (schema::tile_name(tile[0], tile[1]), self.of_images(group));
        let what = format!(
            "holds {value} at row {}, column {} of the image (/{group}/{name}), where a finite \
             intensity is expected; build it again",
            at[0], at[1]
        );
        Err(not_a_world(&self.path, what))
    }

    /// Returns the description of the world.
    pub fn metadata(&self) -> &WorldMetadata {
        &self.metadata
    }

    /// Returns height and width in pixels.
    pub fn shape(&self) -> [usize; 2] {
        let m = &self.metadata;
        m.grid_shape.map(|n| n * (m.tile_size_px - m.overlap_px) + m.overlap_px)
    }

    /// Reads a tile as the file holds it, [row, column] = [y, x], with `tile_size_px` rows and columns: intensities normalised with the
    /// scale and offset of [`WorldMetadata::scaling`].
    ///
    /// # Errors
    /// [`Error::Invalid`] outside the grid or for a damaged tile.
    pub fn tile(&self, row: usize, column: usize) -> Result<Array2<f32>> {
        self.tile_of(schema::TILES, row, column)
    }

    /// Whether the file holds noiseless tiles.
    pub fn has_clean(&self) -> bool {
        self.file.link_exists(&self.of_images(schema::CLEAN))
    }

    /// Reads a noiseless tile, [row, column] = [y, x], with `tile_size_px` rows and columns, in fractions of the beam.
    ///
    /// # Errors
    /// As [`WorldFile::tile`], also if the world was built without noiseless tiles.
    pub fn clean_tile(&self, row: usize, column: usize) -> Result<Array2<f32>> {
        self.tile_of(schema::CLEAN, row, column)
    }

    /// Reads the normalised image of some rows (y) and columns (x) of pixels from the tiles; the result has the requested shape [rows,
    /// columns].
    ///
    /// # Errors
    /// [`Error::Invalid`] outside the image, or for a damaged tile.
    pub fn stitched(&self, rows: Range<usize>, columns: Range<usize>) -> Result<Array2<f32>> {
        self.stitched_of(schema::TILES, rows, columns)
    }

    /// Reads the noiseless image of some rows (y) and columns (x) of pixels, in fractions of the beam; the result has the requested shape
    /// [rows, columns].
    ///
    /// # Errors
    /// As [`WorldFile::stitched`]; [`Error::Choice`] if the world was built without noiseless tiles.
    pub fn stitched_clean(&self, rows: Range<usize>, columns: Range<usize>) -> Result<Array2<f32>> {
        self.need_clean()?;
        self.stitched_of(schema::CLEAN, rows, columns)
    }

    /// Fails if the world was built without noiseless tiles.
    ///
    /// # Errors
    /// [`Error::Choice`].
    pub(crate) fn need_clean(&self) -> Result<()> {
        let message = "holds no noiseless image; build the world again and keep that image too";
        match self.has_clean() {
            true => Ok(()),
            false => Err(Error::choice(&self.path, Setting::CleanImage, message)),
        }
    }

    fn stitched_of(
        &self,
        group: &str,
        rows: Range<usize>,
        columns: Range<usize>,
    ) -> Result<Array2<f32>> {
        let [height, width] = self.shape();
        let inside = |r: &Range<usize>, n| r.start <= r.end && r.end <= n;
        if !inside(&rows, height) || !inside(&columns, width) {
            let expected = format!("the image has {height} x {width} pixels");
            return Err(Error::invalid(
                Setting::Region,
                format!("{rows:?} x {columns:?}"),
                expected,
            ));
        }
        let stride = self.metadata.tile_size_px - self.metadata.overlap_px;
        let tiles = |range: &Range<usize>, n: usize| {
            (range.start / stride).min(n - 1)..range.end.div_ceil(stride).min(n)
        };
        let mut out = Array2::zeros((rows.len(), columns.len()));
        for r in tiles(&rows, self.metadata.grid_shape[0]) {
            for c in tiles(&columns, self.metadata.grid_shape[1]) {
                let tile = self.tile_of(group, r, c)?;
                let (ys, xs) =
                    (common(&rows, r * stride, &tile, 0), common(&columns, c * stride, &tile, 1));
                let from = tile.slice(s![
                    ys.start - r * stride..ys.end - r * stride,
                    xs.start - c * stride..xs.end - c * stride
                ]);
                let to = s![
                    ys.start - rows.start..ys.end - rows.start,
                    xs.start - columns.start..xs.end - columns.start
                ];
                out.slice_mut(to).assign(&from);
            }
        }
        Ok(out)
    }

    /// Reads the overview: the whole image at lower resolution, [row, column] = [y, x], normalised like the tiles.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a damaged file.
    pub fn overview(&self) -> Result<Array2<f32>> {
        let name = self.of_images(schema::OVERVIEW);
        let dataset = self.dataset(&name)?;
        let expected = self.shape().map(|n| n.div_ceil(OVERVIEW_FACTOR));
        if dataset.shape() != expected {
            let found = dataset.shape();
            let fault = format!("has an overview of shape {found:?}, expected {expected:?}");
            return Err(not_a_world(&self.path, fault));
        }
        self.all(&dataset, &name)
    }

    /// Returns the number of image pixels along an edge of an overview pixel, as given in the file.
    pub(crate) fn overview_factor(&self) -> Option<u64> {
        let overview = self.dataset(&self.of_images(schema::OVERVIEW)).ok()?;
        hdf5_guard::number(&overview, "factor")
    }

    /// Returns the pixel (row, column) of the recipe's whole field at which the image begins, as given in the file.
    pub(crate) fn origin_px(&self) -> Option<[f64; 2]> {
        let metadata = self.file.group(schema::METADATA).ok()?;
        hdf5_guard::pair(&metadata, "origin_px_in_full_field")
    }

    /// Number of lattice sites.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a damaged file.
    pub fn site_count(&self) -> Result<usize> {
        Ok(self.truth_dataset("atom_types")?.size())
    }

    /// Reads the sites `range`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a range beyond the end or a damaged file.
    pub fn truth(&self, range: Range<usize>) -> Result<GroundTruth> {
        let count = self.site_count()?;
        if range.start > range.end || range.end > count {
            let expected = format!("the world has {count} sites");
            return Err(Error::invalid(Setting::SiteRange, format!("{range:?}"), expected));
        }
        let positions = self.truth_dataset("atom_positions")?;
        let pairs: Array2<f32> = self.part(&positions, "atom_positions", &[range.clone(), 0..2])?;
        self.check_places(pairs.iter(), "sites")?;
        let names: Vec<DefectName> = self.optional("defect_types", &range)?;
        Ok(GroundTruth {
            positions: pairs.rows().into_iter().map(|r| [r[0], r[1]]).collect(),
            types: self.required("atom_types", &range)?,
            // Read as bytes: the file of another program may hold values that are no valid `bool`.
            defects: self.required::<u8>("defect_mask", &range)?.iter().map(|v| *v != 0).collect(),
            z: self.optional("atom_z", &range)?,
            numbers: self.optional("atomic_numbers", &range)?,
            defect_names: names
                .iter()
                .map(|n| String::from_utf8_lossy(n.as_bytes()).into_owned())
                .collect(),
            columns: self.optional("atom_columns", &range)?,
        })
    }

    fn tile_of(&self, group: &str, row: usize, column: usize) -> Result<Array2<f32>> {
        let name = format!("{}/{}", self.of_images(group), schema::tile_name(row, column));
        let dataset = self.dataset(&name)?;
        let size = self.metadata.tile_size_px;
        if dataset.shape() != [size, size] {
            let found = format!("/{name} has shape {:?}, not {size} x {size}", dataset.shape());
            return Err(not_a_world(&self.path, found));
        }
        self.all(&dataset, &name)
    }

    /// Reads all values of the dataset that is called `name`.
    pub(super) fn all<T: Plain, D: Dimension>(
        &self,
        dataset: &Dataset,
        name: &str,
    ) -> Result<Array<T, D>> {
        hdf5_values::all(dataset, &self.path).map_err(|fault| self.unreadable(name, &fault))
    }

    /// Reads a part of the values of the dataset that is called `name`, one range for each axis.
    pub(super) fn part<T: Plain, D: Dimension>(
        &self,
        dataset: &Dataset,
        name: &str,
        part: &[Range<usize>],
    ) -> Result<Array<T, D>> {
        hdf5_values::part(dataset, &self.path, part).map_err(|fault| self.unreadable(name, &fault))
    }

    fn unreadable(&self, name: &str, fault: &str) -> Error {
        let advice = "the file is damaged: copy or build it again";
        not_a_world(&self.path, format!("/{name} {fault}; {advice}"))
    }

    pub(super) fn dataset(&self, name: &str) -> Result<Dataset> {
        let missing = |_| not_a_world(&self.path, format!("has no dataset /{name}"));
        let dataset = self.file.dataset(name).map_err(missing)?;
        let refused = |fault| not_a_world(&self.path, format!("/{name} {fault}"));
        check_storage(&dataset, self.bytes).map_err(refused)?;
        Ok(dataset)
    }

    pub(super) fn truth_dataset(&self, name: &str) -> Result<Dataset> {
        self.dataset(&format!("{}/{name}", schema::TRUTH))
    }

    /// Opens a dataset of values that are larger than a number.
    pub(super) fn dataset_of<T: H5Type>(&self, name: &str) -> Result<Dataset> {
        let dataset = self.dataset(name)?;
        let refused = |fault| not_a_world(&self.path, format!("/{name} {fault}"));
        hdf5_guard::check_bytes(&dataset.shape(), size_of::<T>(), self.bytes).map_err(refused)?;
        Ok(dataset)
    }

    fn required<T: Plain>(&self, name: &str, range: &Range<usize>) -> Result<Vec<T>> {
        let list = self.truth_dataset(name)?;
        let array: Array1<T> = self.part(&list, name, slice::from_ref(range))?;
        Ok(array.into_iter().collect())
    }

    fn optional<T: Plain>(&self, name: &str, range: &Range<usize>) -> Result<Vec<T>> {
        match self.file.link_exists(&format!("{}/{name}", schema::TRUTH)) {
            true => self.required(name, range),
            false => Ok(Vec::new()),
        }
    }

    /// Checks that all tiles exist, that lists of the ground truth are equally long, and that sizes agree.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |found: String| Err(not_a_world(&self.path, found));
        let name = self.of_images(schema::TILES);
        let tiles = self.file.group(&name);
        let tiles = tiles.map_err(|_| not_a_world(&self.path, format!("has no group /{name}")))?;
        let [rows, columns] = self.metadata.grid_shape;
        if tiles.len() != (rows * columns) as u64 {
            return refuse(format!("has {} of {} tiles", tiles.len(), rows * columns));
        }
        self.check_size()?;
        let count = self.site_count()?;
        if self.truth_dataset("atom_positions")?.shape() != [count, 2] {
            return refuse("has lists of sites of unequal length".into());
        }
        for name in SITE_LISTS {
            let there = self.file.link_exists(&format!("{}/{name}", schema::TRUTH));
            if (there || name == "defect_mask") && self.truth_dataset(name)?.shape() != [count] {
                return refuse(format!("has lists of sites of unequal length: {name}"));
            }
        }
        Ok(())
    }

    /// Checks that the first tile has the stated size, that the image is no larger than the file can hold, and that the field is as wide as
    /// its pixels.
    fn check_size(&self) -> Result<()> {
        let m = &self.metadata;
        let (name, size) = (
            format!("{}/{}", self.of_images(schema::TILES), schema::tile_name(0, 0)),
            m.tile_size_px,
        );
        let shape = self.dataset(&name)?.shape();
        if shape != [size, size] {
            let found =
                format!("/{name} has shape {shape:?}, and /metadata says tile_size_px = {size}");
            return Err(not_a_world(&self.path, found));
        }
        let fault = |fault| not_a_world(&self.path, format!("/{} {fault}", schema::TILES));
        hdf5_guard::check_bytes(&self.shape(), size_of::<f32>(), self.bytes).map_err(fault)?;
        let field = self.shape().map(|n| n as f64 * m.pixel_size_nm);
        // The comparison is false for NaN.
        let same = |k: usize| (m.fov_nm[k] - field[k]).abs() <= SAME_FIELD * field[k];
        if !(0..2).all(same) {
            let found = format!(
                "says fov_nm = {:?}, but its pixels cover {:.4} x {:.4} nm (height, width)",
                m.fov_nm, field[0], field[1]
            );
            return Err(not_a_world(&self.path, found));
        }
        Ok(())
    }
}

fn common(range: &Range<usize>, start: usize, tile: &Array2<f32>, axis: usize) -> Range<usize> {
    let from = range.start.max(start);
    from..range.end.min(start + tile.shape()[axis]).max(from)
}
