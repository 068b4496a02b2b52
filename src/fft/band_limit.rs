//! Multiplication in frequency space within an anti-aliasing band limit.

use num_complex::Complex32;

use super::radix_plan::lanes;

/// A round anti-aliasing aperture in frequency space: one inside, zero outside, with a soft edge between.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BandLimit {
    /// Squared radius from which on the weight is zero.
    pub limit_k2: f64,
    /// Squared radius up to which the weight is one. Between the two it falls as the smooth step
    /// `u^2 (3 - 2 u)` of the squared frequency, which is a cosine taper to 1 %.
    pub full_k2: f64,
}

impl BandLimit {
    /// The weight at squared frequency `k2`.
    pub(crate) fn weight(&self, k2: f64) -> f64 {
        let u = ((self.limit_k2 - k2) * self.slope()).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    }

    /// Slope of the edge: steep but finite for a hard one, so that no weight is NaN.
    fn slope(&self) -> f64 {
        (self.limit_k2 - self.full_k2).max(1e-20).recip()
    }
}

/// A multiplier in frequency space, `row[ky] * column[kx] * weight(kx^2 + ky^2)`: separable except for the weight of
/// the [`BandLimit`].
#[derive(Debug, Clone)]
pub(crate) struct BandLimitedMultiplier {
    pub(super) row: Vec<[f32; 2]>,
    /// Squared limit less ky^2.
    pub(super) row_room: Vec<f32>,
    pub(super) column: Vec<[f32; 2]>,
    pub(super) column_k2: Vec<[f32; 2]>,
    pub(super) slope: f32,
}

impl BandLimitedMultiplier {
    /// `row` and `column` are indexed by FFT frequency, and so are the squared frequencies `row_k2` and
    /// `column_k2`; `order` is the frequency index at each position of a transformed column.
    pub(crate) fn new(
        order: &[usize],
        row: &[Complex32],
        row_k2: &[f64],
        column: &[Complex32],
        column_k2: &[f64],
        band_limit: BandLimit,
    ) -> Self {
        let padded = column.len() + lanes();
        let column_at = |x: usize| column.get(x).map_or([0.0; 2], |c| [c.re, c.im]);
        let k2_at = |x: usize| column_k2.get(x).map_or([f32::INFINITY; 2], |&k| [k as f32; 2]);
        BandLimitedMultiplier {
            row: order.iter().map(|&y| [row[y].re, row[y].im]).collect(),
            row_room: order.iter().map(|&y| (band_limit.limit_k2 - row_k2[y]) as f32).collect(),
            column: (0..padded).map(column_at).collect(),
            column_k2: (0..padded).map(k2_at).collect(),
            slope: band_limit.slope() as f32,
        }
    }

    /// Whether the multiplier is made for this number of rows, and has factors, or zeros, for the columns up to `end`.
    pub(super) fn reaches(&self, rows: usize, end: usize) -> bool {
        self.row.len() == rows && end <= self.column.len()
    }

    /// Multiplies column `x`, whose elements are in this multiplier's order.
    pub(crate) fn apply(&self, x: usize, column: &mut [Complex32]) {
        let [re, im] = self.column[x];
        for (y, v) in column.iter_mut().enumerate() {
            let [a, b] = self.row[y];
            let u = ((self.row_room[y] - self.column_k2[x][0]) * self.slope).clamp(0.0, 1.0);
            let weight = u * u * (3.0 - 2.0 * u);
            *v *= Complex32::new(re, im) * Complex32::new(a, b) * weight;
        }
    }
}
