//! Band-limited interpolation of images between their samples.
//!
//! Samples closer than `wavelength / (4 semiangle)` determine a STEM image everywhere. As a function of the probe's position, the amplitude
//! on every pixel of a detector has no spatial frequency above `semiangle / wavelength`, so its intensity has no frequency above twice this
//! limit. Frequencies near this limit are weak, since the transfer function of an aperture for incoherent light falls to zero there. The
//! weights of the 16 samples around a position have the least mean square error for images with such a spectrum (simple kriging; N. Wiener,
//! Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949). The position need not be in their middle, so an image can
//! be interpolated up to a few samples from its edge.
//!
//! Positions are counted in samples: 0 is the centre of the first, 1.5 lies between the second and the third. Results are functions of
//! values and positions alone, identical on every processor.

use crate::error::{Error, Result};
use crate::optics::Optics;
use crate::setting::Setting;
use crate::simd::vectorised;
use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// Number of samples, along each axis, from which a value is interpolated.
pub(crate) const TAPS: usize = 16;
/// Number of these samples on either side of a position far from edges.
pub(crate) const HALF_WIDTH: usize = TAPS / 2;
/// Number of samples that an image that is not periodic should have beyond the first and the last position.
pub(crate) const MARGIN: usize = 3;
/// Steps of the tabulated kernel between two samples. Linear interpolation between them has an error of 2e-6.
const PHASES: usize = 512;
/// Step times band limit of the default (see [`Kernel`]).
const DEFAULT_PRODUCT: f64 = 0.47;
/// Largest accepted step times band limit: the Nyquist limit.
const MOST_PRODUCT: f64 = 0.5;
/// Assumed variance of noise in the samples, in units of the variance of the image. The noise of rounding to single precision is smaller;
/// this value keeps the equations well conditioned.
const NOISE: f64 = 1e-7;

/// The highest spatial frequency in STEM images, in 1/Angstrom, for any detector, thickness and defocus.
pub(crate) fn image_band_limit(optics: &Optics) -> f64 {
    2e-3 * optics.semiangle_mrad / optics.wavelength_angstrom()
}

/// The Nyquist distance in Angstrom: samples at most this far apart determine an image with this band limit (1/Angstrom).
pub(crate) fn nyquist_step(band_limit: f64) -> f64 {
    MOST_PRODUCT / band_limit
}

/// The samples from which values between the positions `low` and `high` are interpolated: the samples within [`HALF_WIDTH`] on either side,
/// out of `all`, and at least [`TAPS`] if there are enough.
pub(crate) fn samples_around([low, high]: [f64; 2], all: Range<usize>) -> Range<usize> {
    let within = |at: f64| at.clamp(all.start as f64, (all.end as f64 - 1.0).max(all.start as f64));
    let first = (within(low).floor() as usize).saturating_sub(HALF_WIDTH).max(all.start);
    let end = (within(high).ceil() as usize + HALF_WIDTH + 1).min(all.end);
    let end = end.max((first + TAPS).min(all.end));
    first.min(end.saturating_sub(TAPS).max(all.start))..end
}

/// The image beyond the first and last samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Edge {
    /// The image continues from its other side.
    Periodic,
    /// The image is unknown. Values less than [`MARGIN`] samples from the edge are less accurate; positions outside are moved to the edge.
    Open,
}

/// An interpolation kernel for rows and columns.
///
/// Rms errors in per cent of the standard deviation of the image, along both axes, for HAADF images of one phonon configuration
/// (SrTiO3 and Si \[110\] of 4-8 nm, Pt \[110\] of 5.5 nm), in the interior and at positions with [`MARGIN`] samples beyond on one side:
///
/// | step x band limit | 0.42 | 0.45 | 0.47 | 0.48 | 0.49 | 0.50 |
/// |---|---|---|---|---|---|---|
/// | step in A at 200 kV, 21 mrad | 0.251 | 0.269 | 0.281 | 0.287 | 0.293 | 0.299 |
/// | error, % | 0.006-0.011 | 0.02-0.04 | 0.05-0.08 | 0.06-0.12 | 0.10-0.19 | 0.13-0.25 |
/// | error at edges, % | 0.02-0.03 | 0.05-0.08 | 0.10-0.15 | 0.12-0.20 | 0.18-0.29 | 0.23-0.40 |
#[derive(Debug, Clone)]
pub(crate) struct Kernel {
    /// `tables[n][phase]`: the weights if n + 1 of the samples lie at or below the position, which is `phase / PHASES` of a
    /// sample above the last of them. They add to 1.
    tables: Arc<Tables>,
}

