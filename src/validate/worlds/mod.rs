//! Are two worlds the same kind of specimen, imaged alike? Two that cannot be equal byte for byte (another
//! seed, another processor, another program) are compared by statistics, each with a test and its threshold.
//!
//! A field is divided into blocks, at most 16 x 16. Errors of rates come from the scatter of the blocks, and the
//! significance of distances between distributions from exchanging whole blocks: neighbouring sites and pixels
//! are not independent. What is larger than a block (grains, domains, wells) counts as a difference where it
//! differs.

mod measure;
mod spectrum;

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;

pub use measure::{Measured, measure};
pub use spectrum::Spectrum;

use super::statistics::{Ratio, binomial_error, kolmogorov_smirnov, two_sided};
use crate::error::{Error, Result};
use crate::io::WorldFile;
use crate::progress::Progress;
use crate::setting::Setting;
use crate::structure::elements;

/// Lines below this probability are called different, unless another is asked for.
pub const DEFAULT_ALPHA: f64 = 0.001;
/// Relabellings of blocks for the distance of distributions.
const PERMUTATIONS: u32 = 9999;
/// Relative difference of pixels that are still the same.
const SAME_PIXEL: f64 = 1e-6;
/// Segments of the image below which errors of spectra mean nothing.
const FEWEST_SEGMENTS: usize = 8;

/// What a line comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Sameness {
    /// No difference beyond chance.
    Same,
    /// A difference that chance does not explain.
    Different,
    /// Too few data.
    Undecided,
}

/// One property of both worlds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// The property.
    pub what: String,
    /// Its unit; empty for none.
    pub unit: &'static str,
    /// Value and standard error in the first world.
    pub a: Option<Ratio>,
    /// Value and standard error in the second world.
    pub b: Option<Ratio>,
    /// What both are, where a number does not say it.
    pub text: String,
    /// The test.
    pub test: &'static str,
    /// Its statistic.
    pub statistic: f64,
    /// Probability of a statistic at least as large between equal worlds.
    pub p: f64,
    /// The verdict.
    pub verdict: Sameness,
}

/// A comparison of two worlds.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct WorldComparison {
    /// Different if any line is.
    pub verdict: Sameness,
    /// Lines below this probability are called different.
    pub alpha: f64,
    /// The lines.
    pub lines: Vec<Line>,
    /// The first world.
    pub a: Measured,
    /// The second world.
    pub b: Measured,
}

/// Measures and compares two worlds.
///
/// # Errors
/// [`Error::Invalid`] for an `alpha` that is no probability; those of reading, for a file that is no world.
pub fn compare(a: &Path, b: &Path, alpha: f64, progress: &dyn Progress) -> Result<WorldComparison> {
    if !(alpha > 1e-4 && alpha < 0.5) {
        return Err(Error::invalid(
            Setting::Alpha,
            alpha,
            "a probability between 0.0001 and 0.5; 0.001 is usual",
        ));
    }
    let worlds = [WorldFile::open(a)?, WorldFile::open(b)?];
    let pixels = worlds.each_ref().map(|w| w.metadata().pixel_size_nm);
    if pixels.iter().any(|p| !(p.is_finite() && *p > 0.0)) {
        return Err(Error::invalid(
            Setting::PixelSizeNm,
            format!("{pixels:?}"),
            "of a world is positive",
        ));
    }
    let frequencies = spectrum::Bands::common(pixels, worlds.each_ref().map(|w| w.shape()));
    let rows = worlds.iter().map(|w| w.shape()[0] as u64).sum();
    progress.start("reading", "rows", rows);
    let [first, second] = &worlds;
    let (a, b) =
        (measure(first, a, &frequencies, progress)?, measure(second, b, &frequencies, progress)?);
    progress.finish();
    let lines = lines(&a, &b, alpha);
    let different = lines.iter().any(|l| l.verdict == Sameness::Different);
    let verdict = if different { Sameness::Different } else { Sameness::Same };
    Ok(WorldComparison { verdict, alpha, lines, a, b })
}

fn lines(a: &Measured, b: &Measured, alpha: f64) -> Vec<Line> {
    let judge = |p: f64| if p < alpha { Sameness::Different } else { Sameness::Same };
    let mut lines = vec![pixel(a, b), elements_line(a, b)];
    let names: BTreeSet<&String> = a.defects.keys().chain(b.defects.keys()).collect();
    for name in names {
        let of = |m: &Measured| m.defects.get(name).cloned().unwrap_or_else(|| m.no_defects());
        lines.push(rate(format!("{name} per site"), &of(a), &of(b), judge));
    }
    let each = |of: fn(&Measured) -> &Vec<(f64, f64)>| [of(a), of(b)].map(|v| Ratio::of_blocks(v));
    for (what, unit, [a, b]) in [
        ("sites", "per nm2", each(|m| &m.sites)),
        ("atomic columns", "per nm2", each(|m| &m.columns)),
        ("mean of the image", "of the beam", each(|m| &m.intensity)),
    ] {
        lines.push(z_line(what.into(), unit, a, b, 0.0, judge));
    }
    lines.push(distribution(
        "nearest neighbours of columns",
        "nm",
        [&a.neighbours_nm, &b.neighbours_nm],
        [a, b],
        judge,
    ));
    lines.push(distribution(
        "intensity of columns",
        "of the beam",
        [&a.intensities, &b.intensities],
        [a, b],
        judge,
    ));
    lines.push(noise(a, b, judge));
    lines.push(spectra(a, b, alpha));
    lines
}

