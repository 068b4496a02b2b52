//! The likelihood-ratio test of hypotheses with several possible images each, judged by simulated experiments.

use rand_distr::{Distribution, Poisson};
use rayon::prelude::*;

use super::roc::TestPower;
use crate::rng::{ItemRng, Purpose};

/// A test of two hypotheses, each a mixture of images with equal probabilities: depths of a defect, or phonon patterns.
///
/// The statistic is log mean exp(L1) - log mean exp(L0), with the log likelihoods L of the images. Its distribution has no closed form, so
/// experiments are simulated and errors counted. Each experiment draws its electrons from its own random numbers, which do not depend on
/// the dose.
#[derive(Debug, Clone)]
pub(crate) struct MixtureTest {
    /// Images that the test knows, for each hypothesis: expected electrons of each pixel for one electron per square Angstrom.
    pub known: [Vec<Vec<f64>>; 2],
    /// Images that make the data, for each hypothesis.
    pub data: [Vec<Vec<f64>>; 2],
    /// Number of simulated experiments of each hypothesis.
    pub experiments: usize,
    /// Seed of the electrons.
    pub seed: u64,
}

/// Logarithms and sum of an image.
struct KnownImage {
    logarithms: Vec<f64>,
    sum: f64,
}

impl KnownImage {
    fn new(image: &[f64]) -> Self {
        let logarithms = image.iter().map(|m| libm::log(m.max(f64::MIN_POSITIVE))).collect();
        KnownImage { logarithms, sum: image.iter().sum() }
    }
}

impl MixtureTest {
    /// The test at a dose (electrons per square Angstrom), a share of false alarms, and a share `rate` of columns with the defect.
    pub(crate) fn at(&self, dose: f64, alarms: f64, rate: f64) -> TestPower {
        let known = [0, 1]
            .map(|h| self.known[h].iter().map(|image| KnownImage::new(image)).collect::<Vec<_>>());
        let scores = [0, 1].map(|hypothesis| {
            let one = |experiment| self.score(hypothesis, experiment, dose, &known);
            (0..self.experiments).into_par_iter().map(one).collect::<Vec<f64>>()
        });
        TestPower::of_scores(scores, alarms, rate)
    }

    /// The statistic of one simulated experiment.
    fn score(
        &self,
        hypothesis: usize,
        experiment: usize,
        dose: f64,
        known: &[Vec<KnownImage>; 2],
    ) -> f64 {
        let of_data = &self.data[hypothesis];
        let image = &of_data[experiment % of_data.len()];
        let item = 2 * experiment as u64 + hypothesis as u64;
        let mut rng = ItemRng::new(self.seed, Purpose::Detectability, item);
        let mut draw = |mean: &f64| match Poisson::new(mean * dose) {
            Ok(poisson) => poisson.sample(&mut rng),
            Err(_) => mean * dose,
        };
        let counts: Vec<f64> = image.iter().map(&mut draw).collect();
        let log_mean = |images: &[KnownImage]| {
            let log = |image: &KnownImage| -> f64 {
                let sum: f64 = counts.iter().zip(&image.logarithms).map(|(n, l)| n * l).sum();
                sum - dose * image.sum
            };
            let all: Vec<f64> = images.iter().map(log).collect();
            let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let mean = all.iter().map(|l| libm::exp(l - most)).sum::<f64>() / all.len() as f64;
            most + libm::log(mean)
        };
        log_mean(&known[1]) - log_mean(&known[0])
    }

    /// The least dose at which the share `power` of the defects is found at a share of false alarms, with the doses between which it lies;
    /// searched from `from` in steps of a factor of 1.5 up to `to`. `None` if no dose of these suffices.
    pub(crate) fn needed_dose(
        &self,
        [from, to]: [f64; 2],
        power: f64,
        alarms: f64,
    ) -> Option<[f64; 3]> {
        let mut before: Option<[f64; 2]> = None;
        let mut dose = from;
        while dose <= to {
            let found = self.at(dose, alarms, 0.5).power;
            if found >= power {
                let Some([low, power_low]) = before else { return Some([dose, 0.0, dose]) };
                let part = (power - power_low) / (found - power_low);
                let between = low * libm::pow(dose / low, part);
                return Some([between, low, dose]);
            }
            before = Some([dose, found]);
            dose *= 1.5;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::poisson_test::PoissonTest;
    use super::*;

    fn images() -> [Vec<f64>; 2] {
        let without: Vec<f64> = (0..30).map(|n| 1e-3 * (1.0 + 0.1 * f64::from(n % 7))).collect();
        let with = without.iter().enumerate().map(|(n, m)| if n < 6 { 0.9 * m } else { *m });
        [without.clone(), with.collect()]
    }

    #[test]
    fn one_image_of_each_is_the_known_image() {
        let [without, with] = images();
        let known = PoissonTest::new(&without, &with);
        let all = [vec![without], vec![with]];
        let test = MixtureTest { known: all.clone(), data: all, experiments: 20_000, seed: 4 };
        let dose = known.needed_dose(0.5, 0.01).unwrap();
        let (counted, said) = (test.at(dose, 0.01, 0.3), known.at(dose, 0.01, 0.3));
        // 200 false alarms set the threshold, an error of 0.026 standard deviations.
        assert!((counted.power - said.power).abs() < 5.0 * 0.4 * 0.026, "{counted:?} {said:?}");
        assert!((counted.auc - said.auc).abs() < 0.01);
        let [needed, low, high] = test.needed_dose([dose / 4.0, 100.0 * dose], 0.9, 0.01).unwrap();
        let expected = known.needed_dose(0.9, 0.01).unwrap();
        assert!(low < needed && needed <= high);
        assert!((needed / expected - 1.0).abs() < 0.1, "{needed} {expected}");
    }

    #[test]
    fn an_unknown_place_costs_dose() {
        let [without, with] = images();
        let moved: Vec<f64> =
            without.iter().enumerate().map(|(n, m)| if n > 23 { 0.9 * m } else { *m }).collect();
        let dose = PoissonTest::new(&without, &with).needed_dose(0.9, 0.01).unwrap();
        let all = [vec![without], vec![with, moved]];
        let test = MixtureTest { known: all.clone(), data: all, experiments: 4000, seed: 4 };
        let found = test.at(dose, 0.01, 0.5);
        assert!(found.power < 0.88 && found.power > 0.6, "{found:?}");
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let [without, with] = images();
        let all = [vec![without], vec![with]];
        let test = MixtureTest { known: all.clone(), data: all, experiments: 300, seed: 4 };
        let with_threads = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| test.at(1e5, 0.01, 0.5))
        };
        assert_eq!(with_threads(1), with_threads(3));
    }
}
