//! Finds settings that are often wrong where two images differ: one setting at a time is changed, and a few probes are simulated.

use ndarray::Array2;

use super::difference::best_gain;
use super::image_comparison::ImageComparison;
use crate::detect::Detector;
use crate::engine::{Algorithm, Plan, Settings, simulate_places};
use crate::error::Result;
use crate::optics::{Aberration, Aberrations};
use crate::potential::slices::Slicing;
use crate::progress::Progress;

/// Number of probes that are simulated for each change.
const PROBES: usize = 24;
/// Beam energies of common microscopes in keV.
const ENERGIES_KEV: [f64; 8] = [30.0, 40.0, 60.0, 80.0, 100.0, 120.0, 200.0, 300.0];
/// Tilts in mrad that are tried if no tilt is set.
const TILT_MRAD: f64 = 5.0;
/// Spherical aberrations C30 of lenses without a corrector, in Angstrom, and the largest semiangle in mrad with which they are used.
const UNCORRECTED: ([f64; 2], f64) = ([1e7, 1.2e7], 15.0);
/// Thicknesses of equal slices in Angstrom.
const SLICES_ANGSTROM: [f64; 3] = [0.5, 1.0, 2.0];

/// A setting that is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Suspect {
    /// The defocus, mainly its sign.
    Defocus,
    /// Another aberration: its sign, its size or its azimuth.
    Aberration,
    /// The energy of the beam.
    Energy,
    /// The convergence semiangle, which may have been given as a full angle, or in degrees.
    Semiangle,
    /// The edges of the detector.
    Detector,
    /// The slices.
    Slices,
    /// The tilt of the specimen.
    Tilt,
}

/// A change of a setting, and the difference that it leaves.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TriedChange {
    /// The setting.
    pub suspect: Suspect,
    /// The change in words: `defocus -50 A in place of 50 A`.
    pub words: String,
    /// Rms difference that is left at the probes, divided by the mean.
    pub rms: f64,
}

/// The differences that the changes leave.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LikelySettings {
    /// Number of probes.
    pub probes: usize,
    /// Rms difference at the probes without a change, divided by the mean.
    pub now: f64,
    /// The best change of each setting, the best first.
    pub tried: Vec<TriedChange>,
}

/// Some pixels of an image, with the values of the reference.
struct SampledPixels {
    places: Vec<[f64; 2]>,
    reference: Vec<f64>,
    mean: f64,
    /// Whether a factor is fitted to the reference.
    fitted: bool,
}

/// A change of the settings, described in words; one simulation may show several detectors, with one description each.
struct Change {
    suspect: Suspect,
    settings: Settings,
    words: Vec<String>,
}

/// Tries the settings that are most often wrong. `ours` is our image with the present settings, `reference` the other one with its factor.
///
/// # Errors
/// Errors of the engine. Changes that the grid cannot carry are left out.
pub(crate) fn likely_settings(
    progress: &dyn Progress,
    c: &ImageComparison,
    ours: &Array2<f64>,
    reference: &Array2<f64>,
    fitted: bool,
) -> Result<Option<LikelySettings>> {
    // PRISM does not simulate single probes.
    if matches!(c.plan.settings.algorithm, Algorithm::Prism { .. }) {
        return Ok(None);
    }
    let (sample, own) = sample(c, ours, reference, fitted);
    let mut tried: Vec<TriedChange> = Vec::new();
    for change in changes(&c.plan.settings, c.plan.band_limit_mrad) {
        let Ok(plan) = Plan::new(&change.settings, c.box_angstrom, c.heights_angstrom) else {
            continue;
        };
        let found = simulate_places(&[plan], &[c.sites], &sample.places, progress)?;
        let Some(images) = found.first() else { continue };
        for (detector, words) in change.words.into_iter().enumerate() {
            let values: Vec<f64> =
                images.image(0, detector).iter().map(|v| f64::from(*v)).collect();
            let rms = sample.rms(&values);
            tried.push(TriedChange { suspect: change.suspect, words, rms });
        }
    }
    tried.sort_by(|a, b| a.rms.total_cmp(&b.rms));
    let mut best: Vec<TriedChange> = Vec::new();
    for change in tried {
        if best.iter().all(|b| b.suspect != change.suspect) {
            best.push(change);
        }
    }
    Ok(Some(LikelySettings { probes: own.len(), now: sample.rms(&own), tried: best }))
}

