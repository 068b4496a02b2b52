//! Band-limited interpolation of images between their samples.
//!
//! As a function of the probe's position, the amplitude on every pixel of a detector holds no spatial frequency
//! above `semiangle / wavelength`, so its intensity, and with it every STEM image, none above twice that:
//! samples closer than `wavelength / (4 semiangle)` determine the image everywhere. The kernel is a sinc cut off by a
//! Kaiser window (J. F. Kaiser, R. W. Schafer, IEEE Trans. ASSP 28 (1980) 105).
//!
//! Positions are counted in samples: 0 is the centre of the first, 1.5 lies between the second and the third.
//! Results depend on the values and positions only, and are the same on every processor.

use crate::error::{Error, Result};
use crate::optics::Optics;
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Samples on either side of a position that its value depends on. Interpolated areas need as many samples
/// beyond their first and last ones, but for periodic images.
pub const HALF_WIDTH: usize = 8;
const TAPS: usize = 2 * HALF_WIDTH;
/// Steps of the tabulated kernel between two samples; linear interpolation between them is right to 2e-6.
const PHASES: usize = 512;
/// Step times band limit of the default: rms errors are then 0.03 % of the contrast (see [`Kernel`]).
const DEFAULT_PRODUCT: f64 = 0.42;
/// Largest step times band limit that is accepted: errors are 0.15 % there, and 0.5 is Nyquist's.
const MOST_PRODUCT: f64 = 0.475;
/// The kernel passes frequencies up to this share of the band limit best. Images hold little beyond, since
/// the transfer of a round aperture falls off towards its limit; chosen for the least rms error.
const PASSED: f64 = 0.77;

/// Highest spatial frequency, in 1/Angstrom, in STEM images: of any detector, thickness or defocus.
pub fn image_band_limit(optics: &Optics) -> f64 {
    2e-3 * optics.semiangle_mrad / optics.wavelength_angstrom()
}

/// What lies beyond the first and last samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// The image goes on from its other side.
    Periodic,
    /// The outermost samples go on. Values less than [`HALF_WIDTH`] samples from the edge are then
    /// approximate.
    Replicate,
}

/// An interpolation kernel, the same along rows and columns.
///
/// Rms errors in per cent of the standard deviation of the image, along one axis, for a white specimen seen through
/// an ideal round aperture (crystals have less near the limit), with [`HALF_WIDTH`] 8:
///
/// | step x band limit | 0.335 | 0.37 | 0.40 | 0.42 | 0.435 | 0.45 | 0.47 |
/// |---|---|---|---|---|---|---|---|
/// | step in A at 200 kV, 21 mrad | 0.20 | 0.22 | 0.24 | 0.25 | 0.26 | 0.27 | 0.28 |
/// | error, % | 0.001 | 0.005 | 0.014 | 0.028 | 0.045 | 0.07 | 0.13 |
#[derive(Debug, Clone)]
pub struct Kernel {
    /// Weights of the samples for each phase and for 1; each row adds to 1.
    table: Vec<[f64; TAPS]>,
}

/// The samples that make a value, and their weights, which add to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// Number of the first sample; may be negative or beyond the last.
    pub first: i64,
    /// Weights of the samples from there on.
    pub values: [f64; TAPS],
}

impl Kernel {
    /// The kernel for samples `step` apart (the larger one, where the axes differ) of an image without
    /// frequencies above `band_limit`, in the inverse unit.
    ///
    /// # Errors
    /// [`Error::Invalid`] for steps above 0.95 of the Nyquist distance `1 / (2 band_limit)`.
    pub fn new(step: f64, band_limit: f64) -> Result<Self> {
        let product = step * band_limit;
        if !(product > 0.0 && product <= MOST_PRODUCT) {
            let expected = format!(
                "must be above 0 and at most {:.4}: 0.95 of the Nyquist distance of the image",
                MOST_PRODUCT / band_limit
            );
            return Err(Error::invalid("step between samples (A)", step, expected));
        }
        let pi = std::f64::consts::PI;
        let lobe = 2.0 * pi * HALF_WIDTH as f64 * (0.5 - PASSED * product);
        let beta = (lobe * lobe - pi * pi).sqrt();
        let row = |phase: usize| {
            let fraction = phase as f64 / PHASES as f64;
            let mut row = [0.0; TAPS];
            for (i, weight) in row.iter_mut().enumerate() {
                let x = (i as f64 - (HALF_WIDTH - 1) as f64) - fraction;
                *weight = sinc(x) * kaiser(x / HALF_WIDTH as f64, beta);
            }
            let sum: f64 = row.iter().sum();
            row.map(|w| w / sum)
        };
        Ok(Kernel { table: (0..=PHASES).map(row).collect() })
    }

