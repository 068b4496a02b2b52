//! Radially averaged power spectra of an image, segment by segment (P. D. Welch, IEEE Trans. Audio
//! Electroacoust. 15 (1967) 70).

use std::f64::consts::PI;
use std::sync::Arc;

use ndarray::ArrayView2;
use rustfft::{Fft, FftPlanner, num_complex::Complex64};
use serde::Serialize;

use super::super::statistics::Ratio;

/// Edges of a segment in pixels; the smaller one is for small images.
const SEGMENTS: [usize; 2] = [64, 32];
/// Least number of segments that an image must hold to use an edge.
const ENOUGH: usize = 16;

/// Bands of spatial frequency that two images share.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bands {
    /// Width of a band in 1/nm.
    pub width: f64,
    /// Number of bands; band `i` is centred at `(i + 1) width`.
    pub count: usize,
    /// Edge of a segment in pixels.
    pub segment: usize,
}

impl Bands {
    /// Chooses bands for images with these pixels (nm) and shapes (pixels).
    pub fn common(pixels: [f64; 2], shapes: [[usize; 2]; 2]) -> Self {
        let held = |edge: usize| {
            shapes.map(|[rows, columns]| (rows / edge) * (columns / edge)).into_iter().min()
        };
        let [large, small] = SEGMENTS;
        let segment = if held(large) >= Some(ENOUGH) { large } else { small };
        let [a, b] = pixels;
        let width = 1.0 / (segment as f64 * a.min(b));
        let nyquist = 0.5 / a.max(b);
        Bands { width, count: ((nyquist / width + 1e-9) as usize).max(1), segment }
    }

    fn of(&self, frequency: f64) -> Option<usize> {
        let band = (frequency / self.width).round() as usize;
        (1..=self.count).contains(&band).then(|| band - 1)
    }
}

/// Spectra of the segments of an image.
#[derive(Debug, Clone, Serialize)]
pub struct Spectrum {
    /// The bands.
    pub bands: Bands,
    /// Mean power of each band in nm2, over all segments.
    pub power: Vec<f64>,
    /// Rows and columns of segments.
    #[serde(skip)]
    pub grid: [usize; 2],
    /// Power of each band in each segment, row by row.
    #[serde(skip)]
    pub segments: Vec<Vec<f64>>,
    /// Noise power (A2) and mean of each segment: their ratio is one over the dose.
    #[serde(skip)]
    pub noise: Vec<(f64, f64)>,
}

impl Spectrum {
    /// Returns the centre of the highest band in 1/nm.
    pub(crate) fn highest(&self) -> f64 {
        self.bands.count as f64 * self.bands.width
    }

    /// Returns the centres of the bands in 1/nm.
    pub(crate) fn frequencies(&self) -> impl Iterator<Item = f64> + '_ {
        (1..=self.bands.count).map(|i| i as f64 * self.bands.width)
    }

    /// Returns the ratio to another spectrum, band by band, with its relative error as `error`.
    pub(crate) fn ratio(&self, other: &Spectrum) -> Vec<Ratio> {
        let mean = |s: &Spectrum, band: usize| {
            let values: Vec<(f64, f64)> = s.segments.iter().map(|v| (v[band], 1.0)).collect();
            Ratio::of_blocks(&values)
        };
        let one = |band: usize| {
            let (a, b) = (mean(self, band), mean(other, band));
            let error = (a.error / a.value).hypot(b.error / b.value);
            Ratio { value: a.value / b.value, error }
        };
        (0..self.bands.count).map(one).collect()
    }
}

/// Collects the spectra of segments.
pub struct Collector {
    bands: Bands,
    pixel_nm: f64,
    /// Beyond this frequency (1/nm) an image holds noise only.
    limit: f64,
    fft: Arc<dyn Fft<f64>>,
    window: Vec<f64>,
    grid: [usize; 2],
    segments: Vec<Vec<f64>>,
    noise: Vec<(f64, f64)>,
}

impl Collector {
    pub fn new(bands: Bands, pixel_nm: f64, limit: f64) -> Self {
        let n = bands.segment;
        let hann = |i: usize| (PI * (i as f64 + 0.5) / n as f64).sin().powi(2);
        // The noise is measured at the highest frequencies, at least in the corners of the square.
        let corner = 0.5 / pixel_nm * 2.0_f64.sqrt();
        Collector {
            bands,
            pixel_nm,
            limit: limit.min(0.85 * corner),
            fft: FftPlanner::new().plan_fft_forward(n),
            window: (0..n).map(hann).collect(),
            grid: [0, 0],
            segments: Vec::new(),
            noise: Vec::new(),
        }
    }

    /// Adds the whole segments of a strip of the image.
    pub fn add(&mut self, strip: ArrayView2<f64>) {
        let n = self.bands.segment;
        self.grid = [self.grid[0] + strip.nrows() / n, strip.ncols() / n];
        for segment in strip.exact_chunks((n, n)) {
            self.segment(segment);
        }
    }

