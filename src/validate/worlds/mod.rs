//! Compares two worlds: whether they show specimens of one kind, imaged alike. Worlds that cannot be equal byte for byte (another seed,
//! another processor, another program) are compared by statistics, each with a test and its threshold.
//!
//! A field is divided into blocks, at most 16 x 16. If both fields have the same pixels, the blocks at one place are a pair, and slow waves
//! over their differences show how far two worlds of one kind differ (`field_waves`). A feature that both have at one
//! place (a boundary, a well) then neither counts as a difference nor hides one. Other fields are compared by the scatter of all blocks of
//! each, and by exchanging any of them. If the recipes have interfaces that wander, parts of the field are as large as the length over
//! which they wander ([`Variation`]). A property whose variation no part of the field shows stays undecided.

mod column_squares;
mod measure;
mod parts;
mod spectrum;
mod variation;

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;

pub use measure::Measured;
pub(crate) use measure::measure;
pub use spectrum::Spectrum;
pub use variation::Variation;

use self::parts::Comparing;
use super::statistics::{
    Places, Ratio, binomial_error, kolmogorov_smirnov, paired_error, student_two_sided, two_sided,
};
use crate::error::{Error, Result};
use crate::io::WorldFile;
use crate::progress::Progress;
use crate::setting::Setting;
use crate::structure::elements;

/// Default rate at which worlds of one kind are called different.
pub const DEFAULT_ALPHA: f64 = 0.001;
/// Largest relative difference of pixel sizes that count as equal.
const SAME_PIXEL: f64 = 1e-6;
/// Number of segments of the image below which errors of spectra have no meaning.
const FEWEST_SEGMENTS: usize = 8;

/// Result of a line.
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
    /// Value in the first world, and its standard error. Where slow waves give the error of the difference, each world takes half of its
    /// square.
    pub a: Option<Ratio>,
    /// Value and standard error in the second world.
    pub b: Option<Ratio>,
    /// Values of both worlds in words, where no number describes them.
    pub text: String,
    /// The test.
    pub test: &'static str,
    /// The statistic of the test.
    pub statistic: f64,
    /// Probability of a statistic at least as large between worlds of one kind.
    pub p: f64,
    /// The verdict.
    pub verdict: Sameness,
}

/// A comparison of two worlds.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct WorldComparison {
    /// `Different` if any line is.
    pub verdict: Sameness,
    /// Rate at which worlds of one kind are called different.
    pub alpha: f64,
    /// Lines with a probability below this are called different, so that all tests together are wrong at the rate `alpha`.
    pub line_alpha: f64,
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
/// [`Error::Invalid`] for an `alpha` that is no probability; errors of reading, for a file that is no world.
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
    let others = common_detectors(&worlds);
    let frequencies = spectrum::Bands::common(pixels, worlds.each_ref().map(|w| w.shape()));
    let rows: u64 = worlds.iter().map(|w| w.shape()[0] as u64).sum();
    progress.start("reading", "rows", rows * (1 + others.len() as u64));
    let [first, second] = &worlds;
    let measured = |worlds: [&WorldFile; 2]| -> Result<[Measured; 2]> {
        let [first, second] = worlds;
        Ok([
            measure(first, a, &frequencies, progress)?,
            measure(second, b, &frequencies, progress)?,
        ])
    };
    let main = measured([first, second])?;
    let mut all = lines(&main[0], &main[1]);
    all.extend(detectors_line(&worlds));
    for name in others {
        let pair = [first.on_detector(&name)?, second.on_detector(&name)?];
        let [a, b] = measured([&pair[0], &pair[1]])?;
        let named = |line: Line| Line { what: format!("{name}: {}", line.what), ..line };
        all.extend(image_lines(&a, &b).into_iter().map(named));
    }
    progress.finish();
    let (lines, line_alpha) = judged(all, alpha);
    let [a, b] = main;
    let different = lines.iter().any(|l| l.verdict == Sameness::Different);
    let verdict = if different { Sameness::Different } else { Sameness::Same };
    Ok(WorldComparison { verdict, alpha, line_alpha, lines, a, b })
}

/// Judges all lines with a random part, so that between worlds of one kind any of them is called different at the rate `alpha` (Z. Sidak,
/// J. Am. Stat. Assoc. 62 (1967) 626). Also returns the probability below which a line is called different.
fn judged(mut lines: Vec<Line>, alpha: f64) -> (Vec<Line>, f64) {
    let by_chance = |l: &Line| l.verdict == Sameness::Same && l.p < 1.0;
    let tests = lines.iter().filter(|l| by_chance(l)).count().max(1);
    let line_alpha = 1.0 - (1.0 - alpha).powf(1.0 / tests as f64);
    for line in lines.iter_mut().filter(|l| l.verdict == Sameness::Same && l.p < line_alpha) {
        line.verdict = Sameness::Different;
    }
    (lines, line_alpha)
}

