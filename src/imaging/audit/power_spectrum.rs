//! The power spectrum of audited images, compared with the exact ones.

use ndarray::{Array2, Axis};
use num_complex::Complex;
use serde::{Deserialize, Serialize};

/// Bands of the power spectrum, in 1/Angstrom.
const BANDS: [f64; 4] = [0.1, 0.4, 0.8, 1.2];

/// A band of the power spectrum.
#[derive(Debug, Clone, Serialize, Deserialize, PartialEq)]
#[non_exhaustive]
pub struct PowerBand {
    /// Limits in 1/Angstrom.
    pub band: [f64; 2],
    /// Power of the audited image over the power of the exact one.
    pub ratio: f64,
}

/// Power of the audited images over the power of the exact ones, by bands of spatial frequency, under a Hann window. Each region has both
/// images, [row, column], with a distance of `step` Angstrom between pixels.
pub(crate) fn power(regions: &[[&Array2<f64>; 2]], step: f64) -> Vec<PowerBand> {
    let mut sums = vec![[0.0; 2]; BANDS.len() - 1];
    for region in regions {
        for (which, image) in region.iter().enumerate() {
            let (rows, columns) = image.dim();
            let mean = image.mean().unwrap_or(0.0);
            let hann = |i: usize, n: usize| {
                (std::f64::consts::PI * (i as f64 + 0.5) / n as f64).sin().powi(2)
            };
            let windowed = Array2::from_shape_fn((rows, columns), |(i, j)| {
                Complex::from((image[[i, j]] - mean) * hann(i, rows) * hann(j, columns))
            });
            for ((i, j), value) in transformed(windowed).indexed_iter() {
                let k = |i: usize, n: usize| crate::fft::frequency(i, n) as f64 / (n as f64 * step);
                let k = k(i, rows).hypot(k(j, columns));
                if let Some(band) = BANDS.windows(2).position(|b| b[0] <= k && k < b[1]) {
                    sums[band][which] += value.norm_sqr();
                }
            }
        }
    }
    let band = |(n, [ours, exact]): (usize, &[f64; 2])| PowerBand {
        band: [BANDS[n], BANDS[n + 1]],
        ratio: if *exact > 0.0 { ours / exact } else { f64::NAN },
    };
    sums.iter().enumerate().map(band).collect()
}

fn transformed(mut image: Array2<Complex<f64>>) -> Array2<Complex<f64>> {
    let mut planner = rustfft::FftPlanner::new();
    for axis in [1, 0] {
        let fft = planner.plan_fft_forward(image.len_of(Axis(axis)));
        for mut lane in image.lanes_mut(Axis(axis)) {
            let mut line = lane.to_vec();
            fft.process(&mut line);
            lane.iter_mut().zip(line).for_each(|(to, from)| *to = from);
        }
    }
    image
}
