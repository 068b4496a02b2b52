//! Compares our image of a structure with an image of another program.

use std::time::Instant;

use ndarray::Array2;

use super::difference::{Difference, best_gain};
use super::explain::{Explanation, MUCH_BETTER, WideImage, explanations, likely_shifts};
use super::likely_settings::{LikelySettings, TriedChange, likely_settings};
use super::user::{Reference, ValueUnits};
use super::{
    Check, CheckRunner, Figure, Findings, ImagePair, Limit, NamedSetting, Outcome, Verdict, overall,
};
use crate::engine::{Plan, Scan, Site};
use crate::error::Result;
use crate::plane;
use crate::progress::Progress;

/// Largest distance along x and y at which the start of a scan is searched, from the start that its file gives; crystals repeat within that
/// distance.
const SEARCHED_ANGSTROM: f64 = 3.0;
/// Largest number of places at which a shifted scan is simulated.
const MOST_SCANS: usize = 3;
/// Largest number of refinements of the best place.
const MOST_REFINED: usize = 2;
/// Rms difference, as a fraction of the mean, at which the search ends.
const FOUND: f64 = 1e-3;

/// Rms difference, as a fraction of the mean, below which a factor or an orientation counts as the explanation.
const CLEAR: f64 = 0.02;
/// Rms difference, as a fraction of the mean, above which no change counts as the explanation, however much it improves.
const UNEXPLAINED: f64 = 0.1;
/// A setting that does not explain a difference is still named if it makes the difference smaller by this factor.
const PARTLY: f64 = 1.5;

/// The inputs of a comparison.
pub struct ImageComparison<'a> {
    /// Plan of the simulation, with one detector.
    pub plan: &'a Plan,
    /// The atoms.
    pub sites: &'a [Site],
    /// Edges of the box of the atoms, in Angstrom.
    pub box_angstrom: [f64; 3],
    /// Heights in Angstrom at which slices may be cut (see [`crate::simulation::PreparedSpecimen::heights_angstrom`]).
    pub heights_angstrom: &'a [f64],
    /// Probes on the pixels of the reference.
    pub scan: &'a Scan,
    /// The reference.
    pub reference: &'a Reference,
    /// Unit of the reference's values.
    pub units: ValueUnits,
    /// Largest difference allowed, as a fraction of the reference's maximum.
    pub tolerance: f64,
    /// Name of the case.
    pub name: String,
    /// Description of the comparison, for the report.
    pub about: String,
    /// Settings of our simulation, for the report.
    pub settings: Vec<NamedSetting>,
    /// Origin of the reference: its file.
    pub source: String,
    /// Where `plan` has abTEM's numerics: a converged plan, so that the report shows the effect of abTEM's grid and slices.
    pub converged: Option<&'a Plan>,
    /// Advice for the case that the images differ.
    pub remedy: Option<String>,
}

