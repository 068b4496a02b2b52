//! The dose-efficiency curve: the score of an agent as a function of the spent share of its dose budget, and metrics of the curve.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Number of points at which curves are sampled, from no dose to the whole budget.
pub(crate) const CHECKPOINTS: usize = 50;
/// Score that [`DoseMetrics::time_to_threshold`] waits for.
pub(crate) const THRESHOLD: f64 = 0.8;

/// Scores of one episode: (share of the budget spent, score), by rising share.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DoseCurve {
    records: Vec<[f64; 2]>,
}

/// Metrics of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DoseMetrics {
    /// DEC-AUC: the area below the curve.
    pub dec_auc: f64,
    /// Score at the end.
    pub final_score: f64,
    /// Share of the budget at the first checkpoint whose score is 0.8 or more; 1 if there is none.
    pub time_to_threshold: f64,
    /// The area with the weight 2 (1 - f): early scores count more.
    pub early_weighted: f64,
    /// The area with the weight 2 f: late scores count more.
    pub late_weighted: f64,
    /// Twice the area of the first half of the budget.
    pub half_budget: f64,
}

impl DoseCurve {
    /// Records a score when `share` of the budget is spent.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a share or a score that is not between 0 and 1, or a share below the last one.
    pub fn record(&mut self, share: f64, score: f64) -> Result<()> {
        let last = self.records.last().map_or(0.0, |r| r[0]);
        if !(last..=1.0).contains(&share) || !(0.0..=1.0).contains(&score) {
            let expected =
                format!("expected a share of the budget from {last} to 1, and a score from 0 to 1");
            return Err(Error::invalid(Setting::Score, format!("{score} at {share}"), expected));
        }
        self.records.push([share, score]);
        Ok(())
    }

    /// Returns all records.
    pub(crate) fn records(&self) -> &[[f64; 2]] {
        &self.records
    }

    /// Returns the score at a share of the budget: 0 before the first record (nothing was declared yet, so there is no ramp from the
    /// origin), linear between records, and the last score after the last record. Of several records at one share the last counts.
    pub(crate) fn at(&self, share: f64) -> f64 {
        let after = self.records.partition_point(|r| r[0] <= share);
        let Some(before) = after.checked_sub(1) else { return 0.0 };
        let [from, score] = self.records[before];
        match self.records.get(after) {
            Some([to, next]) => score + (next - score) * (share - from) / (to - from),
            None => score,
        }
    }

    /// Returns the scores at `count` even points from no dose to the whole budget.
    pub fn checkpoints(&self, count: usize) -> Vec<f64> {
        (0..count).map(|k| self.at(share_at(k, count))).collect()
    }

    /// Computes all metrics from 50 points.
    pub fn metrics(&self) -> DoseMetrics {
        self.metrics_of(CHECKPOINTS)
    }

    /// Computes all metrics from another number of points, at least two.
    pub fn metrics_of(&self, count: usize) -> DoseMetrics {
        let count = count.max(2);
        let scores = self.checkpoints(count);
        let shares: Vec<f64> = (0..count).map(|k| share_at(k, count)).collect();
        let area = |weight: &dyn Fn(f64) -> f64| {
            let values: Vec<f64> =
                shares.iter().zip(&scores).map(|(f, s)| s * weight(*f)).collect();
            trapezoids(&shares, &values)
        };
        let crossed = shares.iter().zip(&scores).find(|(_, s)| **s >= THRESHOLD);
        DoseMetrics {
            dec_auc: area(&|_| 1.0),
            final_score: self.at(1.0),
            time_to_threshold: crossed.map_or(1.0, |(f, _)| *f),
            early_weighted: area(&|f| 2.0 * (1.0 - f)),
            late_weighted: area(&|f| 2.0 * f),
            half_budget: 2.0 * self.first_half(&shares, &scores),
        }
    }

    /// Computes the area up to half the budget, which lies between two points if their number is even.
    fn first_half(&self, shares: &[f64], scores: &[f64]) -> f64 {
        let within = shares.partition_point(|f| *f < 0.5);
        let at_half = {
            let ([a, b], [from, to]) =
                ([shares[within - 1], shares[within]], [scores[within - 1], scores[within]]);
            from + (to - from) * (0.5 - a) / (b - a)
        };
        let shares: Vec<f64> = shares[..within].iter().copied().chain([0.5]).collect();
        let scores: Vec<f64> = scores[..within].iter().copied().chain([at_half]).collect();
        trapezoids(&shares, &scores)
    }
}

fn share_at(k: usize, count: usize) -> f64 {
    k as f64 / (count.max(2) - 1) as f64
}

fn trapezoids(shares: &[f64], values: &[f64]) -> f64 {
    let steps = shares.windows(2).zip(values.windows(2));
    steps.map(|(f, v)| 0.5 * (v[0] + v[1]) * (f[1] - f[0])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(records: &[[f64; 2]]) -> DoseCurve {
        let mut curve = DoseCurve::default();
        records.iter().for_each(|[f, s]| curve.record(*f, *s).unwrap());
        curve
    }

    /// The STEMGym paper's Raster on particles is right from the first record on, and its PPO only at the end.
    #[test]
    fn the_numbers_of_the_paper() {
        assert!((curve(&[[0.1, 1.0], [1.0, 1.0]]).metrics().dec_auc - 0.90816).abs() < 5e-6);
        assert!((curve(&[[0.1, 1.0]]).metrics().dec_auc - 0.90816).abs() < 5e-6);
        assert!((curve(&[[1.0, 1.0]]).metrics().dec_auc - 0.01020).abs() < 5e-6);
        let nothing = DoseCurve::default().metrics();
        assert_eq!(
            (nothing.dec_auc, nothing.final_score, nothing.time_to_threshold),
            (0.0, 0.0, 1.0)
        );
    }

    #[test]
    fn weights_split_the_area() {
        let m = curve(&[[0.0, 0.3], [0.4, 0.9], [0.7, 0.5]]).metrics();
        assert!((0.5 * (m.early_weighted + m.late_weighted) - m.dec_auc).abs() < 1e-12);
        let even = curve(&[[0.0, 0.6]]).metrics();
        assert!((even.half_budget - 0.6).abs() < 1e-12 && (even.dec_auc - 0.6).abs() < 1e-12);
        assert!((even.early_weighted - 0.6).abs() < 1e-3);
        assert_eq!(curve(&[[0.0, 0.2], [0.5, 1.0]]).metrics().time_to_threshold, 19.0 / 49.0);
    }

    #[test]
    fn bad_records_are_refused() {
        let mut curve = curve(&[[0.5, 0.2]]);
        for [share, score] in
            [[0.4, 0.2], [1.1, 0.2], [0.6, 1.2], [0.6, -0.1], [f64::NAN, 0.1], [0.6, f64::NAN]]
        {
            assert!(curve.record(share, score).is_err(), "{share} {score}");
        }
        assert_eq!(curve.records().len(), 1);
    }
}