    fn segment(&mut self, values: ArrayView2<f64>) {
        let n = self.bands.segment;
        let mean = values.sum() / (n * n) as f64;
        let mut data: Vec<Complex64> = values
            .indexed_iter()
            .map(|((y, x), v)| Complex64::new((v - mean) * self.window[y] * self.window[x], 0.0))
            .collect();
        self.fft.process(&mut data);
        let mut turned: Vec<Complex64> = (0..n * n).map(|i| data[i % n * n + i / n]).collect();
        self.fft.process(&mut turned);
        let squares: f64 = self.window.iter().map(|w| w * w).sum();
        let scale = self.pixel_nm * self.pixel_nm / (squares * squares);
        let frequency = |i: usize| {
            let i = if i > n / 2 { i as f64 - n as f64 } else { i as f64 };
            i / (n as f64 * self.pixel_nm)
        };
        let mut sums = vec![(0.0, 0.0); self.bands.count];
        let mut beyond = (0.0_f64, 0.0_f64);
        for (i, v) in turned.iter().enumerate() {
            let f = frequency(i / n).hypot(frequency(i % n));
            let power = v.norm_sqr() * scale;
            if let Some(band) = self.bands.of(f) {
                sums[band] = (sums[band].0 + power, sums[band].1 + 1.0);
            }
            if f > self.limit {
                beyond = (beyond.0 + power, beyond.1 + 1.0);
            }
        }
        self.segments.push(sums.iter().map(|(sum, n): &(f64, f64)| sum / n.max(1.0)).collect());
        // From nm2 to A2.
        self.noise.push((100.0 * beyond.0 / beyond.1.max(1.0), mean));
    }

    pub fn finish(self) -> Spectrum {
        let n = self.segments.len().max(1) as f64;
        let mean = |band: usize| self.segments.iter().map(|s| s[band]).sum::<f64>() / n;
        Spectrum {
            power: (0..self.bands.count).map(mean).collect(),
            bands: self.bands,
            grid: self.grid,
            segments: self.segments,
            noise: self.noise,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::philox4x32_10;
    use ndarray::Array2;

    const PIXEL: f64 = 0.02;

    /// White noise of variance 1/12 about 1, 256 x 256 pixels.
    fn noise(seed: u32) -> Array2<f64> {
        let word = |y: usize, x: usize| philox4x32_10([x as u32, y as u32, 0, 0], [seed, 1])[0];
        Array2::from_shape_fn((256, 256), |(y, x)| 0.5 + f64::from(word(y, x)) / 4_294_967_296.0)
    }

    fn spectrum(image: &Array2<f64>) -> Spectrum {
        let mut collector = Collector::new(Bands::common([PIXEL; 2], [[256; 2]; 2]), PIXEL, 16.7);
        collector.add(image.view());
        collector.finish()
    }

    #[test]
    fn small_images_have_smaller_segments() {
        assert_eq!(Bands::common([0.02, 0.02], [[256, 256], [512, 300]]).segment, 64);
        let small = Bands::common([0.02, 0.04], [[256, 256], [184, 184]]);
        assert_eq!((small.segment, small.count), (32, 8));
        assert!((small.width - 1.0 / 0.64).abs() < 1e-12);
    }

    #[test]
    fn white_noise_has_its_variance_in_every_band() {
        let s = spectrum(&noise(1));
        let expected = PIXEL * PIXEL / 12.0;
        assert_eq!((s.segments.len(), s.power.len()), (16, 32));
        for (f, p) in s.frequencies().zip(&s.power).skip(3) {
            assert!((p / expected - 1.0).abs() < 0.25, "{f}: {p} {expected}");
        }
        // A mean of 1 and a variance of 1/12 in a pixel of 0.04 A2 correspond to a dose of 12 / 0.04 electrons per A2.
        let dose = 1.0 / Ratio::of_blocks(&s.noise).value;
        assert!((dose / 300.0 - 1.0).abs() < 0.05, "{dose}");
    }

    #[test]
    fn a_wave_is_found_in_its_band_and_ratios_have_honest_errors() {
        let f = 5.0;
        let wave = |x: usize| 0.2 * (2.0 * PI * f * x as f64 * PIXEL).cos();
        let base = noise(2);
        let waved = Array2::from_shape_fn(base.dim(), |(y, x)| base[[y, x]] + wave(x));
        let (a, b, c) = (spectrum(&base), spectrum(&waved), spectrum(&noise(3)));
        let z = |s: &Spectrum, t: &Spectrum| -> Vec<f64> {
            s.ratio(t).iter().map(|r| r.value.ln() / r.error).collect()
        };
        let found = z(&b, &a);
        let best = (0..found.len()).max_by(|i, j| found[*i].total_cmp(&found[*j])).unwrap();
        let at = a.frequencies().nth(best).unwrap();
        assert!((at - f).abs() < 1.0 && found[best] > 4.0, "{at} {}", found[best]);
        let apart = z(&a, &c);
        let spread = (apart.iter().map(|z| z * z).sum::<f64>() / apart.len() as f64).sqrt();
        assert!((0.6..1.5).contains(&spread), "{spread}");
    }
}
