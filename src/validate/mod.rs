//! Validation: the shipped suite of checks, comparison with an image of another program, and comparison of
//! two worlds; and the reports that show them.
//!
//! The suite ([`suite::cases`]) is one list that users run (`stemgen validate`) and tests run. Each case returns `Findings`: numbers with
//! their limits, and figures. [`user`] reads an image of another program, [`image_comparison`] compares it and `explain` searches the
//! reason of a difference; [`worlds`] compares two world files by statistics, `soundness` checks one; `manifest` recognises released
//! worlds by their digests. [`report`] makes one HTML page of any result.

mod check_runner;
mod difference;
mod explain;
mod field_waves;
pub mod golden;
pub mod image_comparison;
mod likely_settings;
mod manifest;
mod pinned_contents;
pub mod report;
mod soundness;
mod statistics;
pub mod suite;
mod truth_soundness;
pub mod user;
pub mod worlds;

pub(crate) use check_runner::CheckRunner;
pub use difference::Difference;
pub use manifest::{Manifest, PinnedSameness, PinnedWorld};
pub use pinned_contents::PinnedContents;
pub use soundness::{CheckOutcome, WorldCheck, check_world};
pub use statistics::Ratio;

use ndarray::Array2;
use serde::Serialize;

/// Result of a check or a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within all limits.
    Pass,
    /// Beyond a limit.
    Fail,
    /// A number without a limit, for information.
    Shown,
}

/// Limit of a number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
    /// Between the two values.
    Between(f64, f64),
    /// No limit: the number is for information.
    Open,
}

/// A number with its limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Name of the measured quantity.
    pub what: String,
    /// The number.
    pub value: f64,
    /// Its unit; empty for none.
    pub unit: &'static str,
    /// Limit of the number.
    pub limit: Limit,
    /// Whether the number is within its limit.
    pub verdict: Verdict,
}

impl Check {
    /// Judges a number. A number that is not finite fails with any limit.
    pub(crate) fn new(
        what: impl Into<String>,
        value: f64,
        unit: &'static str,
        limit: Limit,
    ) -> Self {
        let good = match limit {
            Limit::AtMost(high) => value <= high,
            Limit::AtLeast(low) => value >= low,
            Limit::Between(low, high) => (low..=high).contains(&value),
            Limit::Open => true,
        };
        let verdict = match (limit, good && value.is_finite()) {
            (_, false) => Verdict::Fail,
            (Limit::Open, true) => Verdict::Shown,
            (_, true) => Verdict::Pass,
        };
        Check { what: what.into(), value, unit, limit, verdict }
    }

    /// Returns how near the number is to its limit: above 1 it is beyond it; 0 without a limit.
    pub(crate) fn strain(&self) -> f64 {
        let strain = match self.limit {
            Limit::AtMost(high) if high > 0.0 => self.value.abs() / high,
            Limit::AtLeast(low) if self.value > 0.0 => low / self.value,
            Limit::Between(low, high) => (2.0 * self.value - low - high).abs() / (high - low),
            Limit::Open => 0.0,
            _ => f64::from(u8::from(self.verdict == Verdict::Fail)),
        };
        if strain.is_finite() { strain } else { f64::MAX }
    }

    /// Makes a number for information, without a limit.
    pub(crate) fn shown(what: impl Into<String>, value: f64, unit: &'static str) -> Self {
        Check::new(what, value, unit, Limit::Open)
    }
}

/// Two images of the same pixels.
#[derive(Debug, Clone)]
pub struct ImagePair {
    /// Title of the figure.
    pub title: String,
    /// Our image: row = y, column = x.
    pub ours: Array2<f64>,
    /// The reference.
    pub reference: Array2<f64>,
    /// Distance of pixels along x and y, in `axis_unit`.
    pub step: [f64; 2],
    /// Position (x, y) of the first pixel, in `axis_unit`.
    pub origin: [f64; 2],
    /// Unit of the axes: `A`, `1/A`.
    pub axis_unit: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Value at which the colours of the difference end, above and below zero.
    pub difference_scale: f64,
    /// Whether colours follow the logarithm of the value.
    pub logarithmic: bool,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// A broken line.
    Dashed,
    /// Points.
    Points,
    /// Points joined by a line.
    Both,
}

