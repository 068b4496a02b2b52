//! The report of `--accuracy`.

use super::plan_text::Lines;
use super::text;
use serde::Serialize;
use stemgen::engine::{AccuracyFound, Cost, Plan, Scan};
use stemgen::simulation;

/// The accuracy found, and the time of the search.
#[derive(Debug, Clone, Serialize)]
pub struct AccuracyReport {
    #[serde(flatten)]
    found: AccuracyFound,
    measured_in_s: f64,
    /// The defocus, in a series.
    #[serde(skip)]
    defocus_angstrom: Option<f64>,
}

impl AccuracyReport {
    /// Makes the report of an accuracy that was found in `measured_in_s` seconds, of a defocus of a series.
    pub fn new(found: AccuracyFound, measured_in_s: f64, defocus_angstrom: Option<f64>) -> Self {
        AccuracyReport { found, measured_in_s, defocus_angstrom }
    }

    /// Returns a warning before the exact engine runs: the reason, and the expected time. `None` if a window is used.
    pub fn warning(&self, plan: &Plan, scan: &Scan) -> Option<String> {
        (!self.found.holds && !self.found.tried.is_empty()).then(|| {
            let seconds = simulation::seconds(plan, &Cost::new(plan, scan), 1);
            format!("{}; this takes {}", self.found.text(), text::duration_range(seconds))
        })
    }

    /// Returns the reports of a run as one value: a report, a list for a series, or `None` if no accuracy was asked for.
    pub fn value(reports: &[AccuracyReport]) -> serde_json::Result<Option<serde_json::Value>> {
        match reports {
            [] => Ok(None),
            [one] => serde_json::to_value(one).map(Some),
            all => serde_json::to_value(all).map(Some),
        }
    }

    /// Returns the reports of a run as JSON for files, without times, so that equal input gives equal bytes.
    pub fn json_of(reports: &[AccuracyReport]) -> serde_json::Result<Option<String>> {
        match reports {
            [] => Ok(None),
            [one] => serde_json::to_string(&one.found).map(Some),
            all => {
                serde_json::to_string(&all.iter().map(|a| &a.found).collect::<Vec<_>>()).map(Some)
            }
        }
    }

    /// Adds the report to a table.
    pub fn line(&self, lines: &mut Lines) {
        // The text names the exact engine, but no window.
        let window = match self.found.holds {
            true => format!("; {}", self.found.algorithm),
            false => String::new(),
        };
        let took = text::duration(self.measured_in_s);
        let of = self.defocus_angstrom.map_or(String::new(), |d| format!("defocus {d} A: "));
        lines.add("accuracy", format!("{of}{}{window}; measured in {took}", self.found.text()));
    }
}