/// Computes all lines; lines with a test are `Same` at any probability, or `Undecided`.
fn lines(a: &Measured, b: &Measured) -> Vec<Line> {
    let by = comparing(a, b);
    let mut lines = vec![pixel(a, b), elements_line(a, b)];
    let names: BTreeSet<&String> = a.defects.keys().chain(b.defects.keys()).collect();
    for name in names {
        let of = |m: &Measured| m.defects.get(name).cloned().unwrap_or_else(|| m.no_defects());
        lines.push(rate(format!("{name} per site"), [&of(a), &of(b)], &by));
    }
    for (what, unit, blocks) in [
        ("sites", "per nm2", [&a.sites, &b.sites]),
        ("atomic columns", "per nm2", [&a.columns, &b.columns]),
    ] {
        lines.push(mean_line(what.into(), unit, blocks, 0.0, &by));
    }
    let [mean, others @ ..] = image_lines(a, b);
    let neighbours = [&a.neighbours_nm, &b.neighbours_nm];
    lines.extend([mean, distribution("nearest neighbours of columns", "nm", neighbours, &by)]);
    lines.extend(others);
    lines
}

fn same_pixels(a: &Measured, b: &Measured) -> bool {
    a.shape == b.shape && pixel(a, b).verdict == Sameness::Same
}

fn comparing(a: &Measured, b: &Measured) -> Comparing {
    Comparing::new(a, b, same_pixels(a, b))
}

/// Compares the images on one detector.
fn image_lines(a: &Measured, b: &Measured) -> [Line; 4] {
    let by = comparing(a, b);
    let (mean, unit) = ("mean of the image".to_owned(), "of the beam");
    [
        mean_line(mean, unit, [&a.intensity, &b.intensity], 0.0, &by),
        distribution("intensity of columns", unit, [&a.intensities, &b.intensities], &by),
        noise(a, b),
        spectra(a, b, &by),
    ]
}

/// Returns the names of the detectors, without the main ones, that both worlds have. The mean of a centre of mass is about 0, and is not
/// compared.
fn common_detectors([a, b]: &[WorldFile; 2]) -> Vec<String> {
    let there = |name: &String| b.detectors().iter().skip(1).any(|d| d.name == *name);
    let counted = a.detectors().iter().skip(1).filter(|d| !d.is_deflection());
    counted.map(|d| d.name.clone()).filter(there).collect()
}

