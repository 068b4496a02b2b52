//! The likelihood-ratio test of two known images whose electrons are counted by Poisson's law.

use super::roc::{TestPower, average_precision, normal_quantile, roc_alarms, thresholds};
use crate::specimen::wave::normal_cdf;

/// Pixels whose mean is below this share of the brightest count as this bright, so that logarithms are finite.
const DARKEST: f64 = 1e-12;
/// Information per dose, relative to all counted electrons, below which the images are equal but for rounding.
const NO_INFORMATION: f64 = 1e-20;
/// Saddle points at which the tail formula is replaced by its limit.
const AT_MEAN: f64 = 1e-4;
/// Largest exponent of a saddle point.
const MOST_EXPONENT: f64 = 300.0;
/// Counted electrons below which average precisions assume normal distributions.
const FEW_ELECTRONS: f64 = 3.0;
/// Largest relative error of a share of false alarms at its saddle point.
const MISSED: f64 = 0.02;
/// Bisections of a saddle point or of a dose.
const BISECTIONS: usize = 60;

/// The likelihood-ratio test of two images.
///
/// The statistic is sum n log(m1 / m0) over the pixels, with counts n and means m0, m1. Its cumulants are known in closed form, and
/// probabilities follow by the saddle-point formula (R. Lugannani and S. Rice, Adv. Appl. Prob. 12 (1980) 475), which holds for skew
/// distributions too. It fails where so few electrons are counted that the statistic has few values. If a patch without any electron is
/// more frequent than the false alarms, and the defect dims the patch, the test reports a share of these patches (exact if no pixel
/// brightens). In other cases of this kind, and for average precisions below three counted electrons, the normal approximation is used.
#[derive(Debug, Clone)]
pub(crate) struct PoissonTest {
    /// Expected electrons of each pixel per electron per square Angstrom, without the defect.
    mean: Vec<f64>,
    /// log(m1 / m0) of each pixel.
    log_ratio: Vec<f64>,
    /// Squared d' per dose.
    information: f64,
}

impl PoissonTest {
    /// The test of two images: expected electrons of each pixel for a dose of one electron per square Angstrom, without and with the defect.
    pub(crate) fn new(without: &[f64], with: &[f64]) -> Self {
        let brightest = without.iter().chain(with).copied().fold(0.0, f64::max);
        let least = (DARKEST * brightest).max(f64::MIN_POSITIVE);
        let mean: Vec<f64> = without.iter().map(|m| m.max(least)).collect();
        let log_ratio =
            mean.iter().zip(with).map(|(m, w)| libm::log(w.max(least) / m)).collect::<Vec<_>>();
        let information = mean.iter().zip(&log_ratio).map(|(m, a)| {
            let difference = m * libm::expm1(*a);
            difference * difference / (m + 0.5 * difference)
        });
        PoissonTest { information: information.sum(), mean, log_ratio }
    }

    /// Whether the two images are equal but for rounding.
    pub(crate) fn is_blind(&self) -> bool {
        self.information <= NO_INFORMATION * self.mean.iter().sum::<f64>()
    }

    /// The cumulant generating function per dose under hypothesis 0 at `s`, and its first three derivatives. Under hypothesis 1 it is
    /// the function at s + 1.
    fn cumulants(&self, s: f64) -> [f64; 4] {
        let mut sums = [0.0; 4];
        for (m, a) in self.mean.iter().zip(&self.log_ratio) {
            let (excess, difference) = (libm::expm1(s * a), libm::expm1(*a));
            sums[0] += m * (excess - s * difference);
            sums[1] += m * (a * (excess + 1.0) - difference);
            sums[2] += m * a * a * (excess + 1.0);
            sums[3] += m * a * a * a * (excess + 1.0);
        }
        sums
    }

    /// The probabilities that the statistic exceeds its value at the saddle point `s`, under hypothesis 0 and 1.
    fn tails(&self, s: f64, dose: f64) -> [f64; 2] {
        let cumulants = self.cumulants(s);
        [0.0, 1.0].map(|shift| {
            let u = s - shift;
            let exponent = dose * (u * cumulants[1] - cumulants[0]);
            let width = (dose * cumulants[2]).sqrt();
            tail([u, exponent, width], dose * cumulants[3])
        })
    }