    /// The step that [`Kernel`] interpolates with an error of 0.03 % of the contrast.
    pub fn default_step(band_limit: f64) -> f64 {
        DEFAULT_PRODUCT / band_limit
    }

    /// Weights of the samples around `position`.
    pub fn weights(&self, position: f64) -> Weights {
        let below = position.floor();
        let at = (position - below) * PHASES as f64;
        let phase = (at as usize).min(PHASES - 1);
        let t = at - phase as f64;
        let (a, b) = (&self.table[phase], &self.table[phase + 1]);
        let mut values = [0.0; TAPS];
        for i in 0..TAPS {
            values[i] = a[i] + t * (b[i] - a[i]);
        }
        Weights { first: below as i64 - (HALF_WIDTH as i64 - 1), values }
    }

    /// The image at `position` (row, column).
    pub fn at<T: Copy + Into<f64>>(
        &self,
        image: ArrayView2<'_, T>,
        position: [f64; 2],
        edge: Edge,
    ) -> f64 {
        let (rows, columns) = image.dim();
        let (y, x) = (self.weights(position[0]), self.weights(position[1]));
        let inside = |w: &Weights, n: usize| w.first >= 0 && w.first as usize + TAPS <= n;
        if inside(&y, rows) && inside(&x, columns) {
            let (first_row, first_column) = (y.first as usize, x.first as usize);
            let line = |i: usize| {
                let value =
                    |j: usize| x.values[j] * image[[first_row + i, first_column + j]].into();
                (0..TAPS).map(value).sum::<f64>()
            };
            return (0..TAPS).map(|i| y.values[i] * line(i)).sum();
        }
        let line = |i: usize| {
            let row = sample(y.first + i as i64, rows, edge);
            let column = |j: usize| sample(x.first + j as i64, columns, edge);
            (0..TAPS).map(|j| x.values[j] * image[[row, column(j)]].into()).sum::<f64>()
        };
        (0..TAPS).map(|i| y.values[i] * line(i)).sum()
    }

    /// The image on another raster: `shape` (rows, columns) values at `first + i step`, both (row, column) in
    /// samples. The axes are resampled one after the other, which gives what [`Kernel::at`] gives but for
    /// rounding.
    pub fn raster<T: Copy + Into<f64> + Sync>(
        &self,
        image: ArrayView2<'_, T>,
        first: [f64; 2],
        step: [f64; 2],
        shape: [usize; 2],
        edge: Edge,
    ) -> Array2<f64> {
        let (rows, columns) = image.dim();
        let positions = |axis: usize, n: usize| -> Vec<[(usize, f64); TAPS]> {
            let place = |i: usize| {
                let w = self.weights(first[axis] + i as f64 * step[axis]);
                std::array::from_fn(|k| (sample(w.first + k as i64, n, edge), w.values[k]))
            };
            (0..shape[axis]).map(place).collect()
        };
        let along_x = positions(1, columns);
        let mut wide = Array2::<f64>::zeros((rows, shape[1]));
        let lines: Vec<_> = wide.outer_iter_mut().zip(image.outer_iter()).collect();
        lines.into_par_iter().for_each(|(mut to, from)| {
            for (to, taps) in to.iter_mut().zip(&along_x) {
                *to = taps.iter().map(|&(at, weight)| weight * from[at].into()).sum();
            }
        });
        let along_y = positions(0, rows);
        let mut out = Array2::<f64>::zeros((shape[0], shape[1]));
        let lines: Vec<_> = out.outer_iter_mut().zip(&along_y).collect();
        lines.into_par_iter().for_each(|(mut to, taps)| {
            for &(at, weight) in taps {
                to.scaled_add(weight, &wide.row(at));
            }
        });
        out
    }
}

fn sample(i: i64, n: usize, edge: Edge) -> usize {
    match edge {
        Edge::Periodic => i.rem_euclid(n as i64) as usize,
        Edge::Replicate => i.clamp(0, n as i64 - 1) as usize,
    }
}

fn sinc(x: f64) -> f64 {
    let a = std::f64::consts::PI * x;
    if a == 0.0 { 1.0 } else { libm::sin(a) / a }
}

/// The Kaiser window, up to a factor: 1 in the middle times I0(beta), 1 at +-1.
fn kaiser(x: f64, beta: f64) -> f64 {
    bessel_i0(beta * libm::sqrt((1.0 - x * x).max(0.0)))
}