/// Points of one kind.
#[derive(Debug, Clone)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y).
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub style: Style,
}

/// A plot of series.
#[derive(Debug, Clone)]
pub struct Plot {
    /// Title of the plot.
    pub title: String,
    /// Quantity and unit along x.
    pub x: String,
    /// Quantity and unit along y.
    pub y: String,
    /// Whether x and y are logarithmic.
    pub logarithmic: [bool; 2],
    /// The series.
    pub series: Vec<Series>,
}

/// A figure of a report.
#[derive(Debug, Clone)]
pub enum Figure {
    /// Images with their difference and profiles.
    Images(Box<ImagePair>),
    /// A plot.
    Plot(Plot),
}

/// Results of a case.
#[derive(Debug, Clone, Default)]
pub(crate) struct Findings {
    /// The numbers.
    pub checks: Vec<Check>,
    /// The figures.
    pub figures: Vec<Figure>,
}

/// A row in a table of settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NamedSetting {
    /// Name of the setting: `wave grid`.
    pub name: String,
    /// Value with its unit.
    pub value: String,
}

/// Result of a case that was run.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Name, by which the case can be chosen.
    pub name: String,
    /// Title in one line.
    pub title: String,
    /// Group of the case.
    pub group: String,
    /// Description of the comparison and its method.
    pub about: String,
    /// Settings of the simulation, for the report.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<NamedSetting>,
    /// Origin of the reference.
    pub source: String,
    /// `Fail` if any check failed.
    pub verdict: Verdict,
    /// Numbers with their limits.
    pub checks: Vec<Check>,
    /// Possible explanations of a failure.
    pub notes: Vec<String>,
    /// Time taken in s.
    pub wall_time_s: f64,
    /// Figures; they are not part of the JSON.
    #[serde(skip)]
    pub figures: Vec<Figure>,
}

/// Returns `Fail` if one of the verdicts is `Fail`.
pub(crate) fn overall<'a>(verdicts: impl IntoIterator<Item = &'a Verdict>) -> Verdict {
    match verdicts.into_iter().any(|v| *v == Verdict::Fail) {
        true => Verdict::Fail,
        false => Verdict::Pass,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_judged() {
        let verdict = |value, limit| Check::new("n", value, "", limit).verdict;
        assert_eq!(verdict(1.0, Limit::AtMost(1.0)), Verdict::Pass);
        assert_eq!(verdict(1.1, Limit::AtMost(1.0)), Verdict::Fail);
        assert_eq!(verdict(0.9, Limit::AtLeast(1.0)), Verdict::Fail);
        assert_eq!(verdict(2.0, Limit::Between(1.0, 3.0)), Verdict::Pass);
        assert_eq!(verdict(9.0, Limit::Open), Verdict::Shown);
        assert_eq!(verdict(f64::NAN, Limit::Open), Verdict::Fail);
        let strain = |value, limit| Check::new("n", value, "", limit).strain();
        assert_eq!(strain(0.5, Limit::AtMost(2.0)), 0.25);
        assert_eq!(strain(4.0, Limit::AtLeast(1.0)), 0.25);
        assert_eq!(strain(2.0, Limit::Between(1.0, 3.0)), 0.0);
        assert_eq!(strain(3.0, Limit::Between(1.0, 3.0)), 1.0);
        assert_eq!(strain(f64::NAN, Limit::AtMost(1.0)), f64::MAX);
        assert_eq!(overall(&[Verdict::Pass, Verdict::Shown]), Verdict::Pass);
        assert_eq!(overall(&[Verdict::Pass, Verdict::Fail]), Verdict::Fail);
    }
}