/// Simulates our image and compares it with the reference.
///
/// # Errors
/// Errors of the engine.
pub fn compare(progress: &dyn Progress, c: &ImageComparison) -> Result<Outcome> {
    let begun = Instant::now();
    let stages = 1 + usize::from(c.converged.is_some());
    progress.start("simulating", "probes", (c.scan.len() * stages) as u64);
    let runner = CheckRunner::new(progress, c.scan.len());
    let image = |plan, scan| -> Result<Array2<f64>> {
        Ok(runner.execute(plan, c.sites, scan)?.image(0, 0).mapv(f64::from))
    };
    let ours = image(c.plan, c.scan)?;
    let converged = c.converged.map(|plan| image(plan, c.scan)).transpose()?;
    progress.finish();

    let mut reference = c.reference.data.clone();
    let mut findings = Findings::default();
    let gain = (c.units == ValueUnits::Fitted).then(|| best_gain(reference.view(), ours.view()));
    reference *= gain.unwrap_or(1.0);
    let d = Difference::between(ours.view(), reference.view());
    let limit = Limit::AtMost(100.0 * c.tolerance);
    let largest = "largest difference, of the maximum of the reference";
    findings.checks.push(Check::new(largest, 100.0 * d.largest, "%", limit));
    findings
        .checks
        .extend(gain.map(|gain| Check::shown("factor fitted to the reference", gain, "")));
    findings.checks.extend([
        Check::shown("rms difference, of the mean", 100.0 * d.rms, "%"),
        Check::shown("ours is brighter on average by", 100.0 * d.bias, "%"),
        Check::shown("correlation coefficient", d.correlation, ""),
    ]);
    let verdict = overall(findings.checks.iter().map(|c| &c.verdict));
    let mut notes = Vec::new();
    let converged = converged.map(|image| Difference::between(reference.view(), image.view()));
    if let Some(off) = converged {
        findings.checks.extend([
            Check::shown(
                "reference against the converged image: largest",
                100.0 * off.largest,
                "%",
            ),
            Check::shown("the reference is brighter on average by", 100.0 * off.bias, "%"),
        ]);
    }
    if verdict == Verdict::Fail {
        notes.push(explained(progress, c, (&ours, &reference), &mut findings)?);
        notes.extend(c.remedy.clone());
    }
    notes.extend(converged.map(|off| result_of_both(verdict == Verdict::Pass, &off, c.tolerance)));
    let detector = c.plan.settings.detectors[0].name.clone();
    findings.figures.push(figure(c, &detector, ours, reference, &d));
    Ok(Outcome {
        name: c.name.clone(),
        title: format!("{detector} against {}", c.name),
        group: "Your reference".into(),
        about: c.about.clone(),
        settings: c.settings.clone(),
        source: c.source.clone(),
        verdict,
        checks: findings.checks,
        notes,
        figures: findings.figures,
        wall_time_s: begun.elapsed().as_secs_f64(),
    })
}

/// Draws the images and their difference, in colours up to the tolerance, or up to the largest difference if that is greater.
fn figure(
    c: &ImageComparison,
    detector: &str,
    ours: Array2<f64>,
    reference: Array2<f64>,
    d: &Difference,
) -> Figure {
    let top = reference.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let (share, which) = match d.largest > c.tolerance {
        true => (d.largest, "the largest difference"),
        false => (c.tolerance, "the limit"),
    };
    let scale = share * top;
    Figure::Images(Box::new(ImagePair {
        title: format!(
            "{detector}: ours and the reference. Colours of the difference end at {scale:.2e} of the beam either way: {which}, \
             {:.3} % of the maximum of the reference",
            100.0 * share
        ),
        ours,
        reference,
        step: c.scan.step_angstrom,
        origin: c.scan.origin_angstrom,
        axis_unit: "A",
        unit: "fraction of the beam",
        difference_scale: scale,
        logarithmic: false,
    }))
}

/// Searches an explanation of a difference, the likeliest and cheapest first: a factor or another orientation; a setting that is often
/// wrong, at a few probes; a shift of the scan. All trials become numbers of the report.
fn explained(
    progress: &dyn Progress,
    c: &ImageComparison,
    (ours, reference): (&Array2<f64>, &Array2<f64>),
    findings: &mut Findings,
) -> Result<String> {
    let still = WideImage { data: ours.clone(), margin: [0; 2] };
    let in_place = explanations(&still, reference).best.filter(|best| best.shift.is_none());
    // A factor may make the difference from a wrong energy much smaller without being its explanation.
    let left_in_place = in_place.map_or(f64::INFINITY, |best| best.rms);
    let mut partly = None;
    if left_in_place > CLEAR {
        let fitted = c.units == ValueUnits::Fitted;
        if let Some(likely) = likely_settings(progress, c, ours, reference, fitted)? {
            findings.checks.extend(checks_of(&likely));
            match likely.tried.first() {
                Some(best)
                    if best.rms < UNEXPLAINED
                        && best.rms * MUCH_BETTER < likely.now.min(left_in_place) =>
                {
                    return Ok(explanation(&likely, best));
                }
                best => partly = best.filter(|b| b.rms * PARTLY < likely.now).cloned(),
            }
        }
    }
    let shifted = explained_by_place(progress, c, reference, findings)?;
    Ok(match partly {
        None => shifted,
        Some(part) => format!(
            "{shifted}; of the settings that were tried, {} leaves the smallest difference: {:.2} % of the mean",
            part.words,
            100.0 * part.rms
        ),
    })
}

