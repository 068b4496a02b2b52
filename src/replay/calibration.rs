//! Calibrates the size of a pixel by a spacing of the crystal, measured in the Fourier transform of the image.

use std::f64::consts::PI;

use ndarray::Array2;
use num_complex::Complex32;
use serde::Serialize;

use super::robust_range::percentiles;
use crate::error::{Error, Result};
use crate::fft::{Fft2, frequency, good_size};
use crate::setting::Setting;

/// Largest relative difference of a spacing from its value with the first guess of the pixel.
const REACH: f64 = 0.15;
/// Largest number of pixels along an edge of the part that is transformed.
const LARGEST_PX: usize = 4096;
/// Least strength of a peak, divided by the median about it. The greatest of a million values of noise has 20 times the median.
const LEAST_CONTRAST: f64 = 50.0;
/// Peaks of one family have at least this share of the strongest peak, ...
const LEAST_SHARE: f64 = 0.05;
/// ... its spacing to within this relative difference, ...
const SAME_SPACING: f64 = 0.06;
/// ... and a direction that differs by at least this many degrees.
const APART_DEG: f64 = 10.0;
/// Least number of periods of the spacing in the part.
const FEWEST_PERIODS: f64 = 6.0;
/// A peak that the scan has smeared extends over up to this many bins to each side ...
const PEAK_BINS: i64 = 3;
/// ... as far as it exceeds this multiple of the median.
const PEAK_CONTRAST: f64 = 8.0;
/// Largest number of periods in a pixel, where the transform ends.
const NYQUIST: f64 = 0.5;

/// A peak of the Fourier transform.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CalibrationPeak {
    /// Distance of the planes in pixels.
    pub spacing_px: f64,
    /// Direction of the planes' normal, from the axis of the columns (x) to the axis of the rows (y).
    pub direction_deg: f64,
    /// Strength divided by the median about the peak.
    pub contrast: f64,
}

/// The size of a pixel from a known spacing.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Calibration {
    /// The known spacing.
    pub spacing_nm: f64,
    /// Edge of a pixel before the calibration.
    pub first_guess_nm: f64,
    /// Edge of a pixel after the calibration.
    pub pixel_nm: f64,
    /// The measured peaks, the strongest first; the mean of their frequencies is used.
    pub peaks: Vec<CalibrationPeak>,
}

/// Measures a known spacing in an image, [row, column], with finite values. Peaks are searched within 15 % of the frequency that follows
/// from `first_guess_nm`, the edge of a pixel. The strongest peak is used, with peaks in other directions of nearly the same spacing.
///
/// # Errors
/// [`Error::Invalid`] for a spacing that the image cannot show, and if no peak is strong enough.
pub fn calibrate(image: &Array2<f64>, spacing_nm: f64, first_guess_nm: f64) -> Result<Calibration> {
    let refuse =
        |expected: String| Err(Error::invalid(Setting::ReplaySpacingNm, spacing_nm, expected));
    if !(spacing_nm > 0.0 && spacing_nm.is_finite()) {
        return refuse("expected a positive length".into());
    }
    let (rows, columns) = image.dim();
    let n = fast_length(rows.min(columns).min(LARGEST_PX));
    // Number of periods in the part.
    let expected = first_guess_nm / spacing_nm * n as f64;
    if expected < FEWEST_PERIODS || expected * (1.0 + REACH) > NYQUIST * n as f64 {
        return refuse(format!(
            "it is {:.2} pixels of {first_guess_nm} nm, but the image shows only spacings of 2.3 to {:.0} pixels; check the spacing and \
             the pixel size",
            spacing_nm / first_guess_nm,
            n as f64 / FEWEST_PERIODS
        ));
    }
    let power = power_spectrum(image, n);
    let [low, high] = [(1.0 - REACH) * expected, (1.0 + REACH) * expected];
    let peaks = peaks(&power, [low, high]);
    if peaks.is_empty() {
        return refuse(format!(
            "no peak of the Fourier transform stands out within {:.0} % of it, from {:.4} to {:.4} nm with pixels of \
             {first_guess_nm} nm; name a spacing that the image shows, or a pixel size nearer to the true one",
            100.0 * REACH,
            first_guess_nm * n as f64 / high,
            first_guess_nm * n as f64 / low
        ));
    }
    let mean = peaks.iter().map(|peak| 1.0 / peak.spacing_px).sum::<f64>() / peaks.len() as f64;
    Ok(Calibration { spacing_nm, first_guess_nm, pixel_nm: spacing_nm * mean, peaks })
}

/// Returns the greatest length up to `most` whose transform is fast.
fn fast_length(most: usize) -> usize {
    (1..=most).rev().find(|n| good_size(*n, 1) == *n).unwrap_or(1)
}

/// Returns the power of the middle of an image, n by n pixels, faded out towards its edges; [n, n], in FFT order.
fn power_spectrum(image: &Array2<f64>, n: usize) -> Array2<f64> {
    let (rows, columns) = image.dim();
    let (top, left) = ((rows - n) / 2, (columns - n) / 2);
    let part = image.slice(ndarray::s![top..top + n, left..left + n]);
    let mean = part.mean().unwrap_or(0.0);
    let spread = (part.mapv(|v| (v - mean).powi(2)).mean().unwrap_or(0.0)).sqrt();
    let scale = if spread > 0.0 { 1.0 / spread } else { 1.0 };
    let fade = |k: usize| 0.5 - 0.5 * (2.0 * PI * (k as f64 + 0.5) / n as f64).cos();
    let fades: Vec<f64> = (0..n).map(fade).collect();
    let fft = Fft2::new(n, n);
    let mut data = fft.buffer();
    for ((row, column), value) in part.indexed_iter() {
        let value = (value - mean) * scale * fades[row] * fades[column];
        data[row * fft.stride() + column] = Complex32::new(value as f32, 0.0);
    }
    fft.forward(&mut data, &mut fft.scratch());
    Array2::from_shape_fn((n, n), |(row, column)| {
        let value = data[row * fft.stride() + column];
        f64::from(value.re).powi(2) + f64::from(value.im).powi(2)
    })
}

