//! How far the means of two fields differ by chance, where neighbouring parts of a field are not independent: a difference that
//! is the same everywhere is held against slow waves over the field.
//!
//! What varies from place to place over less than half a wave adds as much to each of the slow waves as to the mean. So the power of
//! the waves is the variance of the mean (U. K. Muller, Econometrica 72 (2004) 3055; E. Lazarus, D. Lewis, J. Stock and M. Watson,
//! J. Bus. Econ. Stat. 36 (2018) 541), and the mean in units of its root is distributed like Student's t. Single blocks
//! would tell too small an error where what they hold gathers over several of them. For the largest of several numbers, mean and waves
//! are turned into each other at random (O. Langsrud, Stat. Comput. 15 (2005) 53); of a single number that is the test by Student's t.

use super::statistics::{Ratio, share, student_two_sided};
use crate::rng::philox4x32_10;

/// Cosines over a field in places, that is rows and columns of blocks.
#[derive(Debug, Clone)]
pub struct FieldWaves {
    places: usize,
    /// Values of each wave at all places; their mean square is 1, their mean 0.
    waves: Vec<Vec<f64>>,
}

/// A difference of two means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanDifference {
    /// Its value.
    pub value: f64,
    /// In standard errors.
    pub t: f64,
    /// Probability of one at least as large between fields of one kind.
    pub p: f64,
}

impl FieldWaves {
    /// Waves over so many rows and columns of places: so many along y and along x, counting the one that is constant.
    pub fn new([rows, columns]: [usize; 2], [down, across]: [usize; 2]) -> Self {
        let wave = |m: usize, i: usize, n: usize| match m {
            0 => 1.0,
            _ => {
                let turn = std::f64::consts::PI * m as f64 * (i as f64 + 0.5) / n as f64;
                std::f64::consts::SQRT_2 * libm::cos(turn)
            }
        };
        let (down, across) = (down.min(rows), across.min(columns));
        let all = (0..down).flat_map(|k| (0..across).map(move |l| (k, l))).skip(1);
        let places = || (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x)));
        let of = |(k, l): (usize, usize)| {
            places().map(|(y, x)| wave(k, y, rows) * wave(l, x, columns)).collect()
        };
        FieldWaves { places: rows * columns, waves: all.map(of).collect() }
    }

    /// Number of places.
    pub fn places(&self) -> usize {
        self.places
    }

    /// Number of waves.
    pub fn count(&self) -> usize {
        self.waves.len()
    }

    /// The difference of two ratios of sums over the same places.
    pub fn difference(&self, a: &[(f64, f64)], b: &[(f64, f64)]) -> MeanDifference {
        let residuals = |blocks: &[(f64, f64)]| {
            let (top, bottom) = blocks.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
            let of = move |b: &(f64, f64)| (b.0 - top / bottom * b.1) / bottom;
            blocks.iter().map(of).collect::<Vec<f64>>()
        };
        let value = Ratio::of_blocks(a).value - Ratio::of_blocks(b).value;
        let differences: Vec<f64> =
            residuals(a).into_iter().zip(residuals(b)).map(|(a, b)| a - b).collect();
        let amplitude =
            |wave: &Vec<f64>| wave.iter().zip(&differences).map(|(w, d)| w * d).sum::<f64>();
        let power: f64 = self.waves.iter().map(|w| amplitude(w).powi(2)).sum();
        let t = match value {
            0.0 => 0.0,
            value => value / (power / self.count() as f64).sqrt(),
        };
        MeanDifference { value, t, p: student_two_sided(t, self.count()) }
    }

    /// The largest of several sums over all places, and the share of turns of sum and waves with one at least as large. `values`
    /// holds a row for each place.
    pub fn largest<R: AsRef<[f64]>>(&self, values: &[R]) -> (f64, f64) {
        let amplitudes = self.amplitudes(values);
        let largest = |sums: &[f64]| sums.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let found = largest(&amplitudes[0]);
        if found == 0.0 {
            return (0.0, 1.0);
        }
        let mut sums = vec![0.0; amplitudes[0].len()];
        let p = share(found, |n| {
            sums.fill(0.0);
            for (weight, row) in direction(amplitudes.len(), n).into_iter().zip(&amplitudes) {
                sums.iter_mut().zip(row).for_each(|(s, v)| *s += weight * v);
            }
            largest(&sums)
        });
        (found, p)
    }

    /// The same with each sum in standard errors.
    pub fn largest_in_errors(&self, values: &[Vec<f64>]) -> (f64, f64) {
        let amplitudes = self.amplitudes(values);
        let columns = amplitudes[0].len();
        let power = |c: usize| amplitudes.iter().map(|a| a[c] * a[c]).sum::<f64>();
        let scale: Vec<f64> = (0..columns).map(|c| 1.0 / power(c).sqrt()).collect();
        let scaled = |row: &Vec<f64>| -> Vec<f64> {
            let usable = row.iter().zip(&scale).filter(|(_, s)| s.is_finite());
            usable.map(|(v, s)| v * s).collect()
        };
        let (share_of_power, p) = self.largest(&values.iter().map(scaled).collect::<Vec<_>>());
        // What is a share of the power in sum and waves is this in errors told by the waves.
        let left = 1.0 - share_of_power * share_of_power;
        (share_of_power * (self.count() as f64 / left.max(f64::MIN_POSITIVE)).sqrt(), p)
    }

    /// Sums over all places, and with the weights of each wave.
    fn amplitudes<R: AsRef<[f64]>>(&self, values: &[R]) -> Vec<Vec<f64>> {
        let columns = values.first().map_or(0, |v| v.as_ref().len());
        let mut amplitudes = vec![vec![0.0; columns]; 1 + self.count()];
        for (place, row) in values.iter().enumerate() {
            for (i, sums) in amplitudes.iter_mut().enumerate() {
                let weight = if i == 0 { 1.0 } else { self.waves[i - 1][place] };
                sums.iter_mut().zip(row.as_ref()).for_each(|(s, v)| *s += weight * v);
            }
        }
        amplitudes
    }
}

/// A random direction in so many dimensions.
fn direction(dimensions: usize, number: u32) -> Vec<f64> {
    let unit = |word: u32| (f64::from(word) + 0.5) / 4_294_967_296.0;
    let pair = |i: u32| {
        let w = philox4x32_10([i, number, 2, 0], [0x5374_656d, 0x4b53]);
        let (radius, turn) = (libm::sqrt(-2.0 * libm::log(unit(w[0]))), unit(w[1]));
        let angle = 2.0 * std::f64::consts::PI * turn;
        [radius * libm::cos(angle), radius * libm::sin(angle)]
    };
    let mut normals: Vec<f64> = (0..dimensions.div_ceil(2) as u32).flat_map(pair).collect();
    normals.truncate(dimensions);
    let length = normals.iter().map(|v| v * v).sum::<f64>().sqrt();
    normals.iter_mut().for_each(|v| *v /= length);
    normals
}
