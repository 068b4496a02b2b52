//! Virtual detectors: images from the recorded diffraction patterns of a scan.

use ndarray::{Array2, ArrayView2, Zip};
use num_complex::Complex32;
use std::f64::consts::TAU;

use super::{MOST_MRAD, PixelatedDetector};
use crate::error::{Error, Result};
use crate::fft::{Fft2, frequency};
use crate::setting::Setting;

/// Number of points along an edge of a pixel that measure the share of its area on a detector.
const POINTS: usize = 16;

/// A ring, or a sector of one, on a pixelated detector.
#[derive(Debug, Clone, PartialEq)]
pub struct VirtualDetector {
    /// Name of the detector's image.
    pub name: String,
    /// Inner and outer angle in mrad.
    pub annulus_mrad: [f64; 2],
    /// Azimuths between which a sector lies (degrees, from +x towards +y, which points down); `None`: a whole ring.
    pub sector_degrees: Option<[f64; 2]>,
    /// Centre (x, y) in mrad.
    pub centre_mrad: [f64; 2],
}

impl VirtualDetector {
    /// Reads `[NAME=]INNER-OUTER` in mrad.
    ///
    /// # Errors
    /// [`Error::Invalid`] for anything else.
    pub fn annulus(text: &str) -> Result<Self> {
        let found = super::Detector::parse(text)?;
        Ok(VirtualDetector {
            name: found.name,
            annulus_mrad: [found.inner_mrad, found.outer_mrad],
            sector_degrees: None,
            centre_mrad: [0.0; 2],
        })
    }

    /// Equal sectors of a ring: reads `[NAME=]INNER-OUTER:SECTORS[@DEGREES]`; the first sector begins at `DEGREES`. Their names end in
    /// `_0`, `_1`, ...
    ///
    /// # Errors
    /// [`Error::Invalid`] for anything else, and for less than 2 or more than 360 sectors.
    pub fn sectors(text: &str) -> Result<Vec<Self>> {
        if !text.contains(':') {
            let expected = "write INNER-OUTER:SECTORS, or INNER-OUTER:SECTORS@DEGREES: 0-21:4@45";
            return Err(Error::invalid(Setting::Detector, text, expected));
        }
        let found = super::Detector::parse_all(text)?;
        let sector = |found: super::Detector| VirtualDetector {
            name: found.name,
            annulus_mrad: [found.inner_mrad, found.outer_mrad],
            sector_degrees: found.sector_degrees,
            centre_mrad: [0.0; 2],
        };
        Ok(found.into_iter().map(sector).collect())
    }

    /// Whether the detector is a whole ring around the optical axis.
    pub(crate) fn is_annulus(&self) -> bool {
        self.sector_degrees.is_none() && self.centre_mrad == [0.0; 2]
    }

    /// The share of each pixel's area on the detector, `[ky, kx]`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for angles beyond the pixels of the detector, and for a detector without any pixel.
    pub fn weights(&self, pixels: &PixelatedDetector) -> Result<Array2<f32>> {
        let given = || {
            let [inner, outer] = self.annulus_mrad;
            format!("{}={inner}-{outer}", self.name)
        };
        let [inner, outer] = self.annulus_mrad;
        let reach =
            pixels.max_angle_mrad - self.centre_mrad[0].abs().max(self.centre_mrad[1].abs());
        if !(inner >= 0.0 && outer > inner && outer <= MOST_MRAD) {
            let expected = "the outer angle must exceed the inner, which must not be negative";
            return Err(Error::invalid(Setting::Detector, given(), expected));
        }
        if outer > reach + 0.5 * pixels.pixel_mrad() {
            let expected = format!(
                "the patterns reach to {:.1} mrad; simulate them with a larger `max_angle_mrad`",
                pixels.max_angle_mrad
            );
            return Err(Error::invalid(Setting::Detector, given(), expected));
        }
        let weights =
            Array2::from_shape_fn((pixels.pixels, pixels.pixels), |at| self.share(pixels, at));
        if weights.iter().all(|w| *w == 0.0) {
            let expected = format!(
                "lies between the pixels, which are {:.2} mrad wide; use a wider detector, or patterns with more pixels",
                pixels.pixel_mrad()
            );
            return Err(Error::invalid(Setting::Detector, given(), expected));
        }
        Ok(weights)
    }

