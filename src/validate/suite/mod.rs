//! The shipped suite.

mod engines;
mod laws;
mod published;
mod refined;
mod same_numerics;
mod scattering_tables;
mod specimens;

use std::time::Instant;

use ndarray::{Array2, ArrayView2};

use super::difference::Difference;
use super::{Check, CheckRunner, Figure, Findings, ImagePair, Limit, Outcome, overall};
use crate::engine::{Images, Scan};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::setting::Setting;

/// A check of the program.
pub struct Case {
    /// Short name.
    pub name: &'static str,
    /// Title in one line.
    pub title: &'static str,
    /// Group of the case.
    pub group: Group,
    /// Description of the comparison and its method.
    pub about: &'static str,
    /// Origin of the reference.
    pub source: &'static str,
    /// Whether the case is part of the quick suite.
    pub quick: bool,
    /// Approximate time on two cores in s; the progress bar uses it.
    pub seconds: f64,
    /// Number of simulations of the case.
    pub simulations: usize,
    run: fn(&CheckRunner) -> Result<Findings>,
}

/// Groups of cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Comparison with abTEM at equal numerics.
    Abtem,
    /// Results refined in the grid, where grids of the usual size are inexact.
    Refined,
    /// Values from the literature.
    Published,
    /// Laws that hold for any specimen.
    Laws,
    /// Faster engines compared with the exact one.
    Engines,
}

impl Group {
    /// Returns the heading of the group.
    pub fn title(self) -> &'static str {
        match self {
            Group::Abtem => "abTEM 1.0.11 with the same numerics",
            Group::Refined => "Against answers refined in the grid",
            Group::Published => "Published numbers",
            Group::Laws => "Conservation laws and symmetries",
            Group::Engines => "Faster engines against the exact one",
        }
    }
}

const ABTEM: &str = "abTEM 1.0.11 (J. Madsen, T. Susi, Open Research Europe 1 (2021) 24), run once by \
                     tests/golden/make_abtem_goldens.py of the source; abTEM is not needed to compare.";

/// Returns all cases, in the order of the report.
pub fn cases() -> Vec<Case> {
    [
        same_numerics::cases(),
        refined::cases(),
        published::cases(),
        scattering_tables::cases(),
        laws::cases(),
        engines::cases(),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Units of progress for each second.
const UNITS_PER_SECOND: f64 = 10.0;

impl Case {
    /// Returns the case's share of the progress bar.
    pub fn units(&self) -> u64 {
        (self.simulations.max(1) * self.units_per_simulation()) as u64
    }

    fn units_per_simulation(&self) -> usize {
        let each = self.seconds * UNITS_PER_SECOND / self.simulations.max(1) as f64;
        each.ceil().max(1.0) as usize
    }

    /// Runs the case, which advances `progress` by [`Case::units`].
    ///
    /// # Errors
    /// Errors of the engine; [`Error::Interrupted`].
    pub fn run(&self, progress: &dyn Progress) -> Result<Outcome> {
        let begun = Instant::now();
        let runner = CheckRunner::new(progress, self.units_per_simulation());
        let findings = (self.run)(&runner)?;
        if self.simulations == 0 {
            progress.advance(self.units());
        }
        Ok(Outcome {
            name: self.name.to_owned(),
            title: self.title.to_owned(),
            group: self.group.title().to_owned(),
            about: self.about.to_owned(),
            settings: Vec::new(),
            source: self.source.to_owned(),
            verdict: overall(findings.checks.iter().map(|c| &c.verdict)),
            checks: findings.checks,
            figures: findings.figures,
            notes: Vec::new(),
            wall_time_s: begun.elapsed().as_secs_f64(),
        })
    }
}

/// Returns cases of the suite: all, the quick ones, or the named ones.
///
/// # Errors
/// [`Error::Invalid`] for an unknown name, with a list of the known ones.
pub fn selected(names: &[String], quick: bool) -> Result<Vec<Case>> {
    let all = cases();
    for name in names {
        if !all.iter().any(|c| c.name == name) {
            let known = all.iter().map(|c| c.name).collect::<Vec<_>>().join(", ");
            return Err(Error::invalid(Setting::Case, name, format!("known cases: {known}")));
        }
    }
    let wanted = |c: &Case| match names.is_empty() {
        true => c.quick || !quick,
        false => names.iter().any(|n| n == c.name),
    };
    Ok(all.into_iter().filter(wanted).collect())
}

const FRACTION: &str = "fraction of the beam";

fn widened(image: ArrayView2<f32>) -> Array2<f64> {
    image.mapv(f64::from)
}

fn percent(what: impl Into<String>, value: f64, limit: f64) -> Check {
    Check::new(what, 100.0 * value, "%", Limit::AtMost(100.0 * limit))
}

fn shown_percent(what: impl Into<String>, value: f64) -> Check {
    Check::shown(what, 100.0 * value, "%")
}

/// Returns row and column of the largest value.
fn brightest(image: &Array2<f64>) -> [usize; 2] {
    let top = image.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1));
    top.map_or([0, 0], |((y, x), _)| [y, x])
}

