//! The size of the electron source in diffraction patterns.
//!
//! The pattern at a place is the mean of the patterns of point sources around it, weighted by the intensity of the source. The integral
//! over the Gaussian becomes a sum over a raster of probes, along one axis after the other. The raster is the scan, refined where its steps
//! are wide compared with the source. Rows are processed in their order, and only a few are in memory.

use ndarray::{Array5, ArrayView5};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::f64::consts::LN_2;

use crate::engine::patterns::PatternRows;
use crate::engine::{Scan, Source};
use crate::error::Result;
use crate::plane;

/// The raster resolves the patterns' finest waves along the scan, and frequencies higher by this number divided by the standard deviation
/// of the source. The aliased part is then below 0.03 %, and the error of the sum below 0.1 % of the maximum (tests).
const FOLDED: f64 = 0.65;
/// Standard deviations at which the source is cut off. The cut leaves out 0.01 %; the remaining weights sum to 1.
const REACH: f64 = 4.0;

/// The raster of probes for a source, and their weights.
#[derive(Debug, Clone)]
pub(super) struct SourceRaster {
    scan: Scan,
    /// Number of raster steps in a step of the scan, along x and y.
    times: [usize; 2],
    /// Weights of the probes along x and y. The middle one is at the place of the scan.
    weights: [Vec<f32>; 2],
    columns: usize,
    rows: usize,
}

/// Collects rows of the raster and sums them to rows of the scan.
pub(super) struct SourceRows<'a> {
    raster: &'a SourceRaster,
    /// Rows already summed along x: the number of the raster's row, and values (thickness, column, ky, kx).
    held: VecDeque<(usize, Vec<f32>)>,
    next: usize,
}

impl SourceRaster {
    /// Makes the raster for a Gaussian source, and for patterns with waves up to `highest_k` (1/Angstrom) along the scan: twice the probe's
    /// semiangle over the wavelength.
    pub fn new(source: Source, scan: &Scan, highest_k: f64) -> Self {
        let sigma = source.fwhm_angstrom / (8.0 * LN_2).sqrt();
        let finest = highest_k + FOLDED / sigma;
        let times = scan.step_angstrom.map(|step| (step * finest).ceil().max(1.0));
        let step = plane::div(scan.step_angstrom, times);
        let weights = step.map(|step| {
            let reach = (REACH * sigma / step).ceil() as i64;
            let weight = |i: i64| libm::exp(-0.5 * (i as f64 * step / sigma).powi(2));
            let sum: f64 = (-reach..=reach).map(weight).sum();
            (-reach..=reach).map(|i| (weight(i) / sum) as f32).collect::<Vec<f32>>()
        });
        let reach = weights.each_ref().map(|weights| weights.len() / 2);
        let times = times.map(|n| n as usize);
        let probes = |k: usize| (scan.shape[1 - k] - 1) * times[k] + weights[k].len();
        let fine = Scan {
            origin_angstrom: plane::sub(
                scan.origin_angstrom,
                plane::mul(reach.map(|n| n as f64), step),
            ),
            step_angstrom: step,
            shape: [probes(1), probes(0)],
        };
        SourceRaster { scan: fine, times, weights, columns: scan.shape[1], rows: scan.shape[0] }
    }

    /// The scan that is simulated.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// Memory in bytes of the rows that are kept at a time, for patterns of `values` values at all thicknesses.
    pub fn held_bytes(&self, values: usize) -> u64 {
        ((self.weights[1].len() + 1) * self.columns * values * size_of::<f32>()) as u64
    }

    /// Starts collecting rows, before any row of the raster.
    pub fn rows(&self) -> SourceRows<'_> {
        SourceRows { raster: self, held: VecDeque::new(), next: 0 }
    }
}