    fn share(&self, pixels: &PixelatedDetector, (y, x): (usize, usize)) -> f32 {
        let middle = [pixels.angle_mrad(x), pixels.angle_mrad(y)];
        let offset = |i: usize| ((i as f64 + 0.5) / POINTS as f64 - 0.5) * pixels.pixel_mrad();
        let inside = (0..POINTS * POINTS).filter(|i| {
            let dx = middle[0] + offset(i % POINTS) - self.centre_mrad[0];
            let dy = middle[1] + offset(i / POINTS) - self.centre_mrad[1];
            self.contains(dx, dy)
        });
        inside.count() as f32 / (POINTS * POINTS) as f32
    }

    fn contains(&self, x: f64, y: f64) -> bool {
        let [inner, outer] = self.annulus_mrad;
        let theta = x.hypot(y);
        let within = self.sector_degrees.is_none_or(|[from, to]| {
            (y.atan2(x).to_degrees() - from).rem_euclid(360.0) < to - from
        });
        inner <= theta && theta < outer && within
    }
}

/// The sum of a pattern times weights.
pub fn weighted_sum(pattern: ArrayView2<'_, f32>, weights: &Array2<f32>) -> f32 {
    let mut sum = 0.0;
    Zip::from(pattern).and(weights).for_each(|p, w| sum += f64::from(p * w));
    sum as f32
}

/// The centre of mass (x, y) of a pattern in mrad: the mean angle of its electrons. It is 0 for a pattern without electrons.
pub fn centre_of_mass_mrad(pattern: ArrayView2<'_, f32>, pixels: &PixelatedDetector) -> [f32; 2] {
    let mut sums = [0.0_f64; 3];
    for ((y, x), v) in pattern.indexed_iter() {
        let v = f64::from(*v);
        sums[0] += v * pixels.angle_mrad(x);
        sums[1] += v * pixels.angle_mrad(y);
        sums[2] += v;
    }
    match sums[2] > 0.0 {
        true => [(sums[0] / sums[2]) as f32, (sums[1] / sums[2]) as f32],
        false => [0.0; 2],
    }
}

