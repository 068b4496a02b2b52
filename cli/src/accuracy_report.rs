//! `--accuracy`: asks the library for settings, and tells what it found.

use super::estimate;
use super::plan_report::Lines;
use super::progress_bar::Reporter;
use super::structure_args::Prepared;
use super::text;
use serde::Serialize;
use std::time::Instant;
use stemgen::engine::{
    AccuracyFound, Algorithm, Cost, Plan, Scan, Settings, settings_for_accuracy,
};

/// What was found, and the time that finding it took.
#[derive(Debug, Clone, Serialize)]
pub struct AccuracyReport {
    #[serde(flatten)]
    found: AccuracyFound,
    measured_in_s: f64,
}

impl AccuracyReport {
    /// Changes the settings to those that are as accurate as asked for a scan; nothing where nothing is asked.
    pub fn choose(
        asked_percent: Option<f64>,
        settings: &mut Settings,
        specimen: &Prepared,
        scan: &Scan,
        reporter: &Reporter,
    ) -> anyhow::Result<Option<Self>> {
        let Some(asked) = asked_percent else { return Ok(None) };
        let begun = Instant::now();
        let frames = specimen.frames();
        let (chosen, found) =
            settings_for_accuracy(asked, settings, specimen.size, &frames, scan, reporter)?;
        *settings = chosen;
        Ok(Some(AccuracyReport { found, measured_in_s: begun.elapsed().as_secs_f64() }))
    }

    /// What is to be said before the exact engine runs: why, and how long.
    pub fn warning(&self, plan: &Plan, scan: &Scan) -> Option<String> {
        let exact = !matches!(self.found.algorithm, Algorithm::Window { .. });
        (exact && !self.found.tried.is_empty()).then(|| {
            let seconds = estimate::seconds(plan, &Cost::new(plan, scan), 1);
            format!("{}; this takes {}", self.found.text(), text::duration_range(seconds))
        })
    }

    /// What was found, in a sentence.
    pub fn text(&self) -> String {
        self.found.text()
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