/// Makes a figure of two images; the colours of their difference end at `tolerance` times the maximum.
fn pair(
    title: impl Into<String>,
    ours: Array2<f64>,
    reference: Array2<f64>,
    scan: &Scan,
    tolerance: f64,
) -> Figure {
    let top = reference.iter().fold(0.0_f64, |m, v| m.max(*v));
    let share = 100.0 * tolerance;
    Figure::Images(Box::new(ImagePair {
        title: format!("{} (colours of the difference: {share} % of the maximum)", title.into()),
        ours,
        reference,
        step: scan.step_angstrom,
        origin: scan.origin_angstrom,
        axis_unit: "A",
        unit: FRACTION,
        difference_scale: tolerance * top,
        logarithmic: false,
    }))
}

/// Compares the images of all detectors with references, each with its tolerance (as a fraction of the maximum).
fn compare_all<'a>(
    findings: &mut Findings,
    label: &str,
    images: &Images,
    references: impl Iterator<Item = ArrayView2<'a, f64>>,
    scan: &Scan,
    tolerances: [f64; 4],
) {
    let mut figures = Vec::new();
    for (d, (reference, tolerance)) in references.zip(tolerances).enumerate() {
        let ours = widened(images.image(0, d));
        let difference = Difference::between(ours.view(), reference);
        let name = &images.detectors[d];
        let what = format!("{label}{name}: largest difference, of the maximum");
        findings.checks.push(percent(what, difference.largest, tolerance));
        let title = format!("{label}{name}");
        figures.push(pair(title, ours, reference.to_owned(), scan, tolerance));
    }
    // HAADF is the last detector; it is shown first, since most readers want it first.
    findings.figures.extend(figures.into_iter().rev());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::validate::Verdict;

    #[test]
    fn names_are_unique_and_selection_works() {
        let all = cases();
        for case in &all {
            assert_eq!(all.iter().filter(|c| c.name == case.name).count(), 1, "{}", case.name);
            assert!(!case.about.is_empty() && !case.source.is_empty(), "{}", case.name);
        }
        assert_eq!(selected(&[], false).unwrap().len(), all.len());
        let quick = selected(&[], true).unwrap();
        assert!(!quick.is_empty() && quick.len() < all.len());
        assert_eq!(selected(&[all[3].name.to_owned()], true).unwrap()[0].name, all[3].name);
        let message = selected(&["nonsense".into()], false).err().unwrap().to_string();
        assert!(message.contains(all[0].name), "{message}");
    }

    /// The comparison passes with its own image and fails with another one.
    #[test]
    fn another_image_fails() {
        let g = crate::validate::golden::Golden::load("srtio3_001").unwrap();
        let exact = g.images("multislice").unwrap();
        let shipped = g.images("multislice_as_shipped").unwrap();
        let images = Images {
            data: exact.mapv(|v| v as f32).insert_axis(ndarray::Axis(0)),
            detectors: g.detectors().into_iter().map(|d| d.name).collect(),
            thicknesses_angstrom: vec![101.53],
        };
        let verdict = |references: &ndarray::Array3<f64>| {
            let mut f = Findings::default();
            compare_all(&mut f, "", &images, references.outer_iter(), &g.scan(), [2e-4; 4]);
            assert_eq!((f.checks.len(), f.figures.len()), (4, 4));
            overall(f.checks.iter().map(|c| &c.verdict))
        };
        assert_eq!(verdict(&exact), Verdict::Pass);
        assert_eq!(verdict(&shipped), Verdict::Fail);
    }
}