fn plain(value: f64) -> Option<Ratio> {
    Some(Ratio { value, error: 0.0 })
}

fn pixel(a: &Measured, b: &Measured) -> Line {
    let off = (a.pixel_nm / b.pixel_nm - 1.0).abs();
    let same = off < SAME_PIXEL;
    Line {
        what: "pixel".into(),
        unit: "nm",
        a: plain(a.pixel_nm),
        b: plain(b.pixel_nm),
        text: String::new(),
        test: "equal to 1e-6",
        statistic: off,
        p: f64::from(u8::from(same)),
        verdict: if same { Sameness::Same } else { Sameness::Different },
    }
}

fn elements_line(a: &Measured, b: &Measured) -> Line {
    let list = |m: &Measured| {
        let symbols = m.elements.iter().map(|z| elements::symbol(*z)).collect::<Vec<_>>();
        if symbols.is_empty() { "not told".to_owned() } else { symbols.join(" ") }
    };
    let (known, same) =
        (!a.elements.is_empty() && !b.elements.is_empty(), a.elements == b.elements);
    Line {
        what: "elements".into(),
        unit: "",
        a: None,
        b: None,
        text: format!("{} | {}", list(a), list(b)),
        test: "the same set",
        statistic: a.elements.symmetric_difference(&b.elements).count() as f64,
        p: f64::from(u8::from(same || !known)),
        verdict: match (known, same) {
            (false, _) => Sameness::Undecided,
            (true, true) => Sameness::Same,
            (true, false) => Sameness::Different,
        },
    }
}

fn z_line(
    what: String,
    unit: &'static str,
    a: Ratio,
    b: Ratio,
    least_error: f64,
    judge: impl Fn(f64) -> Sameness,
) -> Line {
    let z = a.z(b, least_error);
    let p = two_sided(z);
    let verdict = if z.is_nan() { Sameness::Undecided } else { judge(p) };
    let test = "z of the difference, errors from blocks";
    Line { what, unit, a: Some(a), b: Some(b), text: String::new(), test, statistic: z, p, verdict }
}

/// A rate of events: its error is at least that of independent ones.
fn rate(what: String, a: &[(f64, f64)], b: &[(f64, f64)], judge: impl Fn(f64) -> Sameness) -> Line {
    let sum = |v: &[(f64, f64)]| v.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
    let least = binomial_error(sum(a), sum(b));
    z_line(what, "", Ratio::of_blocks(a), Ratio::of_blocks(b), least, judge)
}

fn distribution(
    what: &str,
    unit: &'static str,
    samples: [&Vec<(u32, f32)>; 2],
    worlds: [&Measured; 2],
    judge: impl Fn(f64) -> Sameness,
) -> Line {
    let [a, b] = samples;
    let mean =
        |s: &[(u32, f32)]| s.iter().map(|(_, v)| f64::from(*v)).sum::<f64>() / s.len() as f64;
    let ks = kolmogorov_smirnov(a, b, worlds.map(|w| w.blocks), PERMUTATIONS);
    let few = a.is_empty() && b.is_empty();
    Line {
        what: what.into(),
        unit,
        a: plain(mean(a)).filter(|r| r.value.is_finite()),
        b: plain(mean(b)).filter(|r| r.value.is_finite()),
        text: "means of the distributions".into(),
        test: "two-sample Kolmogorov-Smirnov, blocks exchanged",
        statistic: ks.distance,
        p: ks.p,
        verdict: if few { Sameness::Undecided } else { judge(ks.p) },
    }
}

/// The dose that the noise beyond the optical limit tells.
fn noise(a: &Measured, b: &Measured, judge: impl Fn(f64) -> Sameness) -> Line {
    let of = |m: &Measured| Ratio::of_blocks(&m.spectrum.noise);
    let (inverse_a, inverse_b) = (of(a), of(b));
    let dose = |r: Ratio| Ratio { value: 1.0 / r.value, error: r.error / (r.value * r.value) };
    let enough = [a, b].iter().all(|m| m.spectrum.noise.len() >= FEWEST_SEGMENTS);
    let mut line = z_line(
        "dose told by the noise".into(),
        "electrons per A2",
        inverse_a,
        inverse_b,
        0.0,
        judge,
    );
    line.a = Some(dose(inverse_a));
    line.b = Some(dose(inverse_b));
    line.test = "z of the noise power beyond the optical limit";
    if !enough {
        line.verdict = Sameness::Undecided;
    }
    line
}

/// Largest z of the logarithm of the ratio of the spectra, over all bands.
fn spectra(a: &Measured, b: &Measured, alpha: f64) -> Line {
    let ratios = a.spectrum.ratio(&b.spectrum);
    let z = ratios.iter().map(|r| (r.value.ln() / r.error).abs()).filter(|z| z.is_finite());
    let largest = z.fold(0.0, f64::max);
    let count = ratios.len().max(1) as f64;
    let p = (two_sided(largest) * count).min(1.0);
    let few = [a, b].iter().any(|m| m.spectrum.segments.len() < FEWEST_SEGMENTS);
    Line {
        what: "power spectrum of the image".into(),
        unit: "",
        a: None,
        b: None,
        text: format!("{} bands up to {:.1} 1/nm", ratios.len(), a.spectrum.highest()),
        test: "largest z of the ratio of all bands, Bonferroni",
        statistic: largest,
        p,
        verdict: match (few, p < alpha) {
            (true, _) => Sameness::Undecided,
            (_, true) => Sameness::Different,
            (_, false) => Sameness::Same,
        },
    }
}
