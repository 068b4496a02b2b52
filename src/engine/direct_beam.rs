//! The share of the beam that detectors at low angles miss because probes are cropped.
//!
//! Windows and large boxes crop the tail of a probe. What of it passes the specimen falls on detectors within the aperture, so that their
//! images lack a few per cent, nearly the same everywhere: 10.5-21 mrad of SrTiO3 (39 A, windows of 15.6 A) lacks 3.3 %, and is right
//! to 0.6 % when multiplied by the factor that makes it right without a specimen (docs/accuracy.md has more). Patterns add the tail
//! itself (`engine::patterns`).

use super::plan::Plan;
use super::probe::Probe;
use super::settings::Settings;
use crate::detect::Detector;
use num_complex::Complex32;

/// A detector on which less of the beam falls without a specimen is left as it is: what it sees is scattered.
const LEAST_SHARE: f64 = 0.05;

/// What the images on each detector are multiplied by, so that they are right without a specimen; 1 where nothing is cropped, where the
/// settings do not ask for it, and for detectors that see little of the beam itself.
pub(super) fn direct_beam_factors(plan: &Plan) -> Vec<f64> {
    let settings = &plan.settings;
    let shares: Vec<f64> = settings.detectors.iter().map(|d| direct_share(settings, d)).collect();
    let cropped = settings.large_probe_box() && settings.tail_correction;
    if !(cropped && settings.direct_beam) || shares.iter().all(|share| *share < LEAST_SHARE) {
        return vec![1.0; shares.len()];
    }
    let found = found_in_the_middle(plan);
    let factor = |(share, found): (&f64, f64)| match *share >= LEAST_SHARE && found > 0.0 {
        true => share / found,
        false => 1.0,
    };
    shares.iter().zip(found).map(factor).collect()
}

/// The share of the beam on a detector without a specimen.
pub fn direct_share(settings: &Settings, detector: &Detector) -> f64 {
    let semiangle = settings.optics.semiangle_mrad;
    let part = |([inner, outer], share): ([f64; 2], f64)| {
        let outer = outer.min(semiangle);
        share * (outer * outer - inner * inner).max(0.0) / semiangle.powi(2)
    };
    detector.annuli(semiangle).into_iter().map(part).sum()
}

/// What each detector finds, without a specimen, of a probe in the middle of its window or box.
fn found_in_the_middle(plan: &Plan) -> Vec<f64> {
    let grid = plan.wave_grid;
    let [columns, rows] = grid.points;
    let map = plan.detector_map(&grid, columns, plan.detector_ramp_mrad());
    let mut sum = vec![0.0; plan.settings.detectors.len()];
    for (weight, plan) in plan.at_foci() {
        let probe = Probe::new(&plan);
        let coefficients = probe.at(&plan, grid.extent_angstrom.map(|l| 0.5 * l));
        let mut wave = vec![Complex32::ZERO; rows * columns];
        for ((row, column), value) in probe.bins.iter().zip(coefficients) {
            wave[row * columns + column] = value;
        }
        let mut found = vec![0.0; sum.len()];
        map.collect(&wave, weight, &mut found);
        sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
    }
    sum
}
