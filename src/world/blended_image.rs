//! From sub-tiles to normalised tiles, band by band.

use std::ops::Range;

use ndarray::{Array2, ArrayView1, ArrayView2, s};
use rayon::prelude::*;

use super::field_scan::{FieldScan, FieldScanRows, ScannedRows};
use super::subtile_store::SubtileStore;
use super::subtiles::Partition;
use crate::detect::ShownImage;
use crate::error::{Error, Result};
use crate::imaging::Noise;
use crate::io::WorldWriter;
use crate::progress::{Progress, Silent};
use crate::recipe::OVERVIEW_FACTOR;
use crate::recipe::resolved_recipe::Recipe;

/// Largest number of pixels that are kept in memory between the search for the range and writing (134 MB); larger images are made twice.
const MOST_KEPT: usize = 1 << 25;

/// Returns the number of pixels of an image without a recording that are kept in memory.
pub(crate) fn kept_pixels(shape: [usize; 2]) -> usize {
    let pixels = shape[0] * shape[1];
    if pixels <= MOST_KEPT { pixels } else { 0 }
}

/// The least and the greatest value of an image as stored; and its pixels, where they are few enough to be kept.
pub(crate) struct StoredRange {
    pub(crate) limits: [f32; 2],
    kept: Option<Array2<f32>>,
}

/// The image of a world, computed band by band from the sub-tiles on disk.
pub(crate) struct BlendedImage<'a> {
    partition: &'a Partition,
    /// Pixels of the sub-tiles along the edge of one pixel of the image.
    parts: usize,
    store: &'a SubtileStore,
    noise: Option<Noise>,
    /// The recording that takes the place of noise.
    scan: Option<&'a FieldScan>,
    shown: ShownImage,
    /// Number of measured images of a sub-tile.
    measured: usize,
    shape: [usize; 2],
    grid: [usize; 2],
    tile: usize,
    stride: usize,
}

