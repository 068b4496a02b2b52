//! The mean image of a library cell on a dense grid, for pictures that need many values and little accuracy.

use ndarray::{Array2, ArrayView1, Axis};

use crate::resample::{Kernel, TAPS, Weights};

/// Places on the dense grid for each sample of the image. Values between them are interpolated linearly.
const DENSER: usize = 3;

/// The mean of a library cell's images over their configurations, at places that lie dense enough for linear interpolation.
///
/// Against the kernel's interpolation, overviews (the mean over 3 x 3 places in 1.6 A) differ by 0.2 to 0.4 % of the mean, rms (hard worlds).
pub(super) struct DenseMean {
    values: Array2<f32>,
    /// Whether rows (y) and columns (x) repeat.
    periodic: [bool; 2],
}

impl DenseMean {
    /// Interpolates samples, [row, column] = [y, x], along both axes; `periodic` is for (y, x).
    pub fn new(samples: &Array2<f32>, periodic: [bool; 2], kernel: &Kernel) -> Self {
        let along = |image: &Array2<f32>, axis: usize| {
            let mut shape = [image.nrows(), image.ncols()];
            shape[axis] *= DENSER;
            let mut dense = Array2::zeros(shape);
            let lines = image.lanes(Axis(axis)).into_iter().zip(dense.lanes_mut(Axis(axis)));
            for (line, mut to) in lines {
                for (n, value) in to.iter_mut().enumerate() {
                    let at = n as f64 / DENSER as f64;
                    *value = between(line, at, periodic[axis], kernel);
                }
            }
            dense
        };
        DenseMean { values: along(&along(samples, 0), 1), periodic }
    }

    /// The value at a place (x, y) in samples.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        let axis = |k: usize| {
            let n = self.values.len_of(Axis(k));
            let at = place[1 - k] * DENSER as f64;
            let at = match self.periodic[k] {
                true => at.rem_euclid(n as f64),
                false => at.clamp(0.0, n as f64 - 1.0),
            };
            let first = (at as usize).min(n - 1);
            let second = if first + 1 < n { first + 1 } else { 0 };
            (first, second, at - first as f64)
        };
        let ((row, next_row, down), (column, next, across)) = (axis(0), axis(1));
        let line = |row: usize| {
            let [a, b] = [column, next].map(|c| f64::from(self.values[[row, c]]));
            a + across * (b - a)
        };
        let (a, b) = (line(row), line(next_row));
        a + down * (b - a)
    }
}

/// The value at a place, in samples, along a line of samples.
fn between(line: ArrayView1<f32>, at: f64, periodic: bool, kernel: &Kernel) -> f32 {
    let n = line.len();
    let Weights { first, values } = kernel.weights_on((n, periodic), at);
    let sample = |k: usize| f64::from(line[(first + k as i64).rem_euclid(n as i64) as usize]);
    (0..TAPS).map(|k| values[k] * sample(k)).sum::<f64>() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A wave of half the band limit, on samples at the Nyquist distance: linear interpolation at a third of a sample errs by 3 % at most.
    #[test]
    fn values_are_those_of_the_wave_along_both_kinds_of_axes() {
        let n = 24;
        let wave =
            |[x, y]: [f64; 2]| (TAU * x * 6.0 / n as f64).cos() + (TAU * y * 4.0 / n as f64).sin();
        let samples = Array2::from_shape_fn((n, n), |(y, x)| wave([x as f64, y as f64]) as f32);
        let kernel = Kernel::new(1.0, 0.45).unwrap();
        for periodic in [[true, true], [true, false], [false, true]] {
            let mean = DenseMean::new(&samples, periodic, &kernel);
            let place = |k: usize, at: f64| if periodic[k] { at - 7.0 } else { at };
            for k in 0..200 {
                let at = [4.0 + 0.073 * k as f64, 18.4 - 0.067 * k as f64];
                let off = mean.at([place(1, at[0]), place(0, at[1])])
                    - wave([place(1, at[0]), place(0, at[1])]);
                assert!(off.abs() < 0.06, "{periodic:?} {at:?}: {off}");
            }
        }
        // Samples themselves are kept.
        let mean = DenseMean::new(&samples, [true, true], &kernel);
        assert!((mean.at([5.0, 9.0]) - wave([5.0, 9.0])).abs() < 1e-3);
    }
}
