//! Converts intensities at the frequencies of a box, or of a window, to the pixels of a detector.

use super::super::padded_box::PaddedBox;
use crate::detect::PixelatedDetector;
use crate::fft::frequency;
use crate::matrix::multiply;
use std::f64::consts::PI;

/// Start of the taper, as a share of the longest lag. Between the frequencies of a box, intensities are interpolated by their Fourier
/// series, the autocorrelation of the exit wave. Without the taper on its lags, the edge of the bright field would ring through the dark
/// field.
const TAPER: f64 = 0.4;

/// Integrates intensities at frequencies over pixels: `P = D I A`.
pub(super) struct PixelMatrices {
    pixels: usize,
    /// Number of frequencies along x and y.
    samples: [usize; 2],
    /// (frequency along x, pixel)
    across: Vec<f32>,
    /// (pixel, frequency along y)
    down: Vec<f32>,
}

impl PixelMatrices {
    /// Matrices for the kept frequencies of a box, which interpolate by the series of lags.
    pub fn of_box(detector: &PixelatedDetector, wavelength: f64, padded: &PaddedBox) -> Self {
        let width = detector.pixel_k(wavelength);
        let (extent, points) = (padded.extent_angstrom(), padded.points());
        let frequencies = padded.reach.map(|n| (-(n as i64)..=n as i64).collect());
        let weight = |k: usize, pixel: f64, frequency: i64| {
            let (half, step) = (points[k] as i64 / 2, extent[k] / points[k] as f64);
            let offset = pixel - frequency as f64 / extent[k];
            let term = |lag: i64| {
                let (r, share) = (lag as f64 * step, lag as f64 / half as f64);
                let taper = match (share - TAPER) / (1.0 - TAPER) {
                    rest if rest <= 0.0 => 1.0,
                    rest => (0.5 * PI * rest).cos().powi(2),
                };
                taper * sinc(width * r) * (2.0 * PI * offset * r).cos()
            };
            let sum: f64 = (1..half).map(term).sum();
            width * extent[k] / points[k] as f64 * (1.0 + 2.0 * sum)
        };
        Self::new((detector, wavelength), frequencies, weight)
    }

    /// Matrices for all frequencies of a window with `points` over `extent` (x, y; Angstrom), each distributed over pixels by area.
    pub fn by_area(
        detector: &PixelatedDetector,
        wavelength: f64,
        (points, extent): ([usize; 2], [f64; 2]),
    ) -> Self {
        let width = detector.pixel_k(wavelength);
        let frequencies = points.map(|n| (0..n).map(|i| frequency(i, n)).collect());
        let weight = |k: usize, pixel: f64, frequency: i64| {
            let (at, dk) = (frequency as f64 / extent[k], 1.0 / extent[k]);
            overlap([pixel, width], [at, dk]) / dk
        };
        Self::new((detector, wavelength), frequencies, weight)
    }

    /// Makes the matrices for frequencies along x and y. `weight(axis, pixel, frequency)` gets the middle of a pixel in 1/Angstrom.
    fn new(
        (detector, wavelength): (&PixelatedDetector, f64),
        [x, y]: [Vec<i64>; 2],
        weight: impl Fn(usize, f64, i64) -> f64,
    ) -> Self {
        let middles: Vec<f64> = (0..detector.pixels).map(|i| detector.k(i, wavelength)).collect();
        let mut across = Vec::with_capacity(middles.len() * x.len());
        for f in &x {
            across.extend(middles.iter().map(|pixel| weight(0, *pixel, *f) as f32));
        }
        let mut down = Vec::with_capacity(middles.len() * y.len());
        for pixel in &middles {
            down.extend(y.iter().map(|f| weight(1, *pixel, *f) as f32));
        }
        PixelMatrices { pixels: detector.pixels, samples: [x.len(), y.len()], across, down }
    }

    /// Computes a pattern, row-major, from intensities (frequency along y, along x) row-major. `half` is work space.
    pub fn pattern(&self, intensities: &[f32], half: &mut Vec<f32>, out: &mut [f32]) {
        let (n, [x, y]) = (self.pixels, self.samples);
        half.resize(y * n, 0.0);
        multiply((y, n, x), (half, n), (intensities, [x, 1]), (&self.across, n));
        multiply((n, n, y), (out, n), (&self.down, [y, 1]), (half, n));
    }
}

/// The overlap of two intervals, given by middle and width.
fn overlap([a, width]: [f64; 2], [b, other]: [f64; 2]) -> f64 {
    let low = (a - 0.5 * width).max(b - 0.5 * other);
    let high = (a + 0.5 * width).min(b + 0.5 * other);
    (high - low).max(0.0)
}

fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-12 { 1.0 } else { (PI * x).sin() / (PI * x) }
}
