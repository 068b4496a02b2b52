//! Poisson noise of a finite dose.

use ndarray::Array2;
use rand_distr::{Distribution, Poisson};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::recipe::Recipe;
use crate::rng::{ItemRng, Purpose, item_of_detector, normal3};

/// Draws the counted electrons of each pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Noise {
    /// Seed of the world.
    pub seed: u64,
    /// Electrons that fall on one pixel: dose times pixel area.
    pub electrons_per_pixel: f64,
    /// Row and column of pixel (0, 0) in the full field.
    pub origin_px: [usize; 2],
    /// Width of the full field in pixels.
    pub full_width_px: usize,
    /// Number of the detector. Each detector draws its own random numbers.
    pub detector: u16,
}

/// Number of the draws of mean angles; electrons have 0.
const DEFLECTIONS: u32 = 1;

/// Largest number of electrons per pixel. Counts are 32-bit numbers, and some pixels of a plane wave get several times the mean.
pub(crate) const MOST_ELECTRONS_PER_PIXEL: f64 = 1e9;

/// Refuses a dose, in electrons per square Angstrom, whose electrons per pixel of `area_angstrom2` cannot be counted.
///
/// # Errors
/// [`Error::Invalid`], with the greatest possible dose.
pub(crate) fn check_countable(dose: f64, area_angstrom2: f64) -> Result<()> {
    // The comparison is not `> most`, so that NaN is refused too.
    if dose * area_angstrom2 <= MOST_ELECTRONS_PER_PIXEL {
        return Ok(());
    }
    let expected = format!(
        "{:.3e} electrons on a pixel of {area_angstrom2:.3e} square Angstrom are more than can be counted; expected at most \
         {:.2e} electrons per square Angstrom",
        dose * area_angstrom2,
        MOST_ELECTRONS_PER_PIXEL / area_angstrom2
    );
    Err(Error::invalid(crate::Setting::Dose, format!("{dose:e}"), expected))
}

impl Noise {
    /// Noise of an image at a dose in electrons per square Angstrom. Pixel (0, 0) of the image is pixel `first` (row, column) of the full
    /// field.
    pub(crate) fn new(recipe: &Recipe, dose: f64, first: [usize; 2]) -> Self {
        let field = &recipe.field;
        let pixel_angstrom = field.pixel_angstrom();
        Noise {
            seed: recipe.seed,
            electrons_per_pixel: dose * pixel_angstrom * pixel_angstrom,
            origin_px: first,
            full_width_px: field.pixels(field.grid)[1],
            detector: 0,
        }
    }

    /// Noise on another detector of the recipe; 0 is the main one.
    #[must_use]
    pub(crate) fn of_detector(self, detector: u16) -> Self {
        Noise { detector, ..self }
    }

    /// Counts the electrons of an image of fractions of the beam; both arrays are [row, column]. Counts are limited to 32 bits.
    pub(crate) fn counted(&self, image: &Array2<f32>) -> Array2<u32> {
        let mut counts = Array2::zeros(image.dim());
        let lines: Vec<_> = counts.outer_iter_mut().zip(image.outer_iter()).collect();
        lines.into_par_iter().enumerate().for_each(|(row, (mut to, from))| {
            let start = self.place(row);
            for (column, (to, from)) in to.iter_mut().zip(from).enumerate() {
                let expected = f64::from(*from) * self.electrons_per_pixel;
                *to = self.draw(expected, start + column as u64) as u32;
            }
        });
        counts
    }

    /// Number of a row's first pixel in the full field.
    fn place(&self, row: usize) -> u64 {
        ((self.origin_px[0] + row) * self.full_width_px + self.origin_px[1]) as u64
    }

    /// Replaces fractions of the beam by counted electrons divided by the mean electrons of a pixel. The random numbers of a pixel depend
    /// on the seed and its place in the full field only.
    pub(crate) fn apply(&self, band: &mut Array2<f32>, first_row: usize) {
        let lines: Vec<_> = band.outer_iter_mut().collect();
        lines.into_par_iter().enumerate().for_each(|(k, mut line)| {
            let start = self.place(first_row + k);
            for (column, value) in line.iter_mut().enumerate() {
                let expected = f64::from(*value) * self.electrons_per_pixel;
                let counted = self.draw(expected, start + column as u64);
                *value = (counted / self.electrons_per_pixel) as f32;
            }
        });
    }

    /// Gives the mean angles of a centre of mass, one for each pixel, the scatter of the counted electrons: `electrons` are their fraction of
    /// the beam and `deviation` the standard deviation of the angle of one of them. The electrons are those that [`Noise::counted`] draws;
    /// their mean angle is drawn from a normal distribution. A pixel without electrons has the angle 0.
    pub(crate) fn deflect(
        &self,
        band: &mut Array2<f32>,
        first_row: usize,
        (electrons, deviation): (&Array2<f32>, &Array2<f32>),
        axis: usize,
    ) {
        let lines = band.outer_iter_mut().zip(electrons.outer_iter()).zip(deviation.outer_iter());
        let lines: Vec<_> = lines.collect();
        lines.into_par_iter().enumerate().for_each(|(k, ((mut line, electrons), deviation))| {
            let start = self.place(first_row + k);
            let pixels = line.iter_mut().zip(electrons).zip(deviation).enumerate();
            for (column, ((value, electrons), deviation)) in pixels {
                let pixel = start + column as u64;
                let counted =
                    self.draw(f64::from(*electrons) * self.electrons_per_pixel, pixel).floor();
                let item = self.item(pixel);
                let normal = normal3(self.seed, Purpose::Dose, DEFLECTIONS, item)[axis];
                *value = match counted >= 1.0 {
                    true => {
                        let scatter = f64::from(*deviation) * normal / counted.sqrt();
                        (f64::from(*value) + scatter) as f32
                    }
                    false => 0.0,
                };
            }
        });
    }

