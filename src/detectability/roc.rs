//! Power, area below the ROC curve, and average precision, from the two distributions of a test.

use serde::{Deserialize, Serialize};

use crate::specimen::wave::normal_cdf;

/// Shares of false alarms at which a ROC curve is reported.
const ROC_ALARMS: [f64; 8] = [1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.35, 0.5];
/// Thresholds of an average precision.
const THRESHOLDS: usize = 400;
/// Thresholds reach this many standard deviations beyond both means.
const BEYOND: f64 = 6.0;

/// How well a test separates the two hypotheses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TestPower {
    /// Distance of the two distributions in standard deviations. For tests that are not normal, sqrt(2) times the normal quantile of `auc`.
    pub d_prime: f64,
    /// Area below the ROC curve: the probability that a defect scores higher than a column without one.
    pub auc: f64,
    /// Share of the defects that are found at the asked share of false alarms.
    pub power: f64,
    /// Average precision if the asked share of the columns holds the defect.
    pub average_precision: f64,
    /// The ROC curve: (share of false alarms, share of found defects).
    pub roc: Vec<[f64; 2]>,
}

/// The shares of false alarms at which ROC curves are reported.
pub fn roc_alarms() -> impl Iterator<Item = f64> {
    ROC_ALARMS.into_iter()
}

/// The quantile of the standard normal distribution, by bisection to 1e-12.
pub(crate) fn normal_quantile(probability: f64) -> f64 {
    let (mut low, mut high) = (-38.0, 38.0);
    while high - low > 1e-12 {
        let middle = 0.5 * (low + high);
        match normal_cdf(middle) < probability {
            true => low = middle,
            false => high = middle,
        }
    }
    0.5 * (low + high)
}

/// Average precision where a share `rate` of the columns holds the defect, from points (share of false alarms, share of found defects)
/// by falling threshold.
pub fn average_precision(rate: f64, points: impl Iterator<Item = [f64; 2]>) -> f64 {
    let (mut area, mut before, mut precision) = (0.0, 0.0, None);
    for [alarms, found] in points {
        let all = rate * found + (1.0 - rate) * alarms;
        let now = if all > 0.0 { rate * found / all } else { 1.0 };
        area += (found - before) * 0.5 * (now + precision.unwrap_or(now));
        (before, precision) = (found, Some(now));
    }
    area + (1.0 - before) * rate
}

/// Offsets of thresholds from the mean of hypothesis 0 in units of the distance of the two means, by falling threshold.
pub fn thresholds(d_prime: f64) -> impl Iterator<Item = f64> {
    let (low, high) = (-BEYOND / d_prime, 1.0 + BEYOND / d_prime);
    (0..=THRESHOLDS).map(move |n| high + (low - high) * n as f64 / THRESHOLDS as f64)
}

impl TestPower {
    /// A test that guesses.
    pub(crate) fn guess(alarms: f64, rate: f64) -> Self {
        let roc = roc_alarms().map(|share| [share, share]).collect();
        TestPower { d_prime: 0.0, auc: 0.5, power: alarms, average_precision: rate, roc }
    }

    /// A test whose scores have two normal distributions of equal width, `d_prime` widths apart.
    pub(crate) fn normal(d_prime: f64, alarms: f64, rate: f64) -> Self {
        if d_prime.is_nan() || d_prime <= 1e-6 {
            return Self::guess(alarms, rate);
        }
        let power = |share: f64| normal_cdf(d_prime + normal_quantile(share));
        let point = |u: f64| [normal_cdf(-u * d_prime), normal_cdf((1.0 - u) * d_prime)];
        TestPower {
            d_prime,
            auc: normal_cdf(d_prime * std::f64::consts::FRAC_1_SQRT_2),
            power: power(alarms),
            average_precision: average_precision(rate, thresholds(d_prime).map(point)),
            roc: roc_alarms().map(|share| [share, power(share)]).collect(),
        }
    }

    /// The test with these scores of columns without (0) and with (1) the defect.
    pub(crate) fn of_scores(mut scores: [Vec<f64>; 2], alarms: f64, rate: f64) -> Self {
        scores.iter_mut().for_each(|all| all.sort_by(|a, b| b.total_cmp(a)));
        let [without, with] = &scores;
        let share = |all: &[f64], least: f64| {
            all.partition_point(|score| *score > least) as f64 / all.len() as f64
        };
        // Ties count by half.
        let beaten = |score: &f64| {
            let above = without.partition_point(|other| other > score);
            let below = without.len() - without.partition_point(|other| other >= score);
            (below as f64 + 0.5 * (without.len() - above - below) as f64) / without.len() as f64
        };
        let auc = with.iter().map(beaten).sum::<f64>() / with.len() as f64;
        let power = |alarms: f64| {
            let rank = (alarms * without.len() as f64).floor() as usize;
            share(with, without[rank.min(without.len() - 1)])
        };
        let points = with.iter().map(|least| [share(without, *least), share(with, *least)]);
        TestPower {
            d_prime: std::f64::consts::SQRT_2 * normal_quantile(auc),
            auc,
            power: power(alarms),
            average_precision: average_precision(rate, points),
            roc: roc_alarms().map(|share| [share, power(share)]).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_invert_the_distribution() {
        assert!((normal_quantile(0.99) - 2.326_347_874).abs() < 1e-8);
        assert!((normal_quantile(0.1) + 1.281_551_566).abs() < 1e-8);
    }

    #[test]
    fn normal_tests_have_their_known_values() {
        let test = TestPower::normal(3.607_899_44, 0.01, 0.5);
        assert!((test.power - 0.9).abs() < 1e-6, "{test:?}");
        assert!((test.auc - normal_cdf(3.607_899_44 / 2f64.sqrt())).abs() < 1e-12);
        assert!(test.average_precision > 0.99);
        let none = TestPower::normal(0.0, 0.01, 0.2);
        assert_eq!((none.auc, none.power, none.average_precision), (0.5, 0.01, 0.2));
        let little = TestPower::normal(1e-3, 0.01, 0.2);
        assert!((little.average_precision - 0.2).abs() < 1e-3, "{little:?}");
    }

    #[test]
    fn scores_give_what_their_distribution_gives() {
        use crate::rng::{Purpose, normal3};
        let draw = |n: u64| normal3(3, Purpose::Detectability, 0, n)[0];
        let scores =
            [(0..20_000).map(draw).collect(), (20_000..40_000).map(|n| 2.0 + draw(n)).collect()];
        let (found, known) =
            (TestPower::of_scores(scores, 0.01, 0.5), TestPower::normal(2.0, 0.01, 0.5));
        assert!((found.auc - known.auc).abs() < 0.004, "{found:?} {known:?}");
        // 200 alarms: the threshold has an error of 0.03 standard deviations.
        assert!((found.power - known.power).abs() < 0.04, "{found:?} {known:?}");
        assert!((found.average_precision - known.average_precision).abs() < 0.01);
        let equal = TestPower::of_scores([vec![1.0; 100], vec![1.0; 100]], 0.01, 0.5);
        assert_eq!(equal.auc, 0.5);
    }
}
