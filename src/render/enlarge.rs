//! Images made smaller or larger by whole factors.

use crate::error::{Error, Result};
use crate::setting::Setting;

/// How an image is enlarged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Enlarge {
    /// Every pixel becomes a square.
    Nearest,
    /// Linear interpolation between pixel centres.
    #[default]
    Bilinear,
}

/// Change of scale to a wanted size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SizeChange {
    /// Blocks of so many pixels squared become one.
    Down(usize),
    /// Every pixel becomes so many squared.
    Up(usize),
}

impl SizeChange {
    /// The scale that brings the longer side as near to `max_side` as it goes without passing it.
    pub fn to_fit(shape: [usize; 2], max_side: usize) -> Self {
        let side = shape[0].max(shape[1]).max(1);
        if side > max_side {
            SizeChange::Down(side.div_ceil(max_side))
        } else {
            SizeChange::Up(max_side / side)
        }
    }

    /// Picture pixels per image pixel.
    pub fn factor(self) -> f64 {
        match self {
            SizeChange::Down(n) => 1.0 / n as f64,
            SizeChange::Up(n) => n as f64,
        }
    }

    /// Where the image position `p` (0 is the first pixel's centre) lies in the picture.
    pub fn place(self, p: f64) -> f64 {
        (p + 0.5) * self.factor() - 0.5
    }
}

/// A matrix, row by row.
pub(super) struct Matrix {
    pub shape: [usize; 2],
    pub values: Vec<f32>,
}

/// Fails on the first value that is not finite, and names its place.
pub(super) fn check_finite(values: &[f32], columns: usize) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => Err(Error::invalid(
            Setting::ImageValue,
            format!("{} at row {}, column {}", values[i], i / columns, i % columns),
            "a picture needs finite values; the computation that made the image has failed there",
        )),
        None => Ok(()),
    }
}

/// Averages blocks of `n` by `n`; those at the lower and right edge may be smaller.
pub(super) fn shrink(values: &[f32], shape: [usize; 2], n: usize) -> Matrix {
    let [rows, columns] = shape;
    let small = [rows.div_ceil(n), columns.div_ceil(n)];
    let mut out = Vec::with_capacity(small[0] * small[1]);
    for i in 0..small[0] {
        let block = &values[i * n * columns..((i + 1) * n).min(rows) * columns];
        let height = block.len() / columns;
        for j in 0..small[1] {
            let range = j * n..((j + 1) * n).min(columns);
            let area = (height * range.len()) as f64;
            let sum: f64 = block
                .chunks_exact(columns)
                .flat_map(|row| &row[range.clone()])
                .map(|&v| f64::from(v))
                .sum();
            out.push((sum / area) as f32);
        }
    }
    Matrix { shape: small, values: out }
}

/// Makes `n` by `n` pixels of each.
pub(super) fn enlarge(values: &[f32], shape: [usize; 2], n: usize, how: Enlarge) -> Matrix {
    let [rows, columns] = shape;
    let large = [rows * n, columns * n];
    let mut out = Vec::with_capacity(large[0] * large[1]);
    for i in 0..large[0] {
        if how == Enlarge::Nearest {
            let row = &values[i / n * columns..(i / n + 1) * columns];
            out.extend(row.iter().flat_map(|&v| std::iter::repeat_n(v, n)));
            continue;
        }
        let (above, below, t) = neighbours(i, n, rows);
        for j in 0..large[1] {
            let (left, right, s) = neighbours(j, n, columns);
            let at = |row: usize, column: usize| values[row * columns + column];
            let top = at(above, left) + (at(above, right) - at(above, left)) * s;
            let bottom = at(below, left) + (at(below, right) - at(below, left)) * s;
            out.push(top + (bottom - top) * t);
        }
    }
    Matrix { shape: large, values: out }
}

/// The two pixels around the centre of enlarged pixel `i`, and how far it is from the first.
fn neighbours(i: usize, n: usize, size: usize) -> (usize, usize, f32) {
    let position = (((i as f64) + 0.5) / n as f64 - 0.5).clamp(0.0, (size - 1) as f64);
    let first = position as usize;
    (first, (first + 1).min(size - 1), (position - first as f64) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_fits() {
        assert_eq!(SizeChange::to_fit([100, 40], 1024), SizeChange::Up(10));
        assert_eq!(SizeChange::to_fit([3000, 40], 1024), SizeChange::Down(3));
        assert_eq!(SizeChange::to_fit([1024, 1024], 1024), SizeChange::Up(1));
        assert_eq!(SizeChange::Up(10).place(0.0), 4.5);
    }

    #[test]
    fn averages_at_the_edge_use_what_is_there() {
        let values: Vec<f32> = (0..15).map(|v| v as f32).collect();
        let small = shrink(&values, [3, 5], 2);
        assert_eq!(small.shape, [2, 3]);
        assert_eq!(small.values, [3.0, 5.0, 6.5, 10.5, 12.5, 14.0]);
    }

    #[test]
    fn bilinear_is_exact_for_a_ramp_and_nearest_repeats() {
        let ramp: Vec<f32> = (0..12).map(|i| (i / 4 * 10 + i % 4) as f32).collect();
        let large = enlarge(&ramp, [3, 4], 5, Enlarge::Bilinear);
        assert_eq!(large.shape, [15, 20]);
        let at = |i: usize, j: usize| large.values[i * 20 + j];
        assert!((at(7, 7) - 11.0).abs() < 1e-5);
        assert!((at(8, 9) - (10.0 * 1.2 + 1.4)).abs() < 1e-5);
        assert_eq!(at(0, 0), 0.0);
        let blocks = enlarge(&ramp, [3, 4], 2, Enlarge::Nearest);
        assert_eq!(blocks.values[..8], [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]);
        assert_eq!(blocks.values[..8], blocks.values[8..16]);
    }

    #[test]
    fn values_that_are_not_finite_are_named() {
        let error = check_finite(&[0.0, 1.0, 2.0, f32::NAN], 2).unwrap_err().to_string();
        assert!(error.contains("NaN at row 1, column 1"), "{error}");
    }
}