    /// The saddle point at which the share of false alarms is `alarms`.
    fn threshold(&self, dose: f64, alarms: f64) -> f64 {
        let steepest = self.log_ratio.iter().map(|a| a.abs()).fold(0.0, f64::max);
        let most = MOST_EXPONENT / steepest.max(f64::MIN_POSITIVE);
        let d_prime = (dose * self.information).sqrt();
        let (mut low, mut high) = (-(40.0 / d_prime).min(most), (40.0 / d_prime).min(most));
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match self.tails(middle, dose)[0] > alarms {
                true => low = middle,
                false => high = middle,
            }
        }
        0.5 * (low + high)
    }

    /// The share of the defects that are found at a dose (electrons per square Angstrom) and a share of false alarms.
    pub(crate) fn power(&self, dose: f64, alarms: f64) -> f64 {
        if self.is_blind() || dose <= 0.0 {
            return alarms;
        }
        let electrons = self.electrons(dose);
        let changes = self.mean.iter().zip(&self.log_ratio).map(|(m, a)| m * libm::expm1(*a));
        let dimmed = -dose * changes.sum::<f64>();
        if dimmed > 0.0 && libm::exp(-electrons) >= alarms {
            return (alarms * libm::exp(dimmed)).min(1.0);
        }
        let [reached, found] = self.tails(self.threshold(dose, alarms), dose);
        match (reached - alarms).abs() <= MISSED * alarms {
            true => found.max(alarms),
            false => normal_cdf((dose * self.information).sqrt() + normal_quantile(alarms)),
        }
    }

    /// Counted electrons at a dose, without the defect.
    fn electrons(&self, dose: f64) -> f64 {
        dose * self.mean.iter().sum::<f64>()
    }

    /// The area below the ROC curve at a dose.
    pub(crate) fn auc(&self, dose: f64) -> f64 {
        if self.is_blind() || dose <= 0.0 {
            return 0.5;
        }
        // The difference of two independent statistics has a symmetric distribution; its saddle point at 0 is -1/2.
        let [value, _, second, _] = self.cumulants(0.5);
        tail([-0.5, -2.0 * dose * value, (2.0 * dose * second).sqrt()], 0.0)
    }

    /// The test at a dose, a share of false alarms, and a share `rate` of columns with the defect.
    pub(crate) fn at(&self, dose: f64, alarms: f64, rate: f64) -> TestPower {
        if self.is_blind() || dose <= 0.0 {
            return TestPower::guess(alarms, rate);
        }
        let d_prime = (dose * self.information).sqrt();
        let precision = match self.electrons(dose) < FEW_ELECTRONS {
            true => TestPower::normal(d_prime, alarms, rate).average_precision,
            false => average_precision(rate, thresholds(d_prime).map(|s| self.tails(s, dose))),
        };
        TestPower {
            d_prime,
            auc: self.auc(dose),
            power: self.power(dose, alarms),
            average_precision: precision,
            roc: roc_alarms().map(|share| [share, self.power(dose, share)]).collect(),
        }
    }

    /// The dose (electrons per square Angstrom) at which the share `power` of the defects is found at a share of false alarms; `None` if
    /// the images are equal.
    pub(crate) fn needed_dose(&self, power: f64, alarms: f64) -> Option<f64> {
        if self.is_blind() {
            return None;
        }
        let distance = normal_quantile(power) - normal_quantile(alarms);
        let normal = distance.max(0.1).powi(2) / self.information;
        let (mut low, mut high) = ((normal / 64.0).ln(), (normal * 64.0).ln());
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match self.power(middle.exp(), alarms) < power {
                true => low = middle,
                false => high = middle,
            }
        }
        Some((0.5 * (low + high)).exp())
    }
}