fn checks_of(likely: &LikelySettings) -> Vec<Check> {
    let at = format!("at {} probes, of the mean", likely.probes);
    let one = |change: &TriedChange| {
        let what = format!("rms difference left by {}, {at}", change.words);
        Check::shown(what, 100.0 * change.rms, "%")
    };
    let now = Check::shown(format!("rms difference {at}"), 100.0 * likely.now, "%");
    std::iter::once(now).chain(likely.tried.iter().map(one)).collect()
}

/// Describes the setting that explains the difference, and the difference that the next best setting leaves.
fn explanation(likely: &LikelySettings, best: &TriedChange) -> String {
    let mut text = format!(
        "{} explains the difference: rms {:.2} % of the mean in place of {:.2} %, at {} probes",
        best.words,
        100.0 * best.rms,
        100.0 * likely.now,
        likely.probes
    );
    if let Some(next) = likely.tried.get(1) {
        text += &format!("; the next best, {}, leaves {:.2} %", next.words, 100.0 * next.rms);
    }
    text
}

/// Searches a factor, an orientation or a shift of the scan. A shift is simulated, since interpolation between pixels is inexact.
fn explained_by_place(
    progress: &dyn Progress,
    c: &ImageComparison,
    reference: &Array2<f64>,
    findings: &mut Findings,
) -> Result<String> {
    let wide = ours_beyond(progress, c)?;
    let found = explanations(&wide, reference);
    let step = c.scan.step_angstrom;
    let left = |e: &Explanation, how: &str| {
        let what = format!("rms difference left by {}{how}, of the mean", e.words(step));
        Check::shown(what, 100.0 * e.rms, "%")
    };
    // Interpolation only finds a shift; its image is not exact.
    let alone = |e: &Explanation| left(e, if e.shift.is_some() { ", interpolated" } else { "" });
    findings.checks.extend(found.alone.iter().map(alone));
    let now = 100.0 * found.now;
    let Some(mut best) = found.best else {
        let least = found.alone.iter().map(|e| e.rms).fold(found.now, f64::min);
        return Ok(format!(
            "neither a factor, nor another orientation, nor a shift of the scan by up to {SEARCHED_ANGSTROM} A explains the \
             difference: of its rms of {now:.2} % of the mean at least {:.2} % are left",
            100.0 * least
        ));
    };
    if best.shift.is_some() {
        best = simulated(progress, c, &wide, reference, best)?;
        findings.checks.push(left(&best, ", simulated"));
    }
    let start = best.shift.map_or_else(String::new, |shift| {
        let at = plane::add(c.scan.origin_angstrom, plane::mul(shift, step));
        format!(
            "; its scan seems to start at {:.3}, {:.3} A (abTEM 1.0.11 writes 0, 0 into its files wherever a scan starts)",
            at[0], at[1]
        )
    });
    let fit = match best.factor {
        Some(_) => "; are its values fractions of the beam? Otherwise let the factor be fitted",
        None => "",
    };
    let explains = best.rms < UNEXPLAINED && best.rms * MUCH_BETTER < found.now;
    let verb = if explains { "explains" } else { "does not explain" };
    Ok(format!(
        "{} {verb} the difference: rms {:.2} % of the mean in place of {now:.2} %{start}{fit}",
        best.words(step),
        100.0 * best.rms
    ))
}

/// Returns the number of pixels (x, y) by which our image must extend beyond the reference.
fn margin(scan: &Scan) -> [usize; 2] {
    let along = |k: usize| match scan.shape[1 - k] {
        1 => 0,
        _ => (SEARCHED_ANGSTROM / scan.step_angstrom[k]).ceil() as usize,
    };
    [along(0), along(1)]
}

