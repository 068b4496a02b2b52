//! The result of the search for settings with a requested error.

use super::super::settings::Algorithm;
use super::exact_probes::ExactEngine;
use serde::Serialize;

/// A window that was tried.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TriedWindow {
    /// Width of the window in Angstrom.
    pub width_angstrom: f64,
    /// The largest angle of its grid, in units of the outermost detector angle ([`angle_margin`](super::super::settings::Settings::angle_margin)).
    pub angle_margin: f64,
    /// Rms error on the sample with that of local slices, in per cent of the mean image.
    pub found_percent: f64,
    /// Largest likely error of the whole image: the error on the sample plus a standard error, with that of local slices.
    pub likely_percent: f64,
    /// Number of probes in the sample.
    pub probes: usize,
}

/// The result of the search for settings with a requested error.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AccuracyFound {
    /// The requested rms error, in per cent of the mean image. It applies to each image, if there are several.
    pub asked_percent: f64,
    /// The chosen algorithm.
    pub algorithm: Algorithm,
    /// Whether the last tried window is used; otherwise the exact engine is.
    pub holds: bool,
    /// Whether no window was tried yet: the engine is chosen when the simulation runs.
    pub chosen_later: bool,
    /// The windows that were tried, in order. If one holds, it is the last. Empty if the exact engine is not slower.
    pub tried: Vec<TriedWindow>,
    /// Whether windows cannot be used: a detector begins within two semiangles, and the probe is made in the cell.
    pub needs_large_box: bool,
    /// Name of the exact engine that the windows were compared with.
    pub reference: String,
}

impl AccuracyFound {
    /// The window that is used, with its error; `None` for the exact engine.
    pub(crate) fn window(&self) -> Option<&TriedWindow> {
        self.tried.last().filter(|_| self.holds)
    }

    /// The result of a search without a tried window: the exact engine.
    pub(crate) fn exact(asked_percent: f64, exact: &ExactEngine) -> Self {
        AccuracyFound {
            asked_percent,
            algorithm: exact.plan.settings.algorithm,
            holds: false,
            chosen_later: false,
            tried: Vec::new(),
            needs_large_box: false,
            reference: exact.name(),
        }
    }

    /// Describes the result in a sentence.
    pub fn text(&self) -> String {
        let against = &self.reference;
        let grid = |t: &TriedWindow| match t.angle_margin > self.tried[0].angle_margin {
            true => ", on a finer grid",
            false => "",
        };
        let each = |t: &TriedWindow| {
            format!("{:.1} A{}: {}", t.width_angstrom, grid(t), percent(t.found_percent))
        };
        if self.chosen_later {
            return format!(
                "{} asked; the run chooses the engine on a sample of probes; this plan is for the exact engine, {against}",
                percent(self.asked_percent)
            );
        }
        match (self.window(), self.tried.is_empty()) {
            (Some(t), _) => format!(
                "{} asked; found {} (at most {} is likely) on {} probes, against {against}{}",
                percent(self.asked_percent),
                percent(t.found_percent),
                percent(t.likely_percent),
                t.probes,
                grid(t)
            ),
            (None, true) if self.needs_large_box => format!(
                "{} asked; the exact engine, {against}, since these detectors allow windows only with the probe of a large box",
                percent(self.asked_percent)
            ),
            (None, true) => format!(
                "{} asked; the exact engine, {against}, since windows would not save time",
                percent(self.asked_percent)
            ),
            (None, false) => format!(
                "{} asked; the exact engine, {against}, since windows that save time have larger errors here ({})",
                percent(self.asked_percent),
                self.tried.iter().map(each).collect::<Vec<_>>().join(", ")
            ),
        }
    }
}

/// Formats per cent with two digits.
fn percent(value: f64) -> String {
    match value {
        v if v >= 9.95 => format!("{v:.0} %"),
        v if v >= 0.995 => format!("{v:.1} %"),
        v if v >= 0.0995 => format!("{v:.2} %"),
        v => format!("{v:.3} %"),
    }
}