/// The modified Bessel function I0, by its power series (Abramowitz and Stegun 9.6.12).
fn bessel_i0(x: f64) -> f64 {
    let quarter = 0.25 * x * x;
    let (mut term, mut sum) = (1.0, 1.0);
    for n in 1..200 {
        term *= quarter / f64::from(n * n);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const STEP: f64 = 0.25;

    fn band_limit() -> f64 {
        image_band_limit(&Optics::default())
    }

    /// Transfer of an ideal round aperture for incoherent light (Born and Wolf, sec. 9.5.2).
    fn transfer(k: f64) -> f64 {
        let q = (k / band_limit()).min(1.0);
        2.0 / std::f64::consts::PI * (q.acos() - q * (1.0 - q * q).sqrt())
    }

    /// Waves (kx, ky, amplitude, phase) of a periodic image of `edge` Angstrom within the band limit.
    fn waves(edge: f64) -> Vec<[f64; 4]> {
        let reach = (band_limit() * edge) as i64;
        let mut state = 1_u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1_u32 << 31)
        };
        let mut out = Vec::new();
        for ny in -reach..=reach {
            for nx in 0..=reach {
                let k = [nx as f64 / edge, ny as f64 / edge];
                out.push([k[0], k[1], transfer(k[0].hypot(k[1])), TAU * random()]);
            }
        }
        out
    }

    fn image(waves: &[[f64; 4]], x: f64, y: f64) -> f64 {
        let term = |w: &[f64; 4]| w[2] * (TAU * (w[0] * x + w[1] * y) + w[3]).cos();
        waves.iter().map(term).sum()
    }

    #[test]
    fn a_white_specimen_is_interpolated_to_a_thousandth_of_its_contrast() {
        let edge = 10.0;
        let n = (edge / STEP) as usize;
        let waves = waves(edge);
        let value = |i: usize, j: usize| image(&waves, j as f64 * STEP, i as f64 * STEP);
        let samples = Array2::from_shape_fn((n, n), |(i, j)| value(i, j));
        let kernel = Kernel::new(STEP, band_limit()).unwrap();
        let (mut error, mut contrast) = (0.0, 0.0);
        let mean = samples.mean().unwrap();
        for i in 0..600 {
            let at = [f64::from(i) * 0.0773 - 3.0, f64::from(i * i % 997) * 0.0519];
            let exact = image(&waves, at[1] * STEP, at[0] * STEP);
            error += (kernel.at(samples.view(), at, Edge::Periodic) - exact).powi(2);
            contrast += (exact - mean).powi(2);
        }
        let relative = (error / contrast).sqrt();
        // both axes: 0.063 % * sqrt(2), as documented; a cubic spline or a Lanczos kernel of this width misses it
        assert!(relative < 1.1e-3, "{relative}");
    }

    #[test]
    fn samples_and_constants_are_kept() {
        let kernel = Kernel::new(STEP, band_limit()).unwrap();
        let image = Array2::from_shape_fn((20, 30), |(i, j)| ((i * 7 + j * 13) % 11) as f32);
        let at = kernel.at(image.view(), [9.0, 14.0], Edge::Replicate);
        assert!((at - f64::from(image[[9, 14]])).abs() < 1e-12);
        let flat = Array2::from_elem((5, 7), 3.25_f32);
        for edge in [Edge::Periodic, Edge::Replicate] {
            for position in [[0.3, 0.9], [-11.2, 3.0], [4.999, 60.1]] {
                assert!((kernel.at(flat.view(), position, edge) - 3.25).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn rasters_are_what_points_are() {
        let kernel = Kernel::new(STEP, band_limit()).unwrap();
        let image = Array2::from_shape_fn((25, 19), |(i, j)| ((i * i + j * 5) % 17) as f32);
        let (first, step) = ([-2.3, 1.1], [0.71, 0.43]);
        for edge in [Edge::Periodic, Edge::Replicate] {
            let raster = kernel.raster(image.view(), first, step, [40, 50], edge);
            for ((i, j), value) in raster.indexed_iter() {
                let at = [first[0] + i as f64 * step[0], first[1] + j as f64 * step[1]];
                assert!((value - kernel.at(image.view(), at, edge)).abs() < 1e-10);
            }
        }
    }

    #[test]
    fn steps_near_nyquist_are_refused() {
        let nyquist = 0.5 / band_limit();
        assert!(Kernel::new(0.94 * nyquist, band_limit()).is_ok());
        for bad in [0.96 * nyquist, 0.0, -0.1, f64::NAN] {
            let message = Kernel::new(bad, band_limit()).unwrap_err().to_string();
            assert!(message.contains("0.28"), "{message}");
        }
        assert!((Kernel::default_step(band_limit()) - 0.2508).abs() < 1e-4);
    }

    #[test]
    fn the_bessel_function_is_that_of_the_tables() {
        // Abramowitz and Stegun, table 9.8
        assert!((bessel_i0(1.0) - 1.266_065_877_752_008_4).abs() < 1e-14);
        assert!((bessel_i0(5.0) - 27.239_871_823_604_442).abs() < 1e-12);
    }
}
