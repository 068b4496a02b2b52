//! The modulation transfer function of a pixelated detector: the spread of one electron's signal over pixels.

use ndarray::ArrayViewMut2;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

use crate::error::{Error, Result};
use crate::fft::{Buffer, Fft2, Scratch, frequency};
use crate::setting::Setting;

/// Widest point spread in pixels.
const MOST_SIGMA: f64 = 50.0;
/// Most rows of a table.
const MOST_ROWS: usize = 10_000;
/// Allowed deviation of a table's first row from transfer 1 at frequency 0.
const ONE: f64 = 1e-3;

/// How a pixelated detector spreads the electrons of a pixel over its neighbours, beyond the area of the pixel itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum DetectorMtf {
    /// A Gaussian point spread function: its standard deviation in pixels along each axis.
    Gaussian(f64),
    /// The transfer at some frequencies, (cycles per pixel, transfer), by rising frequency from (0, 1) on, the same in all directions; with
    /// straight lines between, and the last value beyond.
    Table(Vec<[f64; 2]>),
}

impl DetectorMtf {
    /// Reads a number, the standard deviation of a Gaussian in pixels, or the rows of a table: cycles per pixel and transfer, with blanks,
    /// commas, semicolons or tabs between; lines that begin with # are left out.
    ///
    /// # Errors
    /// [`Error::Invalid`] for anything else.
    pub fn parse(text: &str) -> Result<Self> {
        if let Ok(sigma) = text.trim().parse() {
            return DetectorMtf::Gaussian(sigma).checked();
        }
        let mut rows = Vec::new();
        for line in text.lines().map(str::trim) {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let columns = line.split([',', ';', ' ', '\t']).filter(|part| !part.is_empty());
            let numbers: Vec<f64> = columns.map_while(|part| part.parse().ok()).collect();
            let [frequency, transfer] = numbers[..] else {
                let expected = "expected lines of two numbers: cycles per pixel, transfer";
                return Err(Error::invalid(Setting::DetectorMtf, line, expected));
            };
            rows.push([frequency, transfer]);
        }
        DetectorMtf::Table(rows).checked()
    }

    fn checked(self) -> Result<Self> {
        self.check()?;
        Ok(self)
    }

    /// Checks that this is a transfer function.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a width below 0 or above 50 pixels, and for a table that does not rise in frequency from (0, 1) on, or has
    /// values outside 0 to 2.
    pub(crate) fn check(&self) -> Result<()> {
        let bad = |value: String, expected: &str| {
            Err(Error::invalid(Setting::DetectorMtf, value, expected))
        };
        match self {
            DetectorMtf::Gaussian(sigma) if !(0.0..=MOST_SIGMA).contains(sigma) => {
                bad(sigma.to_string(), "expected a standard deviation of 0 to 50 pixels")
            }
            DetectorMtf::Gaussian(_) => Ok(()),
            DetectorMtf::Table(rows) if rows.len() < 2 || rows.len() > MOST_ROWS => {
                bad(format!("{} rows", rows.len()), "expected a table of 2 to 10000 rows")
            }
            DetectorMtf::Table(rows) => {
                if rows[0][0] != 0.0 || (rows[0][1] - 1.0).abs() > ONE {
                    let first = format!("{}, {}", rows[0][0], rows[0][1]);
                    return bad(first, "a table begins at frequency 0 with transfer 1");
                }
                let falls = |pair: &&[[f64; 2]]| pair[1][0].is_nan() || pair[0][0] >= pair[1][0];
                if let Some(pair) = rows.windows(2).find(falls) {
                    let at = pair[1][0].to_string();
                    return bad(at, "frequencies (cycles per pixel) have to rise from row to row");
                }
                match rows.iter().find(|[_, transfer]| !(0.0..=2.0).contains(transfer)) {
                    Some([_, transfer]) => {
                        bad(transfer.to_string(), "a transfer is between 0 and 2")
                    }
                    None => Ok(()),
                }
            }
        }
    }

    /// The transfer at a frequency in cycles per pixel.
    fn at(&self, frequency: f64) -> f64 {
        match self {
            DetectorMtf::Gaussian(sigma) => libm::exp(-2.0 * (PI * sigma * frequency).powi(2)),
            DetectorMtf::Table(rows) => {
                let after = rows.partition_point(|[f, _]| *f <= frequency);
                match (after.checked_sub(1).and_then(|n| rows.get(n)), rows.get(after)) {
                    (Some([a, from]), Some([b, to])) => {
                        from + (to - from) * (frequency - a) / (b - a)
                    }
                    (Some([_, value]), None) | (None, Some([_, value])) => *value,
                    (None, None) => 1.0,
                }
            }
        }
    }
}

/// Applies a transfer function to patterns of one size. Beyond the edges of the detector a pattern is mirrored, so that it keeps its sum.
pub(crate) struct MtfFilter {
    pixels: usize,
    fft: Fft2,
    transfer: Vec<f32>,
}

/// One thread's arrays.
pub(crate) struct MtfWorkspace {
    wave: Buffer,
    scratch: Scratch,
}

