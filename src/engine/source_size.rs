//! The size of the electron source: images blurred by its intensity.
//!
//! An incoherent image is the convolution of the image of a point source with the intensity of the source, demagnified to the specimen.
//! Images of a scan are band-limited, so the convolution is exact as a product in Fourier space. A scan over the whole periodic cell is
//! periodic too. Any other scan is made with a margin, which is cut off afterwards.
//!
//! The source is a Gaussian, of which a share may be replaced by long tails: `(1 + r^2 / g^2)^(-3/2)`, the Lorentz profile in two
//! dimensions (its projection onto a line is a Lorentzian), with equal full width at half maximum.

use std::f64::consts::{LN_2, PI};

use ndarray::{Array2, ArrayView2, Axis, s};
use num_complex::Complex32;
use serde::{Deserialize, Serialize};

use super::probe_scan::Scan;
use crate::error::{Error, Result};
use crate::fft::{Fft2, frequency};
use crate::setting::Setting;

/// Largest value of the normalised kernel at any pixel beyond the margin.
const BEYOND_MARGIN: f64 = 5e-5;
/// Largest source in Angstrom.
const LARGEST_ANGSTROM: f64 = 10.0;
/// A scan ends at the edge of the cell if the difference is below this part of a step.
const WHOLE: f64 = 1e-6;
/// Largest margin in pixels.
const LONGEST_MARGIN: usize = 400;
/// Lorentz tails end at this number of full widths from the middle. They fall to zero over the last half of the way and have integral 1.
/// An infinite tail would have 8 % of its intensity further out; images cannot distinguish this from a larger share of the Gaussian.
const TAIL_WIDTHS: f64 = 5.0;
/// Number of points of the integral over a tail, and of its transfer function.
const TAIL_POINTS: usize = 800;

/// An electron source, demagnified to the specimen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Full width at half maximum in Angstrom.
    pub fwhm_angstrom: f64,
    /// Share of the Lorentz profile, from 0 to 1; the rest is a Gaussian.
    pub lorentz_share: f64,
}

/// A scan whose images are blurred by the source.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SourceBlur {
    source: Source,
    /// Standard deviation of the Gaussian in Angstrom.
    sigma: f64,
    /// The scan with its margin.
    wide: Scan,
    /// Pixels of margin along x and y.
    margin: [usize; 2],
}

impl Source {
    /// A Gaussian source.
    pub(crate) fn gaussian(fwhm_angstrom: f64) -> Self {
        Source { fwhm_angstrom, lorentz_share: 0.0 }
    }

    /// Checks the ranges of width and share.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the range.
    pub(crate) fn validate(&self) -> Result<()> {
        let fwhm = self.fwhm_angstrom;
        if !(fwhm > 0.0 && fwhm <= LARGEST_ANGSTROM) {
            let expected = format!("must be above 0 and at most {LARGEST_ANGSTROM}");
            return Err(Error::invalid(Setting::SourceSizeAngstrom, fwhm, expected));
        }
        if !(0.0..=1.0).contains(&self.lorentz_share) {
            let expected = "must be from 0 to 1";
            return Err(Error::invalid(Setting::SourceLorentzShare, self.lorentz_share, expected));
        }
        Ok(())
    }

    /// Distance in pixels of `step` Angstrom beyond which the source has no intensity.
    fn reach(&self, step: f64) -> usize {
        let gaussian = reach(self.fwhm_angstrom / (8.0 * LN_2).sqrt() / step);
        if self.lorentz_share == 0.0 {
            return gaussian;
        }
        gaussian.max((TAIL_WIDTHS * self.fwhm_angstrom / step).ceil() as usize + 1)
    }