type Tables = Vec<Vec<[f64; TAPS]>>;

/// Recently made tables, by the bits of step times band limit. Making one takes milliseconds, and the same few are needed again and again.
static KEPT: Mutex<Vec<(u64, Arc<Tables>)>> = Mutex::new(Vec::new());
/// Largest number of kept tables; each takes 1 MB.
const MOST_KEPT: usize = 8;

/// The samples from which a value is interpolated, and their weights, which add to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weights {
    /// Number of the first sample; may be negative or beyond the last, unless the edge is open.
    pub first: i64,
    /// Weights of the samples beginning with the first.
    pub values: [f64; TAPS],
}

impl Kernel {
    /// The kernel for samples `step` apart (the larger one, where the axes differ) of an image without
    /// frequencies above `band_limit`, in the inverse unit.
    ///
    /// # Errors
    /// [`Error::Invalid`] for steps above the Nyquist distance `1 / (2 band_limit)`.
    pub(crate) fn new(step: f64, band_limit: f64) -> Result<Self> {
        Self::check(step, band_limit)?;
        let product = step * band_limit;
        let kept = || KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let found = kept().iter().find(|(of, _)| *of == product.to_bits()).map(|(_, t)| t.clone());
        if let Some(tables) = found {
            return Ok(Kernel { tables });
        }
        let tables = Arc::new(Self::tables(product));
        let mut kept = kept();
        if kept.len() >= MOST_KEPT {
            kept.remove(0);
        }
        kept.push((product.to_bits(), Arc::clone(&tables)));
        Ok(Kernel { tables })
    }

    fn tables(product: f64) -> Tables {
        let factor = Cholesky::new(|i, j| {
            let noise = if i == j { NOISE } else { 0.0 };
            correlation((i as f64 - j as f64) * product) + noise
        });
        let ones = factor.solve([1.0; TAPS]);
        let of_ones: f64 = ones.iter().sum();
        // Between any two samples, at a distance from the first of the 16.
        let row = |at: f64| {
            let weights =
                factor.solve(std::array::from_fn(|j| correlation((j as f64 - at) * product)));
            // The weights are made to add to 1, so that a constant is kept.
            let lack = (1.0 - weights.iter().sum::<f64>()) / of_ones;
            std::array::from_fn(|j| weights[j] + lack * ones[j])
        };
        let table = |below: usize| {
            let at = |phase: usize| below as f64 + phase as f64 / PHASES as f64;
            (0..=PHASES).map(|phase| row(at(phase))).collect()
        };
        (0..TAPS - 1).map(table).collect()
    }

    /// Checks that samples `step` apart determine an image without frequencies above `band_limit`.
    ///
    /// # Errors
    /// Errors of [`Kernel::new`].
    pub(crate) fn check(step: f64, band_limit: f64) -> Result<()> {
        let product = step * band_limit;
        if product > 0.0 && product <= MOST_PRODUCT * (1.0 + 1e-9) {
            return Ok(());
        }
        let expected = format!(
            "must be above 0 and at most {:.4}: the Nyquist distance of the image",
            nyquist_step(band_limit)
        );
        Err(Error::invalid(Setting::SampleStepAngstrom, step, expected))
    }

    /// The step that [`Kernel`] interpolates with an error below 0.1 % of the contrast.
    pub(crate) fn default_step(band_limit: f64) -> f64 {
        DEFAULT_PRODUCT / band_limit
    }

    /// Weights of the samples around `position`, equally many on either side.
    #[inline(always)]
    pub(crate) fn weights(&self, position: f64) -> Weights {
        let below = position.floor();
        self.row(below as i64 - (HALF_WIDTH as i64 - 1), HALF_WIDTH - 1, position - below)
    }