/// The integrated centre of mass in radians: the phase whose gradient, times wavelength / 2 pi, is the centre of mass (x, y; mrad,
/// `[row, column]`). Its mean is 0, and the scan is taken as periodic (I. Lazic, E. Bosch and S. Lazar, Ultramicroscopy 160 (2016) 265).
///
/// # Errors
/// [`Error::Invalid`] for images of different shapes.
pub fn integrated_centre_of_mass(
    centre_mrad: [&Array2<f32>; 2],
    step_angstrom: [f64; 2],
    wavelength_angstrom: f64,
) -> Result<Array2<f32>> {
    let (rows, columns) = centre_mrad[0].dim();
    if centre_mrad[1].dim() != (rows, columns) {
        let expected = "expected images of x and y of the same shape";
        return Err(Error::invalid(Setting::Pattern, format!("{rows} x {columns}"), expected));
    }
    let fft = Fft2::new(rows, columns);
    let mut scratch = fft.scratch();
    // Radians of phase per Angstrom.
    let slope = (1e-3 * TAU / wavelength_angstrom) as f32;
    let [x, y] = centre_mrad.map(|image| {
        let mut wave = fft.buffer();
        for ((row, column), v) in image.indexed_iter() {
            wave[row * fft.stride() + column] = Complex32::new(v * slope, 0.0);
        }
        fft.forward(&mut wave, &mut scratch);
        wave
    });
    let mut phase = fft.buffer();
    let k = |i: usize, n: usize, step: f64| frequency(i, n) as f64 / (n as f64 * step);
    for row in 0..rows {
        for column in 0..columns {
            let (kx, ky) = (k(column, columns, step_angstrom[0]), k(row, rows, step_angstrom[1]));
            let k2 = kx * kx + ky * ky;
            let at = row * fft.stride() + column;
            // A frequency at Nyquist has no sign, and so no derivative.
            let alone = |i: usize, n: usize| 2 * i == n;
            if k2 > 0.0 && !alone(row, rows) && !alone(column, columns) {
                let scale = 1.0 / (TAU * k2 * (rows * columns) as f64);
                let sum = x[at] * (kx * scale) as f32 + y[at] * (ky * scale) as f32;
                phase[at] = Complex32::new(sum.im, -sum.re);
            }
        }
    }
    fft.inverse(&mut phase, &mut scratch);
    Ok(Array2::from_shape_fn((rows, columns), |(row, column)| {
        phase[row * fft.stride() + column].re
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const PIXELS: PixelatedDetector = PixelatedDetector { pixels: 64, max_angle_mrad: 64.0 };

    #[test]
    fn weights_have_the_area_of_the_detector() {
        let ring = VirtualDetector::annulus("ADF=20-50").unwrap();
        let weights = ring.weights(&PIXELS).unwrap();
        let area = f64::from(weights.sum()) * PIXELS.pixel_mrad().powi(2);
        assert!((area / (PI * (50.0_f64.powi(2) - 20.0_f64.powi(2))) - 1.0).abs() < 2e-4, "{area}");
        let sectors = VirtualDetector::sectors("S=20-50:4@10").unwrap();
        let mut sum = Array2::zeros((64, 64));
        for (n, sector) in sectors.iter().enumerate() {
            assert_eq!(sector.name, format!("S_{n}"));
            let part = sector.weights(&PIXELS).unwrap();
            assert!((part.sum() / weights.sum() - 0.25).abs() < 1e-3);
            sum += &part;
        }
        assert!(sum.iter().zip(&weights).all(|(a, b)| (a - b).abs() < 1e-6));
        // +x: azimuth 0 lies in the last sector, which ends at 10 degrees.
        let last = sectors[3].weights(&PIXELS).unwrap();
        assert_eq!(last[[32, 32 + 17]], 1.0);
        // +y, which points down, lies in the first.
        let first = sectors[0].weights(&PIXELS).unwrap();
        assert_eq!(first[[32 + 17, 33]], 1.0);
    }

    #[test]
    fn impossible_detectors_are_refused_with_the_remedy() {
        let refused = |text: &str| {
            VirtualDetector::annulus(text).and_then(|d| d.weights(&PIXELS)).unwrap_err().to_string()
        };
        assert!(refused("68-200").contains("max_angle_mrad"));
        assert!(refused("H=20-10").contains("must exceed"));
        for bad in ["0-21", "0-21:1", "0-21:x", "0-21:4@north", "0-21:1000"] {
            assert!(VirtualDetector::sectors(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_centre_of_mass_is_the_mean_angle() {
        let mut pattern = Array2::zeros((64, 64));
        pattern[[32, 32]] = 1.0;
        assert_eq!(centre_of_mass_mrad(pattern.view(), &PIXELS), [0.0, 0.0]);
        pattern[[34, 32]] = 1.0;
        assert_eq!(centre_of_mass_mrad(pattern.view(), &PIXELS), [0.0, 2.0]);
        assert_eq!(centre_of_mass_mrad(Array2::zeros((64, 64)).view(), &PIXELS), [0.0, 0.0]);
    }

    /// The gradient of a known phase, integrated.
    #[test]
    fn integration_undoes_the_gradient() {
        let (rows, columns, step, wavelength) = (24, 40, [0.3, 0.25], 0.025);
        let phase = |y: usize, x: usize| {
            let (u, v) = (TAU * x as f64 / columns as f64, TAU * y as f64 / rows as f64);
            (0.4 * (2.0 * u).sin() + 0.7 * (v - u).cos()) as f32
        };
        let gradient = |y: usize, x: usize| {
            let (u, v) = (TAU * x as f64 / columns as f64, TAU * y as f64 / rows as f64);
            let (width, height) = (columns as f64 * step[0], rows as f64 * step[1]);
            let dx = (0.8 * (2.0 * u).cos() + 0.7 * (v - u).sin()) * TAU / width;
            let dy = -0.7 * (v - u).sin() * TAU / height;
            [dx, dy].map(|d| (1e3 * wavelength / TAU * d) as f32)
        };
        let image = |k: usize| Array2::from_shape_fn((rows, columns), |(y, x)| gradient(y, x)[k]);
        let found = integrated_centre_of_mass([&image(0), &image(1)], step, wavelength).unwrap();
        for ((y, x), v) in found.indexed_iter() {
            assert!((v - phase(y, x)).abs() < 1e-4, "{y} {x}: {v} {}", phase(y, x));
        }
    }
}