    /// The Lorentz profile's transfer function at even steps from 0 to `highest` (1/Angstrom).
    fn tail_transfer(&self, highest: f64) -> Vec<f64> {
        let end = TAIL_WIDTHS * self.fwhm_angstrom;
        let width = 0.5 * self.fwhm_angstrom / (2.0_f64.powf(2.0 / 3.0) - 1.0).sqrt();
        let step = end / TAIL_POINTS as f64;
        // The trapezoidal rule is accurate: the integrand is even, and flat at its end.
        let ring = |i: usize| {
            let r = i as f64 * step;
            let beyond = (2.0 * r / end - 1.0).max(0.0);
            let fall = 0.5 * (1.0 + libm::cos(PI * beyond));
            (r, r * fall * (1.0 + (r / width).powi(2)).powf(-1.5))
        };
        let rings: Vec<(f64, f64)> = (1..TAIL_POINTS).map(ring).collect();
        let all: f64 = rings.iter().map(|r| r.1).sum();
        let value = |i: usize| {
            let k = highest * i as f64 / TAIL_POINTS as f64;
            rings.iter().map(|(r, part)| part * libm::j0(2.0 * PI * k * r)).sum::<f64>() / all
        };
        (0..=TAIL_POINTS + 1).map(value).collect()
    }
}

impl SourceBlur {
    /// Prepares the blur for a source and a scan in a periodic cell (x, y).
    ///
    /// # Errors
    /// Errors of [`Source::validate`].
    pub(crate) fn new(source: Source, scan: &Scan, cell_angstrom: [f64; 2]) -> Result<Self> {
        source.validate()?;
        let margin = [0, 1].map(|k| {
            let step = scan.step_angstrom[k];
            let off = scan.shape[1 - k] as f64 * step - cell_angstrom[k];
            if off.abs() < WHOLE * step { 0 } else { source.reach(step) }
        });
        let start = |k: usize| scan.origin_angstrom[k] - margin[k] as f64 * scan.step_angstrom[k];
        let wide = Scan {
            origin_angstrom: [start(0), start(1)],
            step_angstrom: scan.step_angstrom,
            shape: [scan.shape[0] + 2 * margin[1], scan.shape[1] + 2 * margin[0]],
        };
        let sigma = source.fwhm_angstrom / (8.0 * LN_2).sqrt();
        Ok(SourceBlur { source, sigma, wide, margin })
    }

    /// The scan that has to be simulated.
    pub(crate) fn scan(&self) -> &Scan {
        &self.wide
    }

    /// Pixels of margin along x and y on either side.
    pub(crate) fn margin(&self) -> [usize; 2] {
        self.margin
    }

    /// Blurs the image of the wide scan for a point source and cuts off the margin. The result is [row = y, column = x].
    pub(crate) fn image(&self, image: ArrayView2<'_, f32>) -> Array2<f32> {
        self.blurred(image.mapv(f64::from)).mapv(|v| v as f32)
    }

    /// Blurs an image as [`SourceBlur::image`] does, in double precision.
    pub(crate) fn blurred(&self, sharp: Array2<f64>) -> Array2<f64> {
        let tails = (self.source.lorentz_share > 0.0).then(|| self.tails(&sharp));
        let mut data = sharp;
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
        if let Some(tails) = tails {
            let share = self.source.lorentz_share;
            data.zip_mut_with(&tails, |v, t| *v += share * (t - *v));
        }
        let [x, y] = self.margin;
        let (rows, columns) = data.dim();
        data.slice_move(s![y..rows - y, x..columns - x])
    }

