//! Draws the electrons that an acquisition counts.

use ndarray::Array2;
use rand_distr::{Distribution, Poisson};

use crate::rng::{ItemRng, Purpose, words};

/// Up to this expected number a count is drawn by adding up probabilities; above it, by rejection.
const MOST_ADDED: f64 = 40.0;
/// Largest count that is tried; with [`MOST_ADDED`] expected electrons a greater count is less likely than 1e-40.
const MOST_TRIED: usize = 256;
/// 1 / n: a product is faster than a division.
const INVERSE: [f64; MOST_TRIED + 1] = {
    let mut inverse = [0.0; MOST_TRIED + 1];
    let mut n = 1;
    while n <= MOST_TRIED {
        inverse[n] = 1.0 / n as f64;
        n += 1;
    }
    inverse
};
/// The number of pixels of an image is below 2 to this power.
const PIXEL_BITS: u32 = 28;

/// Identifies an acquisition. Its random numbers depend on nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct AcquisitionKey {
    /// Seed of the episode.
    pub seed: u64,
    /// Number of the episode under this seed.
    pub episode: u32,
    /// Step of the episode.
    pub step: u32,
}

impl AcquisitionKey {
    fn item(&self, pixel: usize) -> u64 {
        u64::from(self.episode) << PIXEL_BITS | pixel as u64
    }

    /// Draws counts for an image [row, column] in fractions of the beam; each pixel receives `electrons_per_pixel` electrons. Returns the
    /// counts divided by that number, as fractions of the beam. Two pixels share the four random words of one item.
    pub(crate) fn counted(&self, clean: &Array2<f32>, electrons_per_pixel: f64) -> Array2<f32> {
        let mut image = clean.as_standard_layout().into_owned();
        let Some(pixels) = image.as_slice_mut() else { return image };
        for (n, pair) in pixels.chunks_mut(2).enumerate() {
            let random = words(self.seed, Purpose::Acquired, self.step, self.item(n));
            for (k, value) in pair.iter_mut().enumerate() {
                let expected = f64::from(*value) * electrons_per_pixel;
                let count = if expected <= MOST_ADDED {
                    inverted(expected, random[2 * k], random[2 * k + 1])
                } else {
                    self.rejected(expected, 2 * n + k)
                };
                *value = (count / electrons_per_pixel) as f32;
            }
        }
        image
    }

    /// Draws a count by rejection, with the random generator of the pixel.
    fn rejected(&self, expected: f64, pixel: usize) -> f64 {
        let seed = self.seed ^ u64::from(self.step).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Poisson::new(expected).map_or(0.0, |poisson| {
            poisson.sample(&mut ItemRng::new(seed, Purpose::Acquired, self.item(pixel)))
        })
    }
}

/// Returns the least count whose cumulative probability reaches a uniform number.
fn inverted(expected: f64, high: u32, low: u32) -> f64 {
    if expected.is_nan() || expected <= 0.0 {
        return 0.0;
    }
    let word = u64::from(high) << 21 ^ u64::from(low) >> 11;
    // A number in (0, 1), in steps of 2^-53.
    let uniform = (word as f64 + 0.5) / 9_007_199_254_740_992.0;
    let mut probability = libm::exp(-expected);
    let mut sum = probability;
    let mut count = 0;
    while sum < uniform && count < MOST_TRIED {
        count += 1;
        probability *= expected * INVERSE[count];
        sum += probability;
    }
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: AcquisitionKey = AcquisitionKey { seed: 3, episode: 1, step: 7 };

    /// The frequency of every count follows Poisson's law, on both sides of the limit between the two methods.
    #[test]
    fn counts_follow_poissons_law() {
        for expected in [0.05, 1.3, 9.0, 39.5, 41.0, 300.0] {
            let clean = Array2::from_elem((400, 500), (expected / 1000.0) as f32);
            let image = KEY.counted(&clean, 1000.0);
            let n = image.len() as f64;
            let mut observed = vec![0.0f64; 1024];
            image.iter().for_each(|v| observed[(f64::from(*v) * 1000.0).round() as usize] += 1.0);
            let log_probability =
                |k: usize| k as f64 * f64::ln(expected) - expected - libm::lgamma(k as f64 + 1.0);
            let (mut chi2, mut bins) = (0.0, 0.0);
            for (k, seen) in observed.iter().enumerate() {
                let mean = n * log_probability(k).exp();
                if mean >= 10.0 {
                    chi2 += (seen - mean).powi(2) / mean;
                    bins += 1.0;
                }
            }
            // Chi^2 has mean `bins` and twice that variance.
            assert!(
                (chi2 - bins).abs() < 5.0 * (2.0 * bins).sqrt() + 3.0,
                "{expected}: {chi2} {bins}"
            );
        }
    }

    #[test]
    fn counts_depend_on_the_acquisition_alone() {
        let clean = Array2::from_elem((64, 64), 0.02f32);
        let first = KEY.counted(&clean, 500.0);
        assert_eq!(first, KEY.counted(&clean, 500.0));
        for other in [
            AcquisitionKey { seed: 4, ..KEY },
            AcquisitionKey { episode: 2, ..KEY },
            AcquisitionKey { step: 8, ..KEY },
        ] {
            let b = other.counted(&clean, 500.0);
            let products = first.iter().zip(&b).map(|(a, b)| (a - 0.02) as f64 * (b - 0.02) as f64);
            let correlation = products.sum::<f64>() / 4096.0 / (0.02 / 500.0);
            assert!(correlation.abs() < 4.0 / 64.0, "{correlation}");
        }
    }

    #[test]
    fn nothing_is_counted_of_nothing() {
        let clean = ndarray::arr2(&[[0.0f32, -1.0, f32::NAN, 1e-30]]);
        assert!(KEY.counted(&clean, 1e4).iter().all(|v| *v == 0.0));
    }
}
