//! The linear (Hotelling) observer, for worlds whose images average few phonon configurations.

use nalgebra::{DMatrix, DVector};
use ndarray::{ArrayView2, Axis, s};

/// d' of the linear observer at a dose in electrons per square Angstrom, for images that are means over `averaged` configurations.
///
/// The weights are the inverse of the covariance of phonons and counts, applied to the difference (H. H. Barrett et al., Proc. Natl. Acad.
/// Sci. 90 (1993) 9758). They come from one half of the configurations and are judged by the other, then the halves change places. With few
/// configurations the result is therefore too low rather than too high. The images without and with the defect are (configuration, pixel)
/// in fractions of the beam.
pub fn linear_d_prime(
    images: [ArrayView2<'_, f64>; 2],
    area_angstrom2: f64,
    averaged: usize,
    dose: f64,
) -> f64 {
    let half = images[0].nrows() / 2;
    let parts = |image: ArrayView2<'_, f64>| {
        let (first, second) = (image.slice(s![..half, ..]), image.slice(s![half..2 * half, ..]));
        [first.to_owned(), second.to_owned()]
    };
    let [without, with] = images.map(parts);
    let moments = |k: usize| Moments::new([without[k].view(), with[k].view()], averaged);
    let halves = [moments(0), moments(1)];
    let electrons = dose * area_angstrom2;
    let judged = |one: &Moments, other: &Moments| {
        let weights = one.weights(electrons);
        let signal = weights.dot(&other.difference);
        signal / other.variance(&weights, electrons).sqrt()
    };
    let mean = 0.5 * (judged(&halves[0], &halves[1]) + judged(&halves[1], &halves[0]));
    if mean.is_finite() { mean.max(0.0) } else { 0.0 }
}

/// Mean difference, mean image, and covariance of phonons from one half of the configurations.
struct Moments {
    difference: DVector<f64>,
    mean: DVector<f64>,
    /// Covariance of images that average some configurations, over both hypotheses.
    phonons: DMatrix<f64>,
}

impl Moments {
    fn new(images: [ArrayView2<'_, f64>; 2], averaged: usize) -> Self {
        let (count, pixels) = images[0].dim();
        let means = images.map(|image| image.sum_axis(Axis(0)) / count as f64);
        let mut phonons = DMatrix::zeros(pixels, pixels);
        for (image, mean) in images.iter().zip(&means) {
            for row in image.rows() {
                let off = DVector::from_iterator(pixels, row.iter().zip(mean).map(|(v, m)| v - m));
                phonons.ger(1.0, &off, &off, 1.0);
            }
        }
        phonons /= 2.0 * (count.max(2) - 1) as f64 * averaged as f64;
        let vector = |values: Vec<f64>| DVector::from_vec(values);
        Moments {
            difference: vector((&means[1] - &means[0]).to_vec()),
            mean: vector((0.5 * (&means[0] + &means[1])).to_vec()),
            phonons,
        }
    }

    fn weights(&self, electrons: f64) -> DVector<f64> {
        let mut covariance = self.phonons.clone();
        for (n, mean) in self.mean.iter().enumerate() {
            covariance[(n, n)] += mean.max(f64::MIN_POSITIVE) / electrons;
        }
        let factored = covariance.cholesky();
        factored.map_or_else(|| self.difference.clone(), |c| c.solve(&self.difference))
    }

    fn variance(&self, weights: &DVector<f64>, electrons: f64) -> f64 {
        let counts: f64 =
            weights.iter().zip(self.mean.iter()).map(|(w, m)| w * w * m / electrons).sum();
        counts + weights.dot(&(&self.phonons * weights))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, normal3};
    use ndarray::Array2;

    /// Images whose brightness scatters as a whole, with a defect in one pixel, or in all pixels alike.
    fn images(configurations: usize, everywhere: bool) -> [Array2<f64>; 2] {
        let without = Array2::from_shape_fn((configurations, 12), |(r, n)| {
            let scatter = normal3(2, Purpose::Detectability, r as u32, 0)[0];
            0.05 * (1.0 + 0.02 * scatter) * (1.0 + 0.1 * n as f64)
        });
        let change =
            |n: usize| if everywhere || n == 4 { 5e-4 * (1.0 + 0.1 * n as f64) } else { 0.0 };
        let with =
            Array2::from_shape_fn((configurations, 12), |(r, n)| without[[r, n]] + change(n));
        [without, with]
    }

    #[test]
    fn counts_alone_give_the_known_image() {
        let images = images(64, false);
        let views = || [images[0].view(), images[1].view()];
        let (dose, area) = (1e4, 0.04);
        let found = linear_d_prime(views(), area, 1_000_000, dose);
        let mean = 0.05 * 1.4;
        let known = (dose * area * 7e-4 * 7e-4 / mean).sqrt();
        assert!((found / known - 1.0).abs() < 0.02, "{found} {known}");
    }

    #[test]
    fn scatter_like_the_defect_caps_the_dose() {
        let images = images(64, true);
        let views = || [images[0].view(), images[1].view()];
        let at = |dose: f64| linear_d_prime(views(), 0.04, 4, dose);
        // The defect is a change of 1 %, the scatter of a mean over 4 configurations is 1 %.
        assert!((at(1e9) - 1.0).abs() < 0.25, "{}", at(1e9));
        assert!((at(1e12) / at(1e9) - 1.0).abs() < 0.01);
        assert!(at(1e3) < at(1e5) && at(1e5) < at(1e9));
    }
}