/// The formula of Lugannani and Rice at a saddle point `u`, with the exponent u x - K(u), the root of K''(u) and K'''(u).
fn tail([u, exponent, width]: [f64; 3], third: f64) -> f64 {
    let w = (2.0 * exponent.max(0.0)).sqrt().copysign(u);
    let v = u * width;
    let density = libm::exp(-0.5 * w * w) / (2.0 * std::f64::consts::PI).sqrt();
    let correction = match v.abs() < AT_MEAN || w == 0.0 {
        true => -third / (6.0 * width * width * width),
        false => 1.0 / v - 1.0 / w,
    };
    (normal_cdf(-w) + density * correction).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{ItemRng, Purpose};
    use rand_distr::{Distribution, Poisson};

    /// A column of 0.02 of the beam on a background, with a defect that takes `share` of it.
    fn images(share: f64) -> [Vec<f64>; 2] {
        let place = |n: usize| [(n % 9) as f64 - 4.0, (n / 9) as f64 - 4.0];
        let column = |n: usize| 0.02 * (-(place(n)[0].powi(2) + place(n)[1].powi(2)) / 8.0).exp();
        let without: Vec<f64> = (0..81).map(|n| 0.04 * (0.01 + column(n))).collect();
        let with = (0..81).map(|n| without[n] - 0.04 * share * column(n)).collect();
        [without, with]
    }

    /// Counts the errors of the likelihood-ratio test in simulated experiments: (false alarms, found, area below the ROC curve).
    fn counted(images: &[Vec<f64>; 2], dose: f64, alarms: f64, trials: u64) -> TestPower {
        let weights: Vec<f64> =
            images[0].iter().zip(&images[1]).map(|(a, b)| (b / a).ln()).collect();
        let score = |hypothesis: usize, trial: u64| -> f64 {
            let item = 2 * trial + hypothesis as u64;
            let mut rng = ItemRng::new(11, Purpose::Detectability, item);
            let one = |(m, w): (&f64, &f64)| w * Poisson::new(m * dose).unwrap().sample(&mut rng);
            images[hypothesis].iter().zip(&weights).map(one).sum()
        };
        let scores = [0, 1].map(|h| (0..trials).map(|trial| score(h, trial)).collect());
        TestPower::of_scores(scores, alarms, 0.5)
    }

    #[test]
    fn power_and_area_agree_with_counted_errors() {
        // From one where few electrons are counted to one where the counts are nearly normal.
        for (share, dose) in [(0.8, 1.5e2), (0.4, 8e2), (0.1, 2e4), (0.02, 3e5)] {
            let images = images(share);
            let test = PoissonTest::new(&images[0], &images[1]);
            let trials = 20_000;
            let found = counted(&images, dose, 0.01, trials);
            let said = test.at(dose, 0.01, 0.5);
            // The threshold is set by 200 false alarms, an error of 0.026 standard deviations; five errors are allowed.
            let density = 0.4 * 0.026;
            let error = (said.power * (1.0 - said.power) / trials as f64).sqrt().hypot(density);
            assert!((found.power - said.power).abs() < 5.0 * error, "{found:?}\n{said:?}");
            assert!((found.auc - said.auc).abs() < 0.01, "{found:?}\n{said:?}");
            let precisions = (found.average_precision, said.average_precision);
            assert!((precisions.0 - precisions.1).abs() < 0.01, "{precisions:?}");
        }
    }

    #[test]
    fn power_rises_with_the_dose_from_the_false_alarms_on() {
        for share in [0.02, 0.4, 0.9, -0.5, -3.0] {
            let images = images(share);
            let test = PoissonTest::new(&images[0], &images[1]);
            let doses = (0..60).map(|n| 10f64.powf(f64::from(n) * 0.1 - 1.0));
            let powers: Vec<f64> = doses.map(|dose| test.power(dose, 0.01)).collect();
            assert!((powers[0] - 0.01).abs() < 2e-3, "{share}: {powers:?}");
            // Approximations of different kinds meet, so a step down of a hundredth is allowed.
            assert!(powers.windows(2).all(|p| p[1] > p[0] - 0.01), "{share}: {powers:?}");
        }
    }

    #[test]
    fn small_differences_have_the_normal_limit() {
        let images = images(1e-4);
        let test = PoissonTest::new(&images[0], &images[1]);
        let sum = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2) / (0.5 * (a + b))).sum()
        };
        assert!((test.information / sum(&images[0], &images[1]) - 1.0).abs() < 1e-6);
        let dose = test.needed_dose(0.9, 0.01).unwrap();
        // d' = z(0.99) + z(0.9) = 2.3263 + 1.2816.
        assert!((dose * test.information / 3.607_899_4f64.powi(2) - 1.0).abs() < 1e-3);
        let at = test.at(dose, 0.01, 0.1);
        let normal = TestPower::normal(at.d_prime, 0.01, 0.1);
        for (one, other) in [
            (at.power, normal.power),
            (at.auc, normal.auc),
            (at.average_precision, normal.average_precision),
        ] {
            assert!((one - other).abs() < 1e-3, "{at:?} {normal:?}");
        }
    }

    #[test]
    fn information_grows_with_the_dose_and_nothing_gives_nothing() {
        let images = images(0.1);
        let test = PoissonTest::new(&images[0], &images[1]);
        let d = |dose: f64| test.at(dose, 0.01, 0.5).d_prime;
        assert!((d(4e4) / d(1e4) - 2.0).abs() < 1e-12);
        let blind = PoissonTest::new(&images[0], &images[0]);
        let at = blind.at(1e9, 0.01, 0.3);
        assert_eq!((at.d_prime, at.auc, at.power, at.average_precision), (0.0, 0.5, 0.01, 0.3));
        assert_eq!(blind.needed_dose(0.9, 0.01), None);
    }
}