    /// Weights of samples around `position`, all of them within the first `n` (at least [`TAPS`]) samples.
    #[inline(always)]
    pub(crate) fn weights_within(&self, position: f64, n: usize) -> Weights {
        let position = position.clamp(0.0, n as f64 - 1.0);
        let below = position.floor().min(n as f64 - 2.0);
        let first = (below as i64 - (HALF_WIDTH as i64 - 1)).clamp(0, n as i64 - TAPS as i64);
        self.row(first, (below as i64 - first) as usize, position - below)
    }

    /// Weights at a position along an axis of `samples` samples, which repeats or not.
    #[inline(always)]
    pub(crate) fn weights_on(&self, (samples, periodic): (usize, bool), position: f64) -> Weights {
        if periodic { self.weights(position) } else { self.weights_within(position, samples) }
    }

    /// Weights for a position that is `fraction` beyond the `below`-th of the samples from `first` on.
    #[inline(always)]
    fn row(&self, first: i64, below: usize, fraction: f64) -> Weights {
        let at = fraction * PHASES as f64;
        let phase = (at as usize).min(PHASES - 1);
        let t = at - phase as f64;
        let table = &self.tables[below];
        let (a, b) = (&table[phase], &table[phase + 1]);
        Weights { first, values: std::array::from_fn(|i| a[i] + t * (b[i] - a[i])) }
    }

    /// Interpolates an image on another raster: an array of `shape` (rows = y, columns = x) in the unit of the image. Its values are at
    /// `first + i step`, both (row, column) in samples of `image`. The axes are resampled one after the other; `edges` are the edges along
    /// (rows, columns).
    pub(crate) fn raster<T: Copy + Into<f64> + Sync>(
        &self,
        image: ArrayView2<'_, T>,
        first: [f64; 2],
        step: [f64; 2],
        shape: [usize; 2],
        edges: [Edge; 2],
    ) -> Array2<f64> {
        let (rows, columns) = image.dim();
        let positions = |axis: usize, n: usize| -> Vec<[(usize, f64); TAPS]> {
            // With fewer samples than taps, the outermost ones are repeated.
            let open = edges[axis] == Edge::Open && n >= TAPS;
            let place = |i: usize| {
                let at = first[axis] + i as f64 * step[axis];
                let w = if open { self.weights_within(at, n) } else { self.weights(at) };
                let sample = |k: usize| sample(w.first + k as i64, n, edges[axis]);
                std::array::from_fn(|k| (sample(k), w.values[k]))
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
        Edge::Open => i.clamp(0, n as i64 - 1) as usize,
    }
}

/// Correlation of an image's values at a distance times the band limit, for a power that falls as (1 - |k| / band limit)^3: about the power
/// of a white specimen seen through a round aperture, along one axis.
fn correlation(distance: f64) -> f64 {
    let z = TAU * distance.abs();
    if z < 1e-2 {
        return 1.0 - z * z / 30.0;
    }
    let z2 = z * z;
    4.0 * (3.0 / z2 - 6.0 * (1.0 - libm::cos(z)) / (z2 * z2))
}

/// Solves equations with a positive definite matrix.
struct Cholesky {
    lower: [[f64; TAPS]; TAPS],
}

impl Cholesky {
    fn new(matrix: impl Fn(usize, usize) -> f64) -> Self {
        let mut lower = [[0.0; TAPS]; TAPS];
        for i in 0..TAPS {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let rest = matrix(i, j) - known;
                lower[i][j] = if i == j { rest.sqrt() } else { rest / lower[j][j] };
            }
        }
        Cholesky { lower }
    }

    fn solve(&self, mut x: [f64; TAPS]) -> [f64; TAPS] {
        let l = &self.lower;
        for i in 0..TAPS {
            let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
            x[i] = (x[i] - known) / l[i][i];
        }
        for i in (0..TAPS).rev() {
            let known: f64 = (i + 1..TAPS).map(|k| l[k][i] * x[k]).sum();
            x[i] = (x[i] - known) / l[i][i];
        }
        x
    }
}

/// Changes the number of samples of periodic images along an axis, by trigonometric interpolation. The first sample stays in place. The
/// result is exact if old and new samples are closer than the Nyquist distance.
pub(crate) struct PeriodicResampling {
    /// Weights of the old samples (columns) in each new one.
    weights: Array2<f64>,
}

impl PeriodicResampling {
    /// Prepares resampling from `from` samples to `to` samples.
    pub(crate) fn new(from: usize, to: usize) -> Self {
        // Dirichlet's kernel: 1 at 0, and 0 at all other samples.
        let dirichlet = |distance: f64| {
            let (a, all) = (PI * distance / from as f64, from as f64);
            let sine = libm::sin(a);
            match sine.abs() < 1e-12 {
                true => 1.0,
                false if from % 2 == 1 => libm::sin(all * a) / (all * sine),
                false => libm::sin(all * a) * libm::cos(a) / (all * sine),
            }
        };
        let weights = Array2::from_shape_fn((to, from), |(i, j)| {
            dirichlet(i as f64 * from as f64 / to as f64 - j as f64)
        });
        PeriodicResampling { weights }
    }

