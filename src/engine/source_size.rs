//! The size of the electron source: images blurred by a Gaussian.
//!
//! An incoherent image is the convolution of that of a point source with the intensity of the source, demagnified to
//! the specimen. Images of a scan are band-limited, so the convolution is exact as a product in Fourier space. A scan over
//! the whole periodic cell is periodic itself; any other is made with a margin, which is cut off afterwards.

use std::f64::consts::{LN_2, PI};

use ndarray::{Array2, ArrayView2, Axis, s};

use super::probe_scan::Scan;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// What of the source may lie beyond the margin, at any distance, of its whole.
const BEYOND_MARGIN: f64 = 5e-5;
/// Largest source in Angstrom.
const LARGEST_ANGSTROM: f64 = 10.0;
/// A scan ends where the cell does if it does so to this part of a step.
const WHOLE: f64 = 1e-6;
/// Lengths in pixels at which the margin is sought.
const LONGEST_MARGIN: usize = 400;

/// A scan whose images are blurred by the source.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceBlur {
    /// Standard deviation in Angstrom.
    sigma: f64,
    /// The scan with its margin.
    wide: Scan,
    /// Pixels of margin along x and y.
    margin: [usize; 2],
}

impl SourceBlur {
    /// For a source of this full width at half maximum, and a scan in a periodic cell (x, y).
    ///
    /// # Errors
    /// [`Error::Invalid`] for a width that no source has.
    pub fn new(fwhm_angstrom: f64, scan: &Scan, cell_angstrom: [f64; 2]) -> Result<Self> {
        if !(fwhm_angstrom > 0.0 && fwhm_angstrom <= LARGEST_ANGSTROM) {
            let expected = format!("must be above 0 and at most {LARGEST_ANGSTROM}");
            return Err(Error::invalid(Setting::SourceSizeAngstrom, fwhm_angstrom, expected));
        }
        let sigma = fwhm_angstrom / (8.0 * LN_2).sqrt();
        let margin = [0, 1].map(|k| {
            let step = scan.step_angstrom[k];
            let off = scan.shape[1 - k] as f64 * step - cell_angstrom[k];
            if off.abs() < WHOLE * step { 0 } else { reach(sigma / step) }
        });
        let start = |k: usize| scan.origin_angstrom[k] - margin[k] as f64 * scan.step_angstrom[k];
        let wide = Scan {
            origin_angstrom: [start(0), start(1)],
            step_angstrom: scan.step_angstrom,
            shape: [scan.shape[0] + 2 * margin[1], scan.shape[1] + 2 * margin[0]],
        };
        Ok(SourceBlur { sigma, wide, margin })
    }

    /// The scan that has to be simulated.
    pub fn scan(&self) -> &Scan {
        &self.wide
    }

    /// The blurred image, [row = y, column = x], without margin, from that of the wide scan for a point source.
    pub fn image(&self, image: ArrayView2<'_, f32>) -> Array2<f32> {
        let mut data = image.mapv(f64::from);
        for (k, axis) in [(0, Axis(1)), (1, Axis(0))] {
            let kernel = kernel(self.sigma / self.wide.step_angstrom[k], data.len_of(axis));
            let n = kernel.len();
            for mut lane in data.lanes_mut(axis) {
                let line = lane.to_vec();
                for (i, value) in lane.iter_mut().enumerate() {
                    let sum = |j: usize| line[j] * kernel[(i + n - j) % n];
                    *value = (0..n).map(sum).sum();
                }
            }
        }
        let [x, y] = self.margin;
        let (rows, columns) = data.dim();
        data.slice(s![y..rows - y, x..columns - x]).mapv(|v| v as f32)
    }
}

/// The Gaussian of `sigma` pixels as a band-limited periodic kernel of `n` pixels.
fn kernel(sigma: f64, n: usize) -> Vec<f64> {
    let transfer = |k: usize| {
        let f = k.min(n - k) as f64 / n as f64;
        libm::exp(-2.0 * (PI * sigma * f).powi(2))
    };
    let turn = 2.0 * PI / n as f64;
    let value = |i: usize| {
        let wave = |k: usize| transfer(k) * libm::cos(turn * ((i * k) % n) as f64);
        (0..n).map(wave).sum::<f64>() / n as f64
    };
    (0..n).map(value).collect()
}

/// Pixels beyond which the kernel is nothing.
fn reach(sigma: f64) -> usize {
    let far = kernel(sigma, 2 * LONGEST_MARGIN);
    let beyond = (1..LONGEST_MARGIN).rev().find(|i| far[*i].abs() > BEYOND_MARGIN);
    beyond.map_or(1, |last| last + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELL: [f64; 2] = [12.0, 9.6];

    /// Waves of the cell up to the Nyquist limit of a step of 0.3 A, blurred by a Gaussian of `sigma`, in closed form.
    fn image(scan: &Scan, sigma: f64) -> Array2<f32> {
        let waves =
            [(0, 0, 3.0), (1, 0, 1.0), (3, 2, 0.7), (11, 5, 0.4), (17, 0, 0.3), (0, 14, 0.2)];
        Array2::from_shape_fn((scan.shape[0], scan.shape[1]), |(i, j)| {
            let [x, y] = scan.position(i * scan.shape[1] + j);
            let wave = |(a, b, height): (i32, i32, f64)| {
                let k = [f64::from(a) / CELL[0], f64::from(b) / CELL[1]];
                let damping = (-2.0 * (PI * sigma).powi(2) * (k[0] * k[0] + k[1] * k[1])).exp();
                height * damping * (2.0 * PI * (k[0] * x + k[1] * y) + 0.4).cos()
            };
            waves.into_iter().map(wave).sum::<f64>() as f32
        })
    }

    fn error(fwhm: f64, scan: &Scan) -> f32 {
        let blur = SourceBlur::new(fwhm, scan, CELL).unwrap();
        let blurred = blur.image(image(blur.scan(), 0.0).view());
        let exact = image(scan, fwhm / (8.0 * LN_2).sqrt());
        assert_eq!(blurred.dim(), exact.dim());
        blurred.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn a_scan_of_the_cell_is_blurred_exactly_and_has_no_margin() {
        let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom: [0.3, 0.3], shape: [32, 40] };
        assert_eq!(SourceBlur::new(0.8, &scan, CELL).unwrap().scan(), &scan);
        for fwhm in [0.1, 0.8, 2.0] {
            assert!(error(fwhm, &scan) < 2e-6, "{fwhm}: {}", error(fwhm, &scan));
        }
    }

    #[test]
    fn a_part_of_the_cell_is_blurred_as_if_it_went_on() {
        let part = Scan { origin_angstrom: [2.0, 1.0], step_angstrom: [0.25, 0.3], shape: [7, 9] };
        for fwhm in [0.5, 0.8, 2.0] {
            assert!(error(fwhm, &part) < 3e-4, "{fwhm}: {}", error(fwhm, &part));
        }
        let margin = SourceBlur::new(0.8, &part, CELL).unwrap().margin;
        assert!(margin[0] >= 4 && margin[0] < 16, "{margin:?}");
        assert!(SourceBlur::new(-1.0, &part, CELL).is_err());
    }
}