/// Selects pixels whose values are distributed like the values of the whole image; also returns our values there.
fn sample(
    c: &ImageComparison,
    ours: &Array2<f64>,
    reference: &Array2<f64>,
    fitted: bool,
) -> (SampledPixels, Vec<f64>) {
    let mut pixels: Vec<((usize, usize), f64)> =
        reference.indexed_iter().map(|(at, v)| (at, *v)).collect();
    pixels.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    let count = pixels.len().min(PROBES);
    let last = (pixels.len() - 1) as f64;
    let rank = |n: usize| (n as f64 * last / (count.max(2) - 1) as f64).round() as usize;
    let chosen: Vec<_> = (0..count).map(|n| pixels[rank(n)]).collect();
    let (origin, step) = (c.scan.origin_angstrom, c.scan.step_angstrom);
    let place = |(row, column): (usize, usize)| {
        [origin[0] + column as f64 * step[0], origin[1] + row as f64 * step[1]]
    };
    let sample = SampledPixels {
        places: chosen.iter().map(|(at, _)| place(*at)).collect(),
        reference: chosen.iter().map(|(_, v)| *v).collect(),
        mean: reference.mean().unwrap_or(f64::NAN).abs(),
        fitted,
    };
    (sample, chosen.iter().map(|(at, _)| ours[*at]).collect())
}

impl SampledPixels {
    fn rms(&self, values: &[f64]) -> f64 {
        let row = |values: &[f64]| Array2::from_shape_fn((1, values.len()), |(_, n)| values[n]);
        let (ours, reference) = (row(values), row(&self.reference));
        let factor = if self.fitted { best_gain(reference.view(), ours.view()) } else { 1.0 };
        let squares = ours.iter().zip(&reference).map(|(a, b)| (a - factor * b).powi(2));
        (squares.sum::<f64>() / values.len() as f64).sqrt() / (self.mean * factor.abs())
    }
}

/// Lists all changes, the cheapest first.
fn changes(settings: &Settings, band_limit_mrad: f64) -> Vec<Change> {
    let mut changes = vec![detectors(settings, band_limit_mrad)];
    let mut add = |suspect, words: String, change: &dyn Fn(&mut Settings)| {
        let mut settings = settings.clone();
        change(&mut settings);
        changes.push(Change { suspect, settings, words: vec![words] });
    };
    let optics = &settings.optics;
    let defocus = optics.aberrations.defocus_angstrom();
    let others: Vec<f64> = match defocus {
        0.0 => Vec::new(),
        defocus => vec![-defocus, 0.0, 10.0 * defocus, 0.1 * defocus],
    };
    for other in others {
        let words = format!("defocus {other} A in place of {defocus} A");
        add(Suspect::Defocus, words, &|s| set_defocus(&mut s.optics.aberrations, other));
    }
    for (number, words, other) in other_aberrations(&optics.aberrations) {
        add(Suspect::Aberration, words, &|s| s.optics.aberrations.0[number] = other);
    }
    let spherical = optics.aberrations.0.iter().any(|a| (a.order, a.symmetry) == (3, 0));
    for magnitude_angstrom in UNCORRECTED.0 {
        if spherical || optics.semiangle_mrad > UNCORRECTED.1 {
            break;
        }
        let words = format!("C30 {magnitude_angstrom} A in place of 0 A");
        let lens = Aberration { order: 3, symmetry: 0, magnitude_angstrom, azimuth_rad: 0.0 };
        add(Suspect::Aberration, words, &|s| s.optics.aberrations.0.push(lens));
    }
    let energy = optics.energy_kev;
    for other in ENERGIES_KEV.into_iter().filter(|e| (e / energy - 1.0).abs() > 0.01) {
        let words = format!("energy {other} keV in place of {energy} keV");
        add(Suspect::Energy, words, &|s| s.optics.energy_kev = other);
    }
    let semiangle = optics.semiangle_mrad;
    for factor in [0.5, 2.0, 0.9, 1.1] {
        let other = factor * semiangle;
        let words = format!("a semiangle of {other:.1} mrad in place of {semiangle} mrad");
        add(Suspect::Semiangle, words, &|s| s.optics.semiangle_mrad = other);
    }
    for thickness in SLICES_ANGSTROM {
        let other = Slicing::ThicknessFromFace(thickness);
        if settings.slicing != other {
            let words = format!("even slices of {thickness} A");
            add(Suspect::Slices, words, &|s| s.slicing = other);
        }
    }
    let [x, y] = optics.tilt_mrad;
    let tilts = match [x, y] {
        [0.0, 0.0] => {
            vec![[TILT_MRAD, 0.0], [-TILT_MRAD, 0.0], [0.0, TILT_MRAD], [0.0, -TILT_MRAD]]
        }
        _ => vec![[-x, -y], [y, x], [0.0, 0.0], [x, -y], [-x, y]],
    };
    for other in tilts.into_iter().filter(|other| *other != [x, y]) {
        let words = format!("a tilt of {}, {} mrad in place of {x}, {y} mrad", other[0], other[1]);
        add(Suspect::Tilt, words, &|s| s.optics.tilt_mrad = other);
    }
    changes
}