/// Compares the detectors of both worlds; `None` if neither has names for them.
fn detectors_line([a, b]: &[WorldFile; 2]) -> Option<Line> {
    let names = |w: &WorldFile| -> Vec<String> {
        let all = w.detectors().iter();
        all.map(|d| format!("{} {}-{} mrad", d.name, d.inner_mrad, d.outer_mrad)).collect()
    };
    let (a, b) = (names(a), names(b));
    let text = |names: &[String]| match names.is_empty() {
        true => "one without a name".to_owned(),
        false => names.join(", "),
    };
    let same = a == b;
    (!a.is_empty() || !b.is_empty()).then(|| Line {
        what: "detectors".into(),
        unit: "",
        a: None,
        b: None,
        text: format!("{} | {}", text(&a), text(&b)),
        test: "the same list",
        statistic: f64::from(u8::from(!same)),
        p: f64::from(u8::from(same)),
        verdict: if same { Sameness::Same } else { Sameness::Different },
    })
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

/// Compares means over the fields.
fn mean_line(
    what: String,
    unit: &'static str,
    [a, b]: [&Vec<(f64, f64)>; 2],
    least_error: f64,
    by: &Comparing,
) -> Line {
    let (test, t, p, [of_a, of_b]) = match by {
        Comparing::Waves { blocks, .. } => {
            let found = blocks.difference(a, b);
            // Waves give the error of the difference, to which both worlds contribute alike.
            let error = found.error * std::f64::consts::FRAC_1_SQRT_2;
            let ratios = [a, b].map(|v| Ratio { error, ..Ratio::of_blocks(v) });
            ("t of the difference, error from slow waves over the field", found.t, found.p, ratios)
        }
        Comparing::Parts([first, second]) => {
            let parts = [first.sums(a), second.sums(b)];
            let ratios = parts.each_ref().map(|v| Ratio::of_blocks(v));
            let t = ratios[0].z(ratios[1], least_error);
            let freedom = first.count().min(second.count()).saturating_sub(1);
            let p = if t == 0.0 { 1.0 } else { student_two_sided(t, freedom) };
            ("t of the difference, errors from parts of the fields", t, p, ratios)
        }
        Comparing::Nothing(_) => ("none", f64::NAN, 1.0, [a, b].map(|v| Ratio::of_blocks(v))),
    };
    let known = !(t.is_nan() || p.is_nan());
    Line {
        what,
        unit,
        a: Some(of_a),
        b: Some(of_b),
        text: by.why_not(),
        test,
        statistic: if known { t } else { 0.0 },
        p: if known { p } else { 1.0 },
        verdict: if known { Sameness::Same } else { Sameness::Undecided },
    }
}

/// Compares rates of events. From parts of each field the error is at least the error of independent events.
fn rate(what: String, blocks: [&Vec<(f64, f64)>; 2], by: &Comparing) -> Line {
    let sum = |v: &[(f64, f64)]| v.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
    let least = binomial_error(sum(blocks[0]), sum(blocks[1]));
    mean_line(what, "", blocks, least, by)
}

fn distribution(
    what: &str,
    unit: &'static str,
    [a, b]: [&Vec<(u32, f32)>; 2],
    by: &Comparing,
) -> Line {
    let mean =
        |s: &[(u32, f32)]| s.iter().map(|(_, v)| f64::from(*v)).sum::<f64>() / s.len() as f64;
    let few = a.is_empty() && b.is_empty();
    let (test, ks) = match by {
        Comparing::Waves { blocks, .. } => (
            "two-sample Kolmogorov-Smirnov, turned with slow waves over the field",
            Some(kolmogorov_smirnov(a, b, Places::Same(blocks))),
        ),
        Comparing::Parts([first, second]) => {
            let places = Places::Any([first.count(), second.count()]);
            let found = kolmogorov_smirnov(&first.values(a), &second.values(b), places);
            ("two-sample Kolmogorov-Smirnov, parts exchanged", Some(found))
        }
        Comparing::Nothing(_) => ("none", None),
    };
    let known = ks.filter(|_| !few);
    Line {
        what: what.into(),
        unit,
        a: plain(mean(a)).filter(|r| r.value.is_finite()),
        b: plain(mean(b)).filter(|r| r.value.is_finite()),
        text: match by {
            Comparing::Nothing(_) => by.why_not(),
            _ => "means of the distributions".into(),
        },
        test,
        statistic: known.map_or(0.0, |ks| ks.distance),
        p: known.map_or(1.0, |ks| ks.p),
        verdict: if known.is_some() { Sameness::Same } else { Sameness::Undecided },
    }
}

/// Compares the doses that follow from the noise beyond the optical limit. Electrons are counted one by one, so segments are independent.
fn noise(a: &Measured, b: &Measured) -> Line {
    let dose = |r: Ratio| Ratio { value: 1.0 / r.value, error: r.error / (r.value * r.value) };
    let enough = [a, b].iter().all(|m| m.spectrum.noise.len() >= FEWEST_SEGMENTS);
    let [of_a, of_b] = [a, b].map(|m| Ratio::of_blocks(&m.spectrum.noise));
    let error = match same_pixels(a, b) {
        true => paired_error(&a.spectrum.noise, &b.spectrum.noise),
        false => of_a.error.hypot(of_b.error),
    };
    let difference = of_a.value - of_b.value;
    let t = if difference == 0.0 { 0.0 } else { difference / error };
    let known = enough && !t.is_nan();
    let freedom = a.spectrum.noise.len().min(b.spectrum.noise.len()).saturating_sub(1);
    Line {
        what: "dose estimated from the noise".into(),
        unit: "electrons per A2",
        a: Some(dose(of_a)),
        b: Some(dose(of_b)),
        text: String::new(),
        test: "t of the noise power beyond the optical limit",
        statistic: if known { t } else { 0.0 },
        p: if known { student_two_sided(t, freedom) } else { 1.0 },
        verdict: if known { Sameness::Same } else { Sameness::Undecided },
    }
}

/// Compares the spectra by their largest difference over all bands.
fn spectra(a: &Measured, b: &Measured, by: &Comparing) -> Line {
    let few = [a, b].iter().any(|m| m.spectrum.segments.len() < FEWEST_SEGMENTS);
    let bands = a.spectrum.bands.count;
    let (test, found) = match by {
        _ if few => ("none", None),
        Comparing::Waves { segments, .. } => {
            let pairs = a.spectrum.segments.iter().zip(&b.spectrum.segments);
            let difference = |(a, b): (&Vec<f64>, &Vec<f64>)| -> Vec<f64> {
                a.iter().zip(b).map(|(a, b)| a - b).collect()
            };
            let found = segments.largest_in_errors(&pairs.map(difference).collect::<Vec<_>>());
            ("largest t over all bands, turned with slow waves over the field", Some(found))
        }
        Comparing::Parts(_) => {
            let ratios = a.spectrum.ratio(&b.spectrum);
            let z = ratios.iter().map(|r| (r.value.ln() / r.error).abs());
            let largest = z.filter(|z| z.is_finite()).fold(0.0, f64::max);
            let p = 1.0 - (1.0 - two_sided(largest)).powf(bands.max(1) as f64);
            ("largest z of the ratio over all bands, Sidak", Some((largest, p)))
        }
        Comparing::Nothing(_) => ("none", None),
    };
    let bands = format!("{bands} bands up to {:.1} 1/nm", a.spectrum.highest());
    Line {
        what: "power spectrum of the image".into(),
        unit: "",
        a: None,
        b: None,
        text: match by {
            Comparing::Nothing(_) => by.why_not(),
            _ => bands,
        },
        test,
        statistic: found.map_or(0.0, |f| f.0),
        p: found.map_or(1.0, |f| f.1),
        verdict: if found.is_some() { Sameness::Same } else { Sameness::Undecided },
    }
}