impl MtfFilter {
    /// Prepares the filter for patterns of `pixels` x `pixels`.
    pub(crate) fn new(mtf: &DetectorMtf, pixels: usize) -> Self {
        let n = 2 * pixels;
        let f = |i: usize| frequency(i, n) as f64 / n as f64;
        let first = mtf.at(0.0) * (n * n) as f64;
        let value = |i: usize| (mtf.at(f(i / n).hypot(f(i % n))) / first) as f32;
        MtfFilter { pixels, fft: Fft2::new(n, n), transfer: (0..n * n).map(value).collect() }
    }

    /// Arrays for one thread.
    pub(crate) fn workspace(&self) -> MtfWorkspace {
        MtfWorkspace { wave: self.fft.buffer(), scratch: self.fft.scratch() }
    }

    /// Spreads the electrons of a pattern. Negative values, which a sharp transfer function can make, become 0; the sum is kept.
    pub(crate) fn apply(&self, mut pattern: ArrayViewMut2<'_, f32>, w: &mut MtfWorkspace) {
        let (n, stride) = (2 * self.pixels, self.fft.stride());
        let mirrored = |i: usize| if i < self.pixels { i } else { n - 1 - i };
        for y in 0..n {
            for x in 0..n {
                let value = pattern[[mirrored(y), mirrored(x)]];
                w.wave[y * stride + x] = Complex32::new(value, 0.0);
            }
        }
        self.fft.forward(&mut w.wave, &mut w.scratch);
        for y in 0..n {
            for x in 0..n {
                w.wave[y * stride + x] *= self.transfer[y * n + x];
            }
        }
        self.fft.inverse(&mut w.wave, &mut w.scratch);
        let before: f64 = pattern.iter().map(|v| f64::from(*v)).sum();
        for ((y, x), v) in pattern.indexed_iter_mut() {
            *v = w.wave[y * stride + x].re.max(0.0);
        }
        let after: f64 = pattern.iter().map(|v| f64::from(*v)).sum();
        if after > 0.0 {
            let scale = (before / after) as f32;
            pattern.iter_mut().for_each(|v| *v *= scale);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn blurred(mtf: &DetectorMtf, pattern: &Array2<f32>) -> Array2<f32> {
        let filter = MtfFilter::new(mtf, pattern.nrows());
        let mut out = pattern.clone();
        filter.apply(out.view_mut(), &mut filter.workspace());
        out
    }

    /// One bright pixel becomes a Gaussian, in the middle and, mirrored, in a corner.
    #[test]
    fn a_pixel_becomes_the_point_spread_function() {
        let (sigma, n) = (1.3_f64, 24);
        let mut pattern = Array2::zeros((n, n));
        pattern[[12, 10]] = 5.0;
        let out = blurred(&DetectorMtf::Gaussian(sigma), &pattern);
        for ((y, x), v) in out.indexed_iter() {
            let r2 = (y as f64 - 12.0).powi(2) + (x as f64 - 10.0).powi(2);
            let exact = 5.0 * (-0.5 * r2 / sigma.powi(2)).exp() / (2.0 * PI * sigma.powi(2));
            assert!((f64::from(*v) - exact).abs() < 2e-4, "{y} {x}: {v} {exact}");
        }
        let mut corner = Array2::zeros((n, n));
        corner[[0, 0]] = 1.0;
        let out = blurred(&DetectorMtf::Gaussian(sigma), &corner);
        assert!((out.sum() - 1.0).abs() < 1e-5, "{}", out.sum());
        assert!(out[[23, 23]] < 1e-6, "nothing comes in at the other side: {}", out[[23, 23]]);
        let same = blurred(&DetectorMtf::Gaussian(0.0), &pattern);
        assert!(same.iter().zip(&pattern).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    /// A table damps a wave by its value at the wave's frequency.
    #[test]
    fn a_table_damps_waves() {
        let table = DetectorMtf::parse("# cycles per pixel, transfer\n0, 1\n0.25; 0.5\n0.5\t0.1\n");
        let table = table.unwrap();
        let n = 32;
        let wave = |height: f64| {
            // Whole waves of the mirrored pattern: 12 half waves over the detector.
            let v = |x: usize| 2.0 + height * (PI * 12.0 * (x as f64 + 0.5) / n as f64).cos();
            Array2::from_shape_fn((n, n), |(_, x)| v(x) as f32)
        };
        let out = blurred(&table, &wave(1.0));
        // 12 / 64 cycles per pixel
        let expected = wave(1.0 - 2.0 * 12.0 / 64.0);
        assert!(out.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-4));
    }

    #[test]
    fn what_is_no_transfer_function_is_refused() {
        let refused = |text: &str| DetectorMtf::parse(text).unwrap_err().to_string();
        assert!(refused("-1").contains("0 to 50 pixels") && refused("nan").contains("50 pixels"));
        assert!(refused("0 1\n").contains("2 to 10000 rows"));
        assert!(refused("0.1 1\n0.5 0.2\n").contains("frequency 0"));
        assert!(refused("0 0.4\n0.5 0.2\n").contains("transfer 1"));
        assert!(refused("0 1\n0.5 0.2\n0.4 0.1\n").contains("rise"));
        assert!(refused("0 1\n0.5 -0.2\n").contains("between 0 and 2"));
        assert!(refused("0 1\n0.5 north\n").contains("two numbers"));
    }
}