/// Simulates our image with a margin about it.
fn ours_beyond(progress: &dyn Progress, c: &ImageComparison) -> Result<WideImage> {
    beyond(progress, c, c.scan, margin(c.scan), "simulating about the scan")
}

fn beyond(
    progress: &dyn Progress,
    c: &ImageComparison,
    inner: &Scan,
    margin: [usize; 2],
    stage: &str,
) -> Result<WideImage> {
    let step = inner.step_angstrom;
    let origin_angstrom =
        plane::sub(inner.origin_angstrom, plane::mul(margin.map(|n| n as f64), step));
    let shape = plane::add(inner.shape, plane::swapped(margin).map(|n| 2 * n));
    let scan = Scan { origin_angstrom, step_angstrom: step, shape };
    Ok(WideImage { data: at_scan(progress, c, &scan, stage)?, margin })
}

fn at_scan(
    progress: &dyn Progress,
    c: &ImageComparison,
    scan: &Scan,
    stage: &str,
) -> Result<Array2<f64>> {
    progress.start(stage, "probes", scan.len() as u64);
    let images = CheckRunner::new(progress, scan.len()).execute(c.plan, c.sites, scan)?;
    progress.finish();
    Ok(images.image(0, 0).mapv(f64::from))
}

/// Simulates the scan at its likely shifts: crystals nearly repeat, so several shifts are simulated.
fn simulated(
    progress: &dyn Progress,
    c: &ImageComparison,
    wide: &WideImage,
    reference: &Array2<f64>,
    guess: Explanation,
) -> Result<Explanation> {
    let turned = guess.turn.apply(reference);
    // The margin covers the error of interpolation; a remaining shift near zero is found exactly.
    let narrow = margin(c.scan).map(|n| n.min(2));
    let look = |shift: [f64; 2]| -> Result<(Explanation, WideImage)> {
        let step = c.scan.step_angstrom;
        let origin_angstrom = plane::add(c.scan.origin_angstrom, plane::mul(shift, step));
        let scan = Scan { origin_angstrom, ..*c.scan };
        let around = beyond(progress, c, &scan, narrow, "simulating a moved scan")?;
        let ours = around.inner();
        let factor = guess.factor.map(|_| best_gain(turned.view(), ours.view()));
        let rms = Difference::between(ours.view(), (&turned * factor.unwrap_or(1.0)).view()).rms;
        Ok((Explanation { shift: Some(shift), factor, rms, ..guess }, around))
    };
    let mut best: Option<(Explanation, WideImage)> = None;
    let mut next = likely_shifts(wide, &turned).into_iter().take(MOST_SCANS);
    while let Some(shift) = next.next().filter(|_| best.as_ref().is_none_or(|b| b.0.rms > FOUND)) {
        let found = look(shift)?;
        if best.as_ref().is_none_or(|b| found.0.rms < b.0.rms) {
            best = Some(found);
        }
    }
    let Some((mut best, mut around)) = best else { return Ok(guess) };
    for _ in 0..MOST_REFINED {
        let further = likely_shifts(&around, &turned).first().copied().unwrap_or_default();
        let shift = best.shift.unwrap_or_default();
        if best.rms <= FOUND || further == [0.0; 2] {
            break;
        }
        let found = look([shift[0] + further[0], shift[1] + further[1]])?;
        if found.0.rms >= best.rms {
            break;
        }
        (best, around) = found;
    }
    Ok(best)
}

/// Describes the result of both comparisons: with abTEM's numerics, and converged.
fn result_of_both(same_numerics: bool, converged: &Difference, tolerance: f64) -> String {
    let off = format!("{:.2} % of the maximum", 100.0 * converged.largest);
    match (same_numerics, converged.largest <= tolerance) {
        (true, true) => {
            "with abTEM's numerics and converged, our image agrees with the reference".into()
        }
        (true, false) => format!(
            "with abTEM's numerics our image agrees with the reference; converged in grid and slices, it differs by up to {off}: that is \
             the error of abTEM's grid and slices"
        ),
        (false, _) => format!(
            "abTEM's grid and slices do not explain the difference; the converged image differs from the reference by up to {off}"
        ),
    }
}
