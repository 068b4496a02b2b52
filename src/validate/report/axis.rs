//! An axis with ticks at round numbers, linear or logarithmic, in either direction.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use std::ops::Range;

/// An axis from `first` (left or below) to `last`, which may be less than `first`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlotAxis {
    pub first: f64,
    pub last: f64,
    pub logarithmic: bool,
}

impl PlotAxis {
    /// Makes an axis that holds all values, with a little room.
    pub fn around(values: impl Iterator<Item = f64>, logarithmic: bool) -> Self {
        let usable = |v: &f64| v.is_finite() && (!logarithmic || *v > 0.0);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(usable) {
            (low, high) = (low.min(v), high.max(v));
        }
        if low > high {
            (low, high) = (1.0, 2.0);
        }
        if logarithmic {
            let room = (high / low).powf(0.06).max(1.2);
            return PlotAxis { first: low / room, last: high * room, logarithmic };
        }
        let room = match high - low {
            0.0 => high.abs().max(1e-12) * 0.1,
            range => 0.05 * range,
        };
        PlotAxis { first: low - room, last: high + room, logarithmic }
    }

    pub fn linear(first: f64, last: f64) -> Self {
        PlotAxis { first, last, logarithmic: false }
    }

    /// Returns the place of a value: 0 at the first end, 1 at the last.
    fn fraction(&self, value: f64) -> f64 {
        let of = |v: f64| if self.logarithmic { v.max(f64::MIN_POSITIVE).ln() } else { v };
        (of(value) - of(self.first)) / (of(self.last) - of(self.first))
    }

    fn ticks(&self, most: usize) -> Vec<f64> {
        let (low, high) = (self.first.min(self.last), self.first.max(self.last));
        let most = most.max(2);
        if self.logarithmic {
            let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
            for multiples in [[1.0, 2.0, 5.0].as_slice(), &[1.0]] {
                let all =
                    decades.clone().flat_map(|d| multiples.iter().map(move |m| m * 10_f64.powi(d)));
                let ticks: Vec<f64> = all.filter(|t| (low..=high).contains(t)).collect();
                if ticks.len() <= most && ticks.len() > 1 {
                    return ticks;
                }
            }
        }
        let rough = (high - low) / most as f64;
        let power = 10_f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power);
        let step = step.into_iter().find(|s| *s >= rough).unwrap_or(10.0 * power);
        let first = (low / step - 1e-9).ceil() as i64;
        let last = (high / step + 1e-9).floor() as i64;
        (first..=last.min(first + 100)).map(|i| i as f64 * step).collect()
    }

    /// Writes a tick with enough digits after the point to distinguish the ticks.
    pub fn label(value: &f64) -> String {
        let size = value.abs();
        match size {
            0.0 => "0".into(),
            _ if size < 1e-12 => "0".into(),
            1e-3..1e5 => {
                let text = format!("{value:.6}");
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            }
            _ => {
                let text = format!("{value:.2e}");
                text.replace(".00e", "e").replace("0e", "e")
            }
        }
    }
}

impl Ranged for PlotAxis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let fraction = self.fraction(*value).clamp(-1.0, 2.0);
        limit.0 + (fraction * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.ticks(hint.max_num_points())
    }

    fn range(&self) -> Range<f64> {
        self.first..self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers_inside() {
        let close = |a: &[f64], b: &[f64]| {
            assert!(
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9),
                "{a:?} {b:?}"
            );
        };
        close(&PlotAxis::linear(0.0, 3.9).ticks(5), &[0.0, 1.0, 2.0, 3.0]);
        close(&PlotAxis::linear(3.9, 0.0).ticks(5), &[0.0, 1.0, 2.0, 3.0]);
        let log = PlotAxis { first: 0.007, last: 0.05, logarithmic: true };
        close(&log.ticks(6), &[0.01, 0.02, 0.05]);
        let wide = PlotAxis { first: 1e-9, last: 2e-4, logarithmic: true };
        close(&wide.ticks(8), &[1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4]);
        assert!(PlotAxis::around([3.0, 3.0].into_iter(), false).ticks(5).len() > 1);
        assert!(PlotAxis::around([f64::NAN].into_iter(), true).ticks(5).len() > 1);
    }

    #[test]
    fn values_are_placed() {
        assert_eq!(PlotAxis::linear(0.0, 10.0).map(&2.5, (100, 500)), 200);
        assert_eq!(PlotAxis::linear(10.0, 0.0).map(&2.5, (100, 500)), 400);
        let log = PlotAxis { first: 1.0, last: 100.0, logarithmic: true };
        assert_eq!(log.map(&10.0, (0, 200)), 100);
        assert_eq!(
            (PlotAxis::label(&0.05), PlotAxis::label(&2e-5)),
            ("0.05".into(), "2e-5".into())
        );
    }
}
