//! The information of an image on a defect, from a finite number of phonon configurations.

use ndarray::{Array2, ArrayView2, Axis};

/// The information of one detector's image on a defect, with its error.
///
/// The mean images of R configurations have scatter, and the square of their difference is too large by the variance of that scatter. The
/// sum over all pairs of different configurations has no such bias: D = sum over pixels of A / m * [(sum d)^2 - sum d^2] / (R (R - 1)),
/// with the difference d of each configuration, the mean m of the images, and the area A of a pixel. The error is the jackknife's over the
/// configurations (B. Efron and C. Stein, Ann. Stat. 9 (1981) 586).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DefectSignal {
    /// Squared d' for one electron per square Angstrom, without bias; it can be negative by chance.
    pub information: f64,
    /// Standard error of `information`.
    pub error: f64,
    /// The same with the bias.
    pub biased: f64,
    /// Change of the patch by the defect as a share of the patch.
    pub contrast: f64,
    /// Expected electrons of each pixel for a dose of one electron per square Angstrom, without and with the defect. The difference is
    /// scaled so that its squared d' is `information`.
    pub means: [Vec<f64>; 2],
}

impl DefectSignal {
    /// The information of the images without and with the defect, each (configuration, pixel) in fractions of the beam, with equal
    /// displacements in one configuration, and pixels of `area_angstrom2`.
    pub(crate) fn new(images: [ArrayView2<'_, f64>; 2], area_angstrom2: f64) -> Self {
        let mean = |image: ArrayView2<'_, f64>| {
            image.sum_axis(Axis(0)).mapv(|sum| sum / image.nrows() as f64).to_vec()
        };
        let [without, with] = [mean(images[0]), mean(images[1])];
        let middle: Vec<f64> = without.iter().zip(&with).map(|(a, b)| 0.5 * (a + b)).collect();
        let differences = &images[1] - &images[0];
        let (information, error) = unbiased(&differences, &middle, area_angstrom2);
        let pairs = without.iter().zip(&with).zip(&middle);
        let biased: f64 = pairs
            .filter(|(_, m)| **m > 0.0)
            .map(|((a, b), m)| area_angstrom2 * (b - a) * (b - a) / m)
            .sum();
        let scale = if biased > 0.0 { (information.max(0.0) / biased).sqrt() } else { 0.0 };
        let total: f64 = without.iter().sum();
        let contrast = (with.iter().sum::<f64>() - total) / total.max(f64::MIN_POSITIVE);
        let scaled = without.iter().zip(&with).map(|(a, b)| area_angstrom2 * (a + scale * (b - a)));
        let scaled = scaled.collect();
        let without = without.iter().map(|a| area_angstrom2 * a).collect();
        DefectSignal { information, error, biased, contrast, means: [without, scaled] }
    }
}

/// The information without bias, and its error, from differences (configuration, pixel).
fn unbiased(differences: &Array2<f64>, middle: &[f64], area: f64) -> (f64, f64) {
    let count = differences.nrows() as f64;
    let sums = differences.sum_axis(Axis(0));
    let squares = differences.mapv(|d| d * d).sum_axis(Axis(0));
    let bright = |n: &usize| middle[*n] > 0.0;
    let of = |left_out: Option<usize>| -> f64 {
        let one = |n: usize| {
            let gone = left_out.map_or(0.0, |r| differences[[r, n]]);
            let sum = sums[n] - gone;
            (sum * sum - (squares[n] - gone * gone)) / middle[n]
        };
        let kept = count - if left_out.is_some() { 1.0 } else { 0.0 };
        area * (0..middle.len()).filter(bright).map(one).sum::<f64>() / (kept * (kept - 1.0))
    };
    let without_one: Vec<f64> = (0..differences.nrows()).map(|r| of(Some(r))).collect();
    let mean = without_one.iter().sum::<f64>() / count;
    let variance: f64 = without_one.iter().map(|v| (v - mean) * (v - mean)).sum();
    (of(None), ((count - 1.0) / count * variance).sqrt())
}

/// The annulus of whole rings with the most information: the first ring, the ring after the last, and the signal. The images of each ring
/// are (configuration, pixel). Annuli are at least one ring wide; `None` without rings.
pub(crate) fn best_annulus(
    rings: &[[Array2<f64>; 2]],
    area_angstrom2: f64,
) -> Option<(usize, usize, DefectSignal)> {
    let mut best: Option<(usize, usize, DefectSignal)> = None;
    for first in 0..rings.len() {
        let mut sums = rings[first].clone();
        for end in first + 1..=rings.len() {
            if end > first + 1 {
                sums.iter_mut().zip(&rings[end - 1]).for_each(|(sum, ring)| *sum += ring);
            }
            let signal = DefectSignal::new([sums[0].view(), sums[1].view()], area_angstrom2);
            if best.as_ref().is_none_or(|(_, _, known)| signal.information > known.information) {
                best = Some((first, end, signal));
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, normal3};

    /// Images of 40 pixels in `count` configurations with scatter, and a defect that changes each pixel by `change`.
    fn images(count: usize, change: f64, seed: u64) -> [Array2<f64>; 2] {
        let noise = |r: usize, n: usize, k: usize| {
            normal3(seed, Purpose::Detectability, r as u32, n as u64)[k]
        };
        let without = Array2::from_shape_fn((count, 40), |(r, n)| 0.05 + 2e-3 * noise(r, n, 0));
        let with = Array2::from_shape_fn((count, 40), |(r, n)| {
            without[[r, n]] + change + 4e-4 * noise(r, n, 1)
        });
        [without, with]
    }

    #[test]
    fn the_bias_of_few_configurations_is_gone() {
        for change in [0.0, 1e-4] {
            let (mut sum, mut biased, mut errors) = (0.0, 0.0, 0.0);
            let trials = 200;
            for seed in 0..trials {
                let images = images(16, change, seed);
                let found = DefectSignal::new([images[0].view(), images[1].view()], 0.04);
                sum += found.information / trials as f64;
                biased += found.biased / trials as f64;
                errors += found.error / trials as f64;
            }
            let true_value = 0.04 * 40.0 * change * change / 0.05;
            let bias = 0.04 * 40.0 * 1.6e-7 / 16.0 / 0.05;
            assert!((sum - true_value).abs() < 4.0 * errors / (trials as f64).sqrt(), "{sum}");
            assert!((biased - true_value - bias).abs() < 0.2 * bias, "{biased} {bias}");
        }
    }

    #[test]
    fn a_defect_without_effect_has_no_information() {
        let [image, _] = images(16, 0.0, 1);
        let found = DefectSignal::new([image.view(), image.view()], 0.04);
        assert_eq!((found.information, found.error, found.contrast), (0.0, 0.0, 0.0));
        assert_eq!(found.means[0], found.means[1]);
    }

    #[test]
    fn the_best_annulus_leaves_out_what_does_not_change() {
        let rings: Vec<_> = [0.0, 2e-3, 2e-3, 0.0].iter().map(|c| images(16, *c, 5)).collect();
        let (first, end, _) = best_annulus(&rings, 0.04).unwrap();
        assert_eq!((first, end), (1, 3));
        assert!(best_annulus(&[], 0.04).is_none());
    }
}