    /// The image blurred by the Lorentz profile only, with its margin.
    fn tails(&self, sharp: &Array2<f64>) -> Array2<f64> {
        let (ny, nx) = sharp.dim();
        let [dx, dy] = self.wide.step_angstrom;
        let k = |i: usize, n: usize, step: f64| frequency(i, n) as f64 / (n as f64 * step);
        let highest = (0.5 / dx).hypot(0.5 / dy);
        let table = self.source.tail_transfer(highest);
        let fft = Fft2::new(ny, nx);
        let (mut wave, mut scratch) = (fft.buffer(), fft.scratch());
        for ((y, x), v) in sharp.indexed_iter() {
            wave[y * fft.stride() + x] = Complex32::new(*v as f32, 0.0);
        }
        fft.forward(&mut wave, &mut scratch);
        for y in 0..ny {
            for x in 0..nx {
                let at = k(x, nx, dx).hypot(k(y, ny, dy)) / highest * TAIL_POINTS as f64;
                let (i, t) = ((at as usize).min(TAIL_POINTS), at.fract());
                let transfer = table[i] * (1.0 - t) + table[i + 1] * t;
                wave[y * fft.stride() + x] *= (transfer / (nx * ny) as f64) as f32;
            }
        }
        fft.inverse(&mut wave, &mut scratch);
        Array2::from_shape_fn((ny, nx), |(y, x)| f64::from(wave[y * fft.stride() + x].re))
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

/// Distance in pixels beyond which the kernel is zero.
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
        let blur = SourceBlur::new(Source::gaussian(fwhm), scan, CELL).unwrap();
        let blurred = blur.image(image(blur.scan(), 0.0).view());
        let exact = image(scan, fwhm / (8.0 * LN_2).sqrt());
        assert_eq!(blurred.dim(), exact.dim());
        blurred.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn a_scan_of_the_cell_is_blurred_exactly_and_has_no_margin() {
        let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom: [0.3, 0.3], shape: [32, 40] };
        assert_eq!(SourceBlur::new(Source::gaussian(0.8), &scan, CELL).unwrap().scan(), &scan);
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
        let margin = SourceBlur::new(Source::gaussian(0.8), &part, CELL).unwrap().margin;
        assert!(margin[0] >= 4 && margin[0] < 16, "{margin:?}");
        for bad in [-1.0, 0.0, 11.0, f64::NAN] {
            assert!(SourceBlur::new(Source::gaussian(bad), &part, CELL).is_err());
        }
        let share = Source { fwhm_angstrom: 0.8, lorentz_share: 1.5 };
        assert!(SourceBlur::new(share, &part, CELL).is_err());
    }

    /// A wave of the cell is damped by the transform of the profile, which has a closed form for infinite tails: `exp(-2 pi g k)`.
    #[test]
    fn lorentz_tails_damp_as_their_transform() {
        let fwhm_angstrom = 0.8;
        let source = Source { fwhm_angstrom, lorentz_share: 1.0 };
        let g = 0.5 * fwhm_angstrom / (2.0_f64.powf(2.0 / 3.0) - 1.0).sqrt();
        let table = source.tail_transfer(2.0);
        assert!((table[0] - 1.0).abs() < 1e-12);
        for (i, value) in table.iter().enumerate().skip(TAIL_POINTS / 4) {
            let k = 2.0 * i as f64 / TAIL_POINTS as f64;
            // The end of the tails removes a contribution as wide as a disk of 9 A, which is seen at k = 0 only.
            let expected = libm::exp(-2.0 * PI * g * k);
            assert!(
                (value - expected * table_norm(&source)).abs() < 4e-3,
                "{k}: {value} {expected}"
            );
        }
    }

    /// The integral of the infinite profile over its integral within the end.
    fn table_norm(source: &Source) -> f64 {
        let g = 0.5 * source.fwhm_angstrom / (2.0_f64.powf(2.0 / 3.0) - 1.0).sqrt();
        let end = 0.75 * TAIL_WIDTHS * source.fwhm_angstrom;
        1.0 / (1.0 - 1.0 / (1.0 + (end / g).powi(2)).sqrt())
    }

    /// With its margin, a part of the cell looks as in an image of the whole cell.
    #[test]
    fn tails_do_not_wrap() {
        let source = Source { fwhm_angstrom: 0.8, lorentz_share: 0.3 };
        let step_angstrom = [0.3, 0.3];
        let all = Scan { origin_angstrom: [0.0; 2], step_angstrom, shape: [32, 40] };
        let part = Scan { origin_angstrom: [3.0, 2.4], step_angstrom, shape: [7, 9] };
        let made = |scan: &Scan| {
            let blur = SourceBlur::new(source, scan, CELL).unwrap();
            blur.image(image(blur.scan(), 0.0).view())
        };
        let (all, part) = (made(&all), made(&part));
        for ((y, x), v) in part.indexed_iter() {
            assert!((v - all[[y + 8, x + 10]]).abs() < 1e-3, "{y} {x}: {v}");
        }
    }
}
