//! Measures of the difference of two images.

use ndarray::{Array2, ArrayView2};
use serde::Serialize;

/// The difference of an image from a reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// Largest absolute difference, divided by the largest value of the reference.
    pub largest: f64,
    /// Root mean square difference, divided by the mean of the reference.
    pub rms: f64,
    /// Mean of the image divided by the mean of the reference, less one.
    pub bias: f64,
    /// Correlation coefficient (Pearson); 1 where the images differ only in brightness and contrast.
    pub correlation: f64,
}

impl Difference {
    /// Compares images of the same shape.
    ///
    /// # Panics
    /// If their shapes differ.
    pub fn between(image: ArrayView2<f64>, reference: ArrayView2<f64>) -> Self {
        assert_eq!(image.dim(), reference.dim(), "images of the same shape");
        let n = reference.len() as f64;
        let pairs = || image.iter().zip(reference.iter());
        let (mean_a, mean_b) = (image.sum() / n, reference.sum() / n);
        let top = reference.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let square = pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / n;
        let spread = |a: f64, b: f64| (a - mean_a, b - mean_b);
        let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
        for (a, b) in pairs() {
            let (a, b) = spread(*a, *b);
            aa += a * a;
            bb += b * b;
            ab += a * b;
        }
        Difference {
            largest: pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / top,
            rms: square.sqrt() / mean_b.abs(),
            bias: mean_a / mean_b - 1.0,
            correlation: ab / (aa * bb).sqrt(),
        }
    }
}

/// Returns the factor that brings an image nearest to the reference of the same shape (least squares).
pub(crate) fn best_gain(image: ArrayView2<f64>, reference: ArrayView2<f64>) -> f64 {
    let product: f64 = image.iter().zip(&reference).map(|(a, b)| a * b).sum();
    product / image.iter().map(|a| a * a).sum::<f64>()
}

/// Extrapolates two grids to an infinitely fine one, if the error falls with the square of the pixel: `(r^2 fine - coarse) / (r^2 - 1)` for
/// pixels in the ratio `r`. All three images have one shape [row, column] = [y, x] and one unit. Panics where the shapes differ.
pub(crate) fn extrapolated(coarse: &Array2<f64>, fine: &Array2<f64>, ratio: f64) -> Array2<f64> {
    let square = ratio * ratio;
    (fine * square - coarse) / (square - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn differences_are_as_by_hand() {
        let reference = arr2(&[[1.0, 2.0], [3.0, 4.0]]);
        let image = arr2(&[[1.0, 2.0], [3.0, 4.4]]);
        let d = Difference::between(image.view(), reference.view());
        assert!((d.largest - 0.1).abs() < 1e-12 && (d.rms - 0.2 / 2.5).abs() < 1e-12, "{d:?}");
        assert!((d.bias - 0.04).abs() < 1e-12 && d.correlation < 1.0);
        let scaled = Difference::between((&reference * 3.0 + 1.0).view(), reference.view());
        assert!((scaled.correlation - 1.0).abs() < 1e-12);
        assert!((best_gain((&reference * 0.25).view(), reference.view()) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn an_error_of_second_order_is_extrapolated_away() {
        let at = |pixel: f64| arr2(&[[5.0 + 3.0 * pixel * pixel]]);
        assert!((extrapolated(&at(0.4), &at(0.1), 4.0)[(0, 0)] - 5.0).abs() < 1e-12);
    }
}