    /// Number of the random numbers of a pixel.
    fn item(&self, pixel: u64) -> u64 {
        item_of_detector(pixel, self.detector)
    }

    fn draw(&self, expected: f64, pixel: u64) -> f64 {
        match Poisson::new(expected) {
            Ok(poisson) => {
                poisson.sample(&mut ItemRng::new(self.seed, Purpose::Dose, self.item(pixel)))
            }
            // Too many electrons for the distribution: their scatter is less than a part in a billion.
            Err(_) if expected > 0.0 => expected,
            // No electrons.
            Err(_) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_are_those_of_poisson() {
        for expected in [0.3, 4.0, 400.0] {
            let noise = Noise {
                seed: 5,
                electrons_per_pixel: 1000.0,
                origin_px: [3, 7],
                full_width_px: 900,
                detector: 0,
            };
            let mut band = Array2::from_elem((200, 500), (expected / 1000.0) as f32);
            noise.apply(&mut band, 11);
            let n = band.len() as f64;
            let counts = band.mapv(|v| f64::from(v) * 1000.0);
            let mean = counts.sum() / n;
            let variance = counts.mapv(|c| (c - mean) * (c - mean)).sum() / n;
            assert!((mean - expected).abs() < 4.0 * (expected / n).sqrt(), "{mean} {expected}");
            assert!((variance / expected - 1.0).abs() < 0.03, "{variance} {expected}");
        }
    }

    /// The variance of a mean angle is the variance of one electron over their number.
    #[test]
    fn mean_angles_scatter_as_counted_electrons() {
        let noise = Noise {
            seed: 5,
            electrons_per_pixel: 400.0,
            origin_px: [0, 0],
            full_width_px: 300,
            detector: 2,
        };
        let shape = (200, 300);
        let (electrons, deviation) =
            (Array2::from_elem(shape, 0.25_f32), Array2::from_elem(shape, 10.0));
        let drawn = |axis: usize| {
            let mut band = Array2::from_elem(shape, 3.0_f32);
            noise.deflect(&mut band, 0, (&electrons, &deviation), axis);
            band.mapv(f64::from)
        };
        let counts = noise.counted(&electrons).mapv(f64::from);
        let n = counts.len() as f64;
        // Each deviation in units of its own standard deviation.
        let normal = |axis: usize| (drawn(axis) - 3.0) / 10.0 * counts.mapv(f64::sqrt);
        let (x, y) = (normal(0), normal(1));
        for v in [&x, &y] {
            assert!(v.sum().abs() < 4.0 * n.sqrt(), "{}", v.sum());
            let variance = (v * v).sum() / n;
            assert!((variance - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{variance}");
        }
        assert!((&x * &y).sum().abs() < 4.0 * n.sqrt());
        let mut none = Array2::from_elem((2, 3), 3.0);
        noise.deflect(&mut none, 0, (&Array2::zeros((2, 3)), &Array2::ones((2, 3))), 0);
        assert_eq!(none, Array2::<f32>::zeros((2, 3)));
    }

    #[test]
    fn a_band_has_the_noise_of_the_whole() {
        let noise = Noise {
            seed: 5,
            electrons_per_pixel: 50.0,
            origin_px: [0, 0],
            full_width_px: 40,
            detector: 0,
        };
        let mut whole = Array2::from_elem((20, 40), 0.1f32);
        noise.apply(&mut whole, 0);
        let part = Noise { origin_px: [0, 6], ..noise };
        let mut band = Array2::from_elem((5, 30), 0.1f32);
        part.apply(&mut band, 8);
        assert_eq!(whole.slice(ndarray::s![8..13, 6..36]), band);
    }

    #[test]
    fn detectors_draw_numbers_of_their_own() {
        let noise = Noise {
            seed: 5,
            electrons_per_pixel: 400.0,
            origin_px: [0, 0],
            full_width_px: 300,
            detector: 0,
        };
        let image = Array2::from_elem((200, 300), 0.25f32);
        let counts = |n: u16| noise.of_detector(n).counted(&image).mapv(|v| f64::from(v) - 100.0);
        let (a, b, c) = (counts(0), counts(1), counts(2));
        assert_eq!(a, noise.counted(&image).mapv(|v| f64::from(v) - 100.0));
        let n = a.len() as f64;
        for (a, b) in [(&a, &b), (&b, &c), (&a, &c)] {
            let covariance = (a * b).sum() / n;
            // The covariance of independent counts scatters by their variance, 100, over the square root of the number of pixels. Four
            // times that is allowed.
            assert!(covariance.abs() < 4.0 * 100.0 / n.sqrt(), "{covariance}");
        }
    }
}