/// Returns a change to other edges of the detector, all in one simulation.
fn detectors(settings: &Settings, band_limit_mrad: f64) -> Change {
    let own = &settings.detectors[0];
    let (inner, outer) = (own.inner_mrad, own.outer_mrad);
    let edges = [
        (0.5 * inner, 0.5 * outer),
        (2.0 * inner, 2.0 * outer),
        (0.5 * inner, outer),
        (2.0 * inner, outer),
        (inner, 0.5 * outer),
        (inner, 2.0 * outer),
        (0.9 * inner, outer),
        (1.1 * inner, outer),
        (inner, 0.9 * outer),
        (inner, band_limit_mrad.floor()),
    ];
    let possible = |(low, high): &(f64, f64)| low < high && *high <= band_limit_mrad;
    let edges: Vec<_> =
        edges.into_iter().filter(possible).filter(|e| *e != (inner, outer)).collect();
    let detectors = edges.iter().enumerate().map(|(n, (low, high))| Detector {
        name: format!("tried {n}"),
        inner_mrad: *low,
        outer_mrad: *high,
        ..own.clone()
    });
    let words = edges.iter().map(|(low, high)| {
        format!("a detector from {low:.1} to {high:.1} mrad in place of {inner} to {outer} mrad")
    });
    Change {
        suspect: Suspect::Detector,
        settings: Settings { detectors: detectors.collect(), ..settings.clone() },
        words: words.collect(),
    }
}

/// Lists changes of all aberrations but the defocus: the number of the aberration, the change in words, and the changed aberration.
fn other_aberrations(aberrations: &Aberrations) -> Vec<(usize, String, Aberration)> {
    let mut changes = Vec::new();
    let others = aberrations.0.iter().enumerate();
    for (number, a) in others.filter(|(_, a)| (a.order, a.symmetry) != (1, 0)) {
        let name = format!("C{}{}", a.order, a.symmetry);
        let now = a.magnitude_angstrom;
        for magnitude_angstrom in [-now, 0.0, 10.0 * now, 0.1 * now] {
            let words = format!("{name} {magnitude_angstrom} A in place of {now} A");
            changes.push((number, words, Aberration { magnitude_angstrom, ..*a }));
        }
        if a.symmetry > 0 && a.azimuth_rad != 0.0 {
            let (now, azimuth_rad) = (a.azimuth_rad, -a.azimuth_rad);
            let words = format!("{name} at {azimuth_rad} rad in place of {now} rad");
            changes.push((number, words, Aberration { azimuth_rad, ..*a }));
        }
    }
    changes
}

/// Replaces the defocus; all other aberrations stay.
fn set_defocus(aberrations: &mut Aberrations, defocus_angstrom: f64) {
    aberrations.0.retain(|a| (a.order, a.symmetry) != (1, 0));
    aberrations.add_defocus(defocus_angstrom);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Optics;

    #[test]
    fn changes_are_of_one_setting_each() {
        let mut settings = Settings::default();
        settings.optics.aberrations.add_defocus(50.0);
        settings.optics.tilt_mrad = [3.0, -1.0];
        let astigmatism =
            Aberration { order: 1, symmetry: 2, magnitude_angstrom: 30.0, azimuth_rad: 0.3 };
        settings.optics.aberrations.0.push(astigmatism);
        let all = changes(&settings, 250.0);
        let words: Vec<&str> =
            all.iter().flat_map(|c| c.words.iter().map(String::as_str)).collect();
        for expected in [
            "defocus -50 A in place of 50 A",
            "C12 -30 A in place of 30 A",
            "C12 at -0.3 rad in place of 0.3 rad",
            "energy 80 keV in place of 200 keV",
            "a semiangle of 42.0 mrad in place of 21 mrad",
            "a semiangle of 18.9 mrad in place of 21 mrad",
            "even slices of 1 A",
            "a tilt of -3, 1 mrad in place of 3, -1 mrad",
            "a detector from 34.0 to 100.0 mrad in place of 68 to 200 mrad",
        ] {
            assert!(words.contains(&expected), "no `{expected}` in {words:?}");
        }
        let minus = all.iter().find(|c| c.words[0].starts_with("defocus -50")).unwrap();
        assert_eq!(minus.settings.optics.aberrations.defocus_angstrom(), -50.0);
        assert_eq!(minus.settings.optics.tilt_mrad, [3.0, -1.0]);
        let lacks = |words: &str| all.iter().all(|c| !c.words[0].starts_with(words));
        assert!(lacks("C10") && lacks("C30"));
        let uncorrected = Settings {
            optics: Optics { semiangle_mrad: 10.0, ..Optics::default() },
            ..Settings::default()
        };
        let all = changes(&uncorrected, 250.0);
        let lens = all.iter().find(|c| c.words[0].starts_with("C30 10000000 A")).unwrap();
        assert_eq!(lens.settings.optics.aberrations.0[0].magnitude_angstrom, 1e7);
    }
}