impl<'a> BlendedImage<'a> {
    /// Describes the image of the built part of a field. Each of its pixels is the mean of `parts` x `parts` pixels of the partition.
    pub(crate) fn new(
        recipe: &Recipe,
        (partition, parts): (&'a Partition, usize),
        store: &'a SubtileStore,
        noise: bool,
        scan: Option<&'a FieldScan>,
    ) -> Self {
        let field = &recipe.field;
        let dose = recipe.dose.electrons_per_angstrom2;
        let measured = recipe.detector.measured();
        let main = ShownImage { detector: measured[0].clone(), number: 0, axis: None };
        BlendedImage {
            partition,
            parts,
            store,
            noise: noise.then(|| Noise::new(recipe, dose, field.crop_origin_px())),
            scan,
            shown: main,
            measured: measured.len(),
            shape: field.pixels(field.built_grid()),
            grid: field.built_grid(),
            tile: field.tile_px,
            stride: field.stride_px(),
        }
    }

    /// Returns another image.
    pub(crate) fn of_detector(&self, shown: ShownImage) -> Self {
        BlendedImage {
            noise: self.noise.map(|noise| noise.of_detector(shown.number as u16)),
            shown,
            ..*self
        }
    }

    fn clean(&self, rows: Range<usize>) -> Result<Array2<f32>> {
        match self.shown.parts() {
            None => self.measured(self.shown.number, rows),
            Some(parts) => self.angles(parts, rows).map(|[mean, _]| mean),
        }
    }

    /// Rows of a centre of mass, and of the standard deviation of the angle of one electron.
    fn angles(&self, parts: [usize; 3], rows: Range<usize>) -> Result<[Array2<f32>; 2]> {
        let [electrons, share, square] = parts.map(|number| self.measured(number, rows.clone()));
        let (electrons, share, square) = (electrons?, share?, square?);
        Ok(self.shown.angles([electrons.view(), share.view(), square.view()]))
    }

    /// Adds the noise of the dose to rows of the image.
    fn add_noise(&self, noise: &Noise, values: &mut Array2<f32>, rows: Range<usize>) -> Result<()> {
        let (Some(parts), Some(axis)) = (self.shown.parts(), self.shown.axis) else {
            noise.apply(values, rows.start);
            return Ok(());
        };
        let electrons = self.measured(self.shown.number, rows.clone())?;
        let [_, deviation] = self.angles(parts, rows.clone())?;
        noise.deflect(values, rows.start, (&electrons, &deviation), axis);
        Ok(())
    }

    /// Rows of a measured image.
    fn measured(&self, number: usize, rows: Range<usize>) -> Result<Array2<f32>> {
        let parts = self.parts;
        if parts == 1 {
            return self.fine(number, rows);
        }
        let fine = self.fine(number, rows.start * parts..rows.end * parts)?;
        let size = (rows.len(), self.shape[1]);
        Ok(Array2::from_shape_fn(size, |(row, column)| fine[(row * parts, column * parts)]))
    }

    /// Rows of a measured image of the sub-tiles, in the sub-tiles' pixels.
    fn fine(&self, number: usize, rows: Range<usize>) -> Result<Array2<f32>> {
        let count = self.measured;
        self.partition.blend(rows, |tile| {
            let images = self.store.load(tile.index, tile.stored_shape(count), &Silent);
            let images = images.ok_or_else(|| {
                let path = self.store.path(tile.index);
                let lost = std::io::Error::other("changed while the world was being written");
                Error::io(&path, "read", lost)
            })?;
            let rows = tile.rows.len();
            match count {
                1 => Ok(images),
                _ => Ok(images.slice(s![number * rows..(number + 1) * rows, ..]).to_owned()),
            }
        })
    }

    /// Bands of the image as stored, from top to bottom; `kept` is the whole image.
    fn bands<'b>(&'b self, kept: Option<&'b Array2<f32>>) -> StoredBands<'b> {
        let clean = |rows| self.fine(self.shown.number, rows);
        StoredBands { image: self, kept, scan: self.scan.map(|scan| scan.begin(clean)) }
    }

    /// Finds the least and the greatest value of the image as stored.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Interrupted`].
    pub(crate) fn range(&self, progress: &dyn Progress) -> Result<StoredRange> {
        progress.start("scaling", "row", self.shape[0] as u64);
        let mut limits = NO_LIMITS;
        let keeps = self.scan.is_none() && kept_pixels(self.shape) > 0;
        let mut kept = keeps.then(|| Array2::zeros(self.shape));
        let mut bands = self.bands(None);
        for first in (0..self.shape[0]).step_by(self.tile) {
            stop_if_asked(progress)?;
            let rows = first..(first + self.tile).min(self.shape[0]);
            let band = bands.rows(rows.clone(), None)?.values;
            limits = wider(limits, limits_of(&band));
            if let Some(kept) = &mut kept {
                kept.slice_mut(s![rows.clone(), ..]).assign(&band);
            }
            progress.advance(rows.len() as u64);
        }
        progress.finish();
        if let Some(warning) = bands.scan.as_ref().and_then(FieldScanRows::clipping_warning) {
            progress.warn(&warning);
        }
        Ok(StoredRange { limits, kept })
    }

    /// Writes tiles, overview and valid region, `range` scaled to \[0, 1\].
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Hdf5`], [`Error::Interrupted`].
    pub(crate) fn write(
        &self,
        writer: &WorldWriter,
        range: &StoredRange,
        keep_clean: bool,
        progress: &dyn Progress,
    ) -> Result<()> {
        let [low, high] = range.limits;
        let offset = f64::from(low);
        let scale = if high > low { f64::from(high) - offset } else { 1.0 };
        writer.scaling(scale, offset, self.shown.detector.units())?;
        let mut overview = Overview::new(self.shape);
        let mut bands = self.bands(range.kept.as_ref());
        progress.start("writing tiles", "tile", (self.grid[0] * self.grid[1]) as u64);
        for row in 0..self.grid[0] {
            stop_if_asked(progress)?;
            let first = row * self.stride;
            let rows = first..first + self.tile;
            let made_here = self.scan.is_none() && range.kept.is_none();
            let clean = (keep_clean || made_here).then(|| self.clean(rows.clone()));
            let clean = clean.transpose()?;
            if let Some(clean) = clean.as_ref().filter(|_| keep_clean) {
                writer.clean_tiles(row, &self.tiles(clean))?;
            }
            let ScannedRows { values: mut band, valid } = bands.rows(rows, clean)?;
            let scaled = |v: f32| ((f64::from(v) - offset) / scale).clamp(0.0, 1.0) as f32;
            let lines: Vec<_> = band.outer_iter_mut().collect();
            lines.into_par_iter().for_each(|mut line| line.mapv_inplace(scaled));
            writer.tiles(row, &self.tiles(&band))?;
            let own = if row + 1 == self.grid[0] { self.tile } else { self.stride };
            overview.add(first, band.slice(s![..own, ..]));
            writer.valid_rows(first, valid.slice(s![..own, ..]))?;
            progress.advance(self.grid[1] as u64);
        }
        progress.finish();
        writer.overview(overview.mean().view())
    }

    fn tiles<'b>(&self, band: &'b Array2<f32>) -> Vec<ArrayView2<'b, f32>> {
        let starts = (0..self.grid[1]).map(|column| column * self.stride);
        starts.map(|start| band.slice(s![.., start..start + self.tile])).collect()
    }
}

/// Bands of an image, from top to bottom.
struct StoredBands<'a> {
    image: &'a BlendedImage<'a>,
    kept: Option<&'a Array2<f32>>,
    scan: Option<FieldScanRows<'a>>,
}

impl StoredBands<'_> {
    /// Returns rows as stored, in fractions of the beam or in mrad; `clean` are the same rows of the noise-free image, if they have been read already.
    fn rows(&mut self, rows: Range<usize>, clean: Option<Array2<f32>>) -> Result<ScannedRows> {
        if let Some(scan) = &mut self.scan {
            return scan.rows(rows);
        }
        let values = match self.kept {
            Some(kept) => kept.slice(s![rows, ..]).to_owned(),
            None => {
                let mut values = clean.map_or_else(|| self.image.clean(rows.clone()), Ok)?;
                if let Some(noise) = &self.image.noise {
                    self.image.add_noise(noise, &mut values, rows)?;
                }
                values
            }
        };
        let valid = Array2::from_elem(values.dim(), true);
        Ok(ScannedRows { values, valid })
    }
}

/// The least and the greatest value of an image. Zeros have no sign, since their order would depend on the threads.
fn limits_of(image: &Array2<f32>) -> [f32; 2] {
    let lines: Vec<_> = image.outer_iter().collect();
    let of_line =
        |line: ArrayView1<f32>| line.iter().fold(NO_LIMITS, |all, v| wider(all, [*v + 0.0; 2]));
    lines.into_par_iter().map(of_line).reduce(|| NO_LIMITS, wider)
}

/// The limits of no value at all.
const NO_LIMITS: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

fn wider(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

fn stop_if_asked(progress: &dyn Progress) -> Result<()> {
    if progress.interrupted() { Err(Error::Interrupted) } else { Ok(()) }
}

/// An area average, block by block; the last block of a row or column may be partial.
pub(crate) struct Overview {
    sums: Array2<f64>,
    shape: [usize; 2],
}

impl Overview {
    pub(crate) fn new(shape: [usize; 2]) -> Self {
        let [rows, columns] = shape.map(|n| n.div_ceil(OVERVIEW_FACTOR));
        Overview { sums: Array2::zeros((rows, columns)), shape }
    }

    /// Adds rows from `first_row` on.
    pub(crate) fn add(&mut self, first_row: usize, band: ArrayView2<f32>) {
        for ((row, column), value) in band.indexed_iter() {
            let block = [(first_row + row) / OVERVIEW_FACTOR, column / OVERVIEW_FACTOR];
            self.sums[block] += f64::from(*value);
        }
    }

    /// Returns the mean of each block.
    pub(crate) fn mean(&self) -> Array2<f32> {
        let edge = |i: usize, n: usize| (n - i * OVERVIEW_FACTOR).min(OVERVIEW_FACTOR) as f64;
        Array2::from_shape_fn(self.sums.dim(), |(i, j)| {
            (self.sums[(i, j)] / (edge(i, self.shape[0]) * edge(j, self.shape[1]))) as f32
        })
    }
}
