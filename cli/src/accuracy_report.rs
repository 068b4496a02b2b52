//! `--accuracy`: tells what the library found.

use super::plan_text::Lines;
use super::text;
use serde::Serialize;
use stemgen::engine::{AccuracyFound, Cost, Plan, Scan};
use stemgen::simulation;

/// What was found, and the time that finding it took.
#[derive(Debug, Clone, Serialize)]
pub struct AccuracyReport {
    #[serde(flatten)]
    found: AccuracyFound,
    measured_in_s: f64,
}

impl AccuracyReport {
    /// What was found in so many seconds.
    pub fn new(found: AccuracyFound, measured_in_s: f64) -> Self {
        AccuracyReport { found, measured_in_s }
    }

    /// What is to be said before the exact engine runs: why, and how long.
    pub fn warning(&self, plan: &Plan, scan: &Scan) -> Option<String> {
        (!self.found.holds && !self.found.tried.is_empty()).then(|| {
            let seconds = simulation::seconds(plan, &Cost::new(plan, scan), 1);
            format!("{}; this takes {}", self.found.text(), text::duration_range(seconds))
        })
    }

    /// Those of a run as one value: alone, or a list for a series; nothing where no accuracy was asked for.
    pub fn value(reports: &[AccuracyReport]) -> serde_json::Result<Option<serde_json::Value>> {
        match reports {
            [] => Ok(None),
            [one] => serde_json::to_value(one).map(Some),
            all => serde_json::to_value(all).map(Some),
        }
    }

    /// The same for files, without times: the same for the same input.
    pub fn json_of(reports: &[AccuracyReport]) -> serde_json::Result<Option<String>> {
        match reports {
            [] => Ok(None),
            [one] => serde_json::to_string(&one.found).map(Some),
            all => {
                serde_json::to_string(&all.iter().map(|a| &a.found).collect::<Vec<_>>()).map(Some)
            }
        }
    }

    /// A line of a table.
    pub fn line(&self, lines: &mut Lines) {
        let chosen = self.found.algorithm.to_string();
        let took = text::duration(self.measured_in_s);
        lines.add("accuracy", format!("{}; {chosen}; measured in {took}", self.found.text()));
    }
}
