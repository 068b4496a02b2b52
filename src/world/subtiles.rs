//! Sub-tiles: overlapping rectangles of pixels that are simulated one by one and blended by linear
//! ramps.

use std::ops::Range;

use rayon::prelude::*;

use crate::error::{Error, Result};
use ndarray::{Array2, ArrayView2, s};

/// One sub-tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SubTile {
    /// Number of the sub-tile, row by row.
    pub index: usize,
    /// Range of rows, in pixels.
    pub rows: Range<usize>,
    /// Range of columns, in pixels.
    pub columns: Range<usize>,
}

impl SubTile {
    /// Number of pixels: [rows, columns].
    pub(crate) fn shape(&self) -> [usize; 2] {
        [self.rows.len(), self.columns.len()]
    }

    /// Shape [rows, columns] of the images of several detectors, one below the other.
    pub(crate) fn stored_shape(&self, detectors: usize) -> [usize; 2] {
        [detectors * self.rows.len(), self.columns.len()]
    }
}

/// A partition of a raster into sub-tiles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Partition {
    rows: Vec<Range<usize>>,
    columns: Vec<Range<usize>>,
}

impl Partition {
    /// Divides a raster of `shape` pixels into sub-tiles at most `size_nm` wide that share `overlap_nm`. All sub-tiles have the same size:
    /// the least with which their number is as small as possible.
    ///
    /// # Errors
    /// [`Error::Invalid`] unless a sub-tile is more than three times as wide as the overlap: no pixel may lie in three sub-tiles of a row.
    pub(crate) fn new(
        shape: [usize; 2],
        pixel_nm: f64,
        size_nm: f64,
        overlap_nm: f64,
    ) -> Result<Self> {
        let pixels = |nm: f64| (nm / pixel_nm).round() as usize;
        let (size, overlap) = (pixels(size_nm), pixels(overlap_nm));
        let sensible = (0.0..1e5).contains(&size_nm) && (0.0..1e5).contains(&overlap_nm);
        if !sensible || size < 3 * overlap + 3 {
            let least = (3 * overlap + 3) as f64 * pixel_nm;
            let expected = format!(
                "sub-tiles that overlap by {overlap_nm} nm must be at least {least:.2} nm wide: three times the \
                 overlap and three pixels; take wider ones, or a smaller overlap"
            );
            let value = format!("{size_nm}");
            return Err(Error::invalid(crate::Setting::SubtileNm, value, expected));
        }
        let axis = |n| axis(n, size, overlap);
        Ok(Partition { rows: axis(shape[0]), columns: axis(shape[1]) })
    }

    /// Number of sub-tiles.
    pub(crate) fn len(&self) -> usize {
        self.rows.len() * self.columns.len()
    }

    /// Returns all sub-tiles, row by row.
    pub(crate) fn subtiles(&self) -> impl Iterator<Item = SubTile> + '_ {
        (0..self.len()).map(|index| {
            let (r, c) = (index / self.columns.len(), index % self.columns.len());
            SubTile { index, rows: self.rows[r].clone(), columns: self.columns[c].clone() }
        })
    }

    /// Blends the image of the rows `band` from the images that `load` returns for the sub-tiles that contribute. Sums run in the order of
    /// the sub-tiles, so the bytes do not depend on threads.
    ///
    /// # Errors
    /// Errors of `load`.
    pub(crate) fn blend(
        &self,
        band: Range<usize>,
        load: impl Fn(&SubTile) -> Result<Array2<f32>> + Sync,
    ) -> Result<Array2<f32>> {
        let needed: Vec<SubTile> = self
            .subtiles()
            .filter(|t| t.rows.start < band.end && band.start < t.rows.end)
            .collect();
        let images = needed.par_iter().map(&load).collect::<Result<Vec<_>>>()?;
        let width = self.columns.last().map_or(0, |c| c.end);
        let mut out = Array2::zeros((band.len(), width));
        let lines: Vec<_> = out.outer_iter_mut().collect();
        lines.into_par_iter().enumerate().for_each(|(k, mut line)| {
            let row = band.start + k;
            let mut sums = vec![0.0f64; width];
            for (tile, image) in needed.iter().zip(&images) {
                if tile.rows.contains(&row) {
                    self.add_row(tile, row, image.view(), &mut sums);
                }
            }
            line.iter_mut().zip(&sums).for_each(|(to, from)| *to = *from as f32);
        });
        Ok(out)
    }

    fn add_row(&self, tile: &SubTile, row: usize, image: ArrayView2<f32>, sums: &mut [f64]) {
        let (r, c) = (tile.index / self.columns.len(), tile.index % self.columns.len());
        let vertical = weight(&self.rows, r, row);
        let values = image.slice_move(s![row - tile.rows.start, ..]);
        for (column, &value) in tile.columns.clone().zip(values) {
            sums[column] += vertical * weight(&self.columns, c, column) * f64::from(value);
        }
    }
}

/// Covers `0..n` with equal ranges of at most `size` that overlap by at least `overlap`.
fn axis(n: usize, size: usize, overlap: usize) -> Vec<Range<usize>> {
    if n <= size {
        return std::iter::once(0..n).collect();
    }
    let count = (n - overlap).div_ceil(size - overlap);
    let length = (n + (count - 1) * overlap).div_ceil(count);
    let start = |i: usize| i * (n - length) / (count - 1);
    (0..count).map(|i| start(i)..start(i) + length).collect()
}

/// Returns the weight of range `i` at pixel `p` inside it: 1, except in the linear ramps, where the weights of the two ranges add to 1.
fn weight(ranges: &[Range<usize>], i: usize, p: usize) -> f64 {
    let rising = |left: &Range<usize>, right: &Range<usize>| {
        ((p - right.start) as f64 + 0.5) / (left.end - right.start) as f64
    };
    if i > 0 && p < ranges[i - 1].end {
        return rising(&ranges[i - 1], &ranges[i]);
    }
    match ranges.get(i + 1) {
        Some(next) if p >= next.start => 1.0 - rising(&ranges[i], next),
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]
        #[test]
        fn weights_add_to_one(n in 1usize..900, size in 2usize..120, overlap in 0usize..39) {
            prop_assume!(size >= 3 * overlap + 3);
            let ranges = axis(n, size, overlap);
            prop_assert!(ranges.iter().all(|r| r.len() <= size && r.end <= n));
            for p in 0..n {
                let inside = (0..ranges.len()).filter(|&i| ranges[i].contains(&p));
                let weights: Vec<f64> = inside.map(|i| weight(&ranges, i, p)).collect();
                prop_assert!(weights.len() <= 2, "{weights:?}");
                prop_assert!(weights.iter().all(|w| *w > 0.0));
                prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn the_published_size_splits_the_full_field_evenly() {
        let p = Partition::new([4964, 4964], 100.0 / 4964.0, 7.0, 1.0).unwrap();
        assert_eq!(p.len(), 17 * 17);
        assert!(p.subtiles().all(|t| t.shape() == [340, 340]));
    }

    #[test]
    fn a_constant_stays_constant() {
        let p = Partition::new([300, 200], 0.02, 2.0, 0.5).unwrap();
        let image = p.blend(17..260, |t| Ok(Array2::from_elem(t.shape(), 0.25))).unwrap();
        assert!(image.iter().all(|v| *v == 0.25));
    }
}