    /// Resamples the image (rows = y, columns = x) along `axis`, along which it has the old number of samples.
    pub(crate) fn of(&self, image: ArrayView2<'_, f32>, axis: Axis) -> Array2<f32> {
        // The axis is made to run down the rows, so that whole rows are summed at once.
        let from = down(image, axis).as_standard_layout().mapv(f64::from);
        let mut to = Array2::<f32>::zeros((self.weights.nrows(), from.ncols()));
        for (mut to, weights) in to.outer_iter_mut().zip(self.weights.outer_iter()) {
            let mut sums = vec![0.0f64; from.ncols()];
            for (weight, row) in weights.iter().zip(from.outer_iter()) {
                let row = row.to_slice().unwrap_or_default();
                vectorised(
                    #[inline(always)]
                    || sums.iter_mut().zip(row).for_each(|(sum, v)| *sum += weight * v),
                );
            }
            to.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum as f32);
        }
        down(to.view(), axis).as_standard_layout().into_owned()
    }
}

/// Exchanges `axis` and the rows.
fn down(image: ArrayView2<'_, f32>, axis: Axis) -> ArrayView2<'_, f32> {
    match axis {
        Axis(0) => image,
        _ => image.reversed_axes(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    /// Rms error of 600 places in per cent of the contrast, for a white specimen.
    fn error_percent(step: f64, edge: Edge, places: impl Fn(f64) -> [f64; 2]) -> f64 {
        let length = 12.0;
        let n = (length / step).ceil() as usize;
        let step = length / n as f64;
        let waves = waves(length);
        let value = |i: usize, j: usize| image(&waves, j as f64 * step, i as f64 * step);
        let samples = Array2::from_shape_fn((n, n), |(i, j)| value(i, j));
        let kernel = Kernel::new(step, band_limit()).unwrap();
        let (mut error, mut contrast) = (0.0, 0.0);
        let mean = samples.mean().unwrap();
        for i in 0..600 {
            let at = places(f64::from(i));
            let exact = image(&waves, at[1] * step, at[0] * step);
            let found = kernel.raster(samples.view(), at, [1.0; 2], [1, 1], [edge; 2])[[0, 0]];
            error += (found - exact).powi(2);
            contrast += (exact - mean).powi(2);
        }
        100.0 * (error / contrast).sqrt()
    }

    #[test]
    fn a_white_specimen_is_interpolated_to_two_thousandths_of_its_contrast() {
        let anywhere = |i: f64| [i * 0.0773 - 3.0, (i * i) % 997.0 * 0.0519];
        for (step, most) in [(0.2, 0.01), (0.2508, 0.03), (0.2806, 0.16), (0.2985, 0.4)] {
            let error = error_percent(step, Edge::Periodic, anywhere);
            // a Kaiser-windowed sinc of 16 samples has 0.05, 0.2 and 0.6 % at the last three
            assert!(error < most, "{step}: {error}");
        }
    }

    #[test]
    fn three_samples_beyond_are_enough_at_an_edge() {
        let margin = MARGIN as f64;
        let edge = |i: f64| [margin - 1.0 + (i * 0.0773).fract(), 9.0 + i * 0.0311];
        let error = error_percent(0.2806, Edge::Open, edge);
        assert!(error < 0.3, "{error}");
        let outermost = |i: f64| [(i * 0.0773).fract(), 9.0 + i * 0.0311];
        assert!(error_percent(0.2806, Edge::Open, outermost) > 2.0 * error);
    }

    #[test]
    fn samples_and_constants_are_kept() {
        let kernel = Kernel::new(STEP, band_limit()).unwrap();
        let waves = waves(6.0);
        let value = |i: usize, j: usize| image(&waves, j as f64 * STEP, i as f64 * STEP);
        let samples = Array2::from_shape_fn((20, 30), |(i, j)| value(i, j));
        let most = samples.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for place in [[9, 14], [0, 29], [19, 1]] {
            let at = place.map(|v| v as f64);
            let found = kernel.raster(samples.view(), at, [1.0; 2], [1, 1], [Edge::Open; 2]);
            let off = (found[[0, 0]] - samples[place]).abs() / most;
            assert!(off < 1e-4, "{off}");
        }
        let flat = Array2::from_elem((5, 37), 3.25_f32);
        for edge in [Edge::Periodic, Edge::Open] {
            let image = kernel.raster(flat.view(), [-7.2, -3.9], [0.37, 1.91], [40, 30], [edge; 2]);
            assert!(image.iter().all(|v| (v - 3.25).abs() < 1e-12));
        }
    }

    #[test]
    fn periodic_images_have_the_same_values_on_more_samples() {
        let length = 6.0;
        let waves = waves(length);
        // 21 samples are enough for the ten waves within the band limit, and so are 22.
        for n in [21, 22] {
            let sampled = |rows: usize, columns: usize| {
                Array2::from_shape_fn((rows, columns), |(i, j)| {
                    let at = [j as f64 / columns as f64, i as f64 / rows as f64];
                    image(&waves, at[0] * length, at[1] * length) as f32
                })
            };
            let found = PeriodicResampling::new(n, 32).of(sampled(n, 25).view(), Axis(0));
            let exact = sampled(32, 25);
            let most = exact.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            assert!(found.iter().zip(&exact).all(|(a, b)| (a - b).abs() < 1e-5 * most));
            let found = PeriodicResampling::new(25, 29).of(found.view(), Axis(1));
            let exact = sampled(32, 29);
            assert!(found.iter().zip(&exact).all(|(a, b)| (a - b).abs() < 1e-5 * most));
        }
    }

    #[test]
    fn sixteen_samples_are_taken_also_at_edges() {
        assert_eq!(samples_around([30.2, 40.0], 0..100), 22..49);
        assert_eq!(samples_around([3.0, 4.0], 0..100), 0..16);
        assert_eq!(samples_around([96.0, 96.5], 5..100), 84..100);
        assert_eq!(samples_around([-9.0, 200.0], 5..100), 5..100);
        assert_eq!(samples_around([2.0, 3.0], 0..10), 0..10);
    }

    #[test]
    fn tables_that_are_kept_are_those_of_their_step() {
        for n in (0..2 * MOST_KEPT).chain(0..2).chain([1, 0, 1]) {
            let product = 0.4 + 0.005 * n as f64;
            let kernel = Kernel::new(product, 1.0).unwrap();
            assert!(*kernel.tables == Kernel::tables(product), "{product}");
        }
        assert!(KEPT.lock().unwrap().len() <= MOST_KEPT);
    }

    #[test]
    fn steps_beyond_nyquist_are_refused() {
        let nyquist = nyquist_step(band_limit());
        assert!(Kernel::new(nyquist, band_limit()).is_ok());
        for bad in [1.01 * nyquist, 0.0, -0.1, f64::NAN] {
            let message = Kernel::new(bad, band_limit()).unwrap_err().to_string();
            assert!(message.contains("0.29"), "{message}");
        }
        assert!((Kernel::default_step(band_limit()) - 0.2806).abs() < 1e-4);
    }
}