impl SourceRows<'_> {
    /// Adds rows of the raster, and passes on the rows of the scan that they complete.
    pub fn push(
        &mut self,
        rows: &PatternRows<'_>,
        hand_on: &mut dyn FnMut(PatternRows<'_>) -> Result<()>,
    ) -> Result<()> {
        let (times, reach) = (self.raster.times[1], self.raster.weights[1].len());
        let [records, count, _, ny, nx] = *rows.data.shape() else { return Ok(()) };
        for r in 0..count {
            let row = rows.first_row + r;
            // The rows between two distant places are not needed.
            if self.next >= self.raster.rows || row < self.next * times {
                continue;
            }
            self.held.push_back((row, self.across(&rows.data, r)));
            if row + 1 < self.next * times + reach {
                continue;
            }
            let shape = (records, 1, self.raster.columns, ny, nx);
            let mut data = vec![0.0_f32; records * self.raster.columns * ny * nx];
            let (held, first) = (&self.held, self.next * times);
            data.par_chunks_mut(ny * nx).enumerate().for_each(|(n, out)| {
                for (row, values) in held.iter().filter(|(row, _)| *row >= first) {
                    let weight = self.raster.weights[1][row - first];
                    add(out, &values[n * out.len()..][..out.len()], weight);
                }
            });
            if let Ok(data) = Array5::from_shape_vec(shape, data) {
                hand_on(PatternRows { first_row: self.next, data: data.view() })?;
            }
            self.next += 1;
            self.held.retain(|(row, _)| *row >= self.next * times);
        }
        Ok(())
    }

    /// Sums a row of the raster along x at the columns of the scan.
    fn across(&self, data: &ArrayView5<'_, f32>, row: usize) -> Vec<f32> {
        let [records, _, _, ny, nx] = *data.shape() else { return Vec::new() };
        let columns = self.raster.columns;
        let mut sums = vec![0.0_f32; records * columns * ny * nx];
        sums.par_chunks_mut(ny * nx).enumerate().for_each(|(n, out)| {
            let (record, first) = (n / columns, n % columns * self.raster.times[0]);
            for (i, weight) in self.raster.weights[0].iter().enumerate() {
                let pattern = data.slice(ndarray::s![record, row, first + i, .., ..]);
                match pattern.as_slice() {
                    Some(pattern) => add(out, pattern, *weight),
                    None => out.iter_mut().zip(&pattern).for_each(|(to, v)| *to += weight * v),
                }
            }
        });
        sums
    }
}

fn add(out: &mut [f32], values: &[f32], weight: f32) {
    out.iter_mut().zip(values).for_each(|(to, v)| *to += weight * v);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A wave in the plane of the scan, damped by the Gaussian in closed form; rows come in bands of three.
    fn error(scan: &Scan, fwhm: f64, k: [f64; 2]) -> f64 {
        let raster = SourceRaster::new(Source::gaussian(fwhm), scan, 1.67);
        let fine = raster.scan();
        let wave = |[x, y]: [f64; 2], height: f64| {
            1.0 + height * (2.0 * PI * (k[0] * x + k[1] * y) + 0.3).cos()
        };
        let mut found = Vec::new();
        let mut rows = raster.rows();
        for first in (0..fine.shape[0]).step_by(3) {
            let count = 3.min(fine.shape[0] - first);
            let data = Array5::from_shape_fn((2, count, fine.shape[1], 1, 2), |(t, r, c, _, v)| {
                let at = fine.position((first + r) * fine.shape[1] + c);
                ((1 + t + v) as f64 * wave(at, 1.0)) as f32
            });
            let band = PatternRows { first_row: first, data: data.view() };
            let mut take = |rows: PatternRows<'_>| {
                assert_eq!((rows.first_row, rows.data.shape()[1]), (found.len(), 1));
                found.push(rows.data.to_owned());
                Ok(())
            };
            rows.push(&band, &mut take).unwrap();
        }
        assert_eq!(found.len(), scan.shape[0]);
        let sigma = fwhm / (8.0 * LN_2).sqrt();
        let damping = (-2.0 * (PI * sigma).powi(2) * (k[0] * k[0] + k[1] * k[1])).exp();
        let mut largest = 0.0_f64;
        for (y, row) in found.iter().enumerate() {
            for ((t, _, x, _, v), value) in row.indexed_iter() {
                let exact = wave(scan.position(y * scan.shape[1] + x), damping);
                largest = largest.max((f64::from(*value) / (1 + t + v) as f64 - exact).abs());
            }
        }
        largest
    }

    /// Tests up to the finest waves in patterns of a probe of 21 mrad at 200 kV.
    #[test]
    fn waves_are_damped_as_by_the_gaussian() {
        for step in [[0.1, 0.12], [0.3, 0.25], [0.9, 1.6], [4.0, 3.0]] {
            let scan = Scan { origin_angstrom: [3.0, 2.0], step_angstrom: step, shape: [4, 5] };
            for fwhm in [0.5, 0.8, 1.5] {
                for k in [[0.0, 0.0], [0.4, 0.2], [1.0, 0.6], [1.67, 0.0]] {
                    let off = error(&scan, fwhm, k);
                    assert!(off < 1e-3, "{step:?} {fwhm} {k:?}: {off}");
                }
            }
        }
    }
}