/// Returns the peaks of one family with frequencies (in periods) between two limits, the strongest first.
fn peaks(power: &Array2<f64>, [low, high]: [f64; 2]) -> Vec<CalibrationPeak> {
    let n = power.nrows();
    let mut about = Vec::new();
    let mut found: Vec<(f64, [i64; 2])> = Vec::new();
    for ((row, column), value) in power.indexed_iter() {
        let [ky, kx] = [row, column].map(|k| frequency(k, n));
        let length = (kx as f64).hypot(ky as f64);
        // The other half of the transform has the same power.
        let half = ky > 0 || (ky == 0 && kx > 0);
        if !half || !(low..=high).contains(&length) {
            continue;
        }
        about.push(*value);
        let around = |i: i64, j: i64| power[[wrapped(ky + i, n), wrapped(kx + j, n)]];
        let neighbours = (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j)));
        if neighbours.filter(|at| *at != (0, 0)).all(|(i, j)| around(i, j) < *value) {
            found.push((*value, [kx, ky]));
        }
    }
    let Some([median]) = percentiles(&about, [50.0]) else { return Vec::new() };
    found.retain(|(value, _)| *value > LEAST_CONTRAST * median);
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut peaks: Vec<CalibrationPeak> = Vec::new();
    for (value, bin) in found {
        let [x, y] = centre(power, bin, median);
        let peak = CalibrationPeak {
            spacing_px: n as f64 / x.hypot(y),
            direction_deg: y.atan2(x).to_degrees(),
            contrast: value / median,
        };
        if peaks.first().is_none_or(|first| peak.is_like(first))
            && peaks.iter().all(|p| peak.is_apart(p))
        {
            peaks.push(peak);
        }
    }
    peaks
}

impl CalibrationPeak {
    fn is_like(&self, strongest: &CalibrationPeak) -> bool {
        (self.spacing_px / strongest.spacing_px - 1.0).abs() <= SAME_SPACING
            && self.contrast >= LEAST_SHARE * strongest.contrast
    }

    fn is_apart(&self, other: &CalibrationPeak) -> bool {
        let turn = (self.direction_deg - other.direction_deg).rem_euclid(180.0);
        turn.min(180.0 - turn) >= APART_DEG
    }
}

fn wrapped(k: i64, n: usize) -> usize {
    k.rem_euclid(n as i64) as usize
}

/// Returns the centre of mass (x, y) of a peak about its strongest bin.
fn centre(power: &Array2<f64>, [kx, ky]: [i64; 2], median: f64) -> [f64; 2] {
    let n = power.nrows();
    let (mut sum, mut moments) = (0.0, [0.0; 2]);
    for (i, j) in
        (-PEAK_BINS..=PEAK_BINS).flat_map(|i| (-PEAK_BINS..=PEAK_BINS).map(move |j| (i, j)))
    {
        let value = power[[wrapped(ky + i, n), wrapped(kx + j, n)]];
        if value > PEAK_CONTRAST * median {
            sum += value - median;
            moments[0] += (value - median) * (kx + j) as f64;
            moments[1] += (value - median) * (ky + i) as f64;
        }
    }
    moments.map(|moment| moment / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{self, Purpose};

    /// Planes of a hexagonal lattice in noise, `d` pixels apart.
    fn hexagonal(d: f64, turn_deg: f64, noise: f64) -> Array2<f64> {
        Array2::from_shape_fn((420, 500), |(y, x)| {
            let wave = |k: f64| {
                let (s, c) = (turn_deg + 60.0 * k).to_radians().sin_cos();
                (2.0 * PI * (x as f64 * c + y as f64 * s) / d).cos()
            };
            let drawn = rng::uniform(1, Purpose::Tile, 0, (500 * y + x) as u64) - 0.5;
            100.0 + wave(0.0) + wave(1.0) + wave(2.0) + noise * drawn
        })
    }

    #[test]
    fn a_known_spacing_is_measured() {
        for (d, turn) in [(11.37, 3.0), (21.5, 17.0), (4.81, 40.0)] {
            let image = hexagonal(d, turn, 6.0);
            // A true pixel of 0.27 / d, and a file whose value is wrong by 7 %.
            let found = calibrate(&image, 0.27, 1.07 * 0.27 / d).unwrap();
            assert!((found.pixel_nm * d / 0.27 - 1.0).abs() < 1e-3, "{d}: {found:?}");
            assert_eq!(found.peaks.len(), 3, "{found:?}");
        }
    }

    #[test]
    fn what_is_not_there_is_not_found() {
        let refused = |image: &Array2<f64>, spacing: f64, guess: f64| {
            calibrate(image, spacing, guess).unwrap_err().to_string()
        };
        let image = hexagonal(11.37, 3.0, 6.0);
        assert!(refused(&image, 0.27, 1.5 * 0.27 / 11.37).contains("no peak"));
        assert!(refused(&hexagonal(11.37, 3.0, 1e6), 0.27, 0.27 / 11.37).contains("no peak"));
        assert!(refused(&image, 0.27, 0.2).contains("1.35 pixels"));
        assert!(refused(&image, 0.27, 1e-4).contains("pixels"));
        assert!(refused(&Array2::zeros((200, 200)), 0.27, 0.02).contains("no peak"));
    }
}
