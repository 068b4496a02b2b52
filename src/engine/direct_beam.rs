//! Corrects the share of the beam that low-angle detectors miss because probes are cropped.
//!
//! Large boxes are cropped to the cell, and with them the tail of a probe. The electrons of the tail that pass the specimen unscattered
//! belong on detectors within the aperture, so their images lack a few per cent, nearly the same everywhere. A factor makes vacuum right. In
//! windows the tail's wave is added (`engine::coherent_tail`), and the factor is for the soft edge of the aperture.

use super::plan::Plan;
use super::probe::Probe;
use super::settings::Settings;
use crate::detect::{CentreOfMass, Detector};
use num_complex::Complex32;

/// Smallest share of the beam, without a specimen, on a detector that is corrected. Detectors with less see scattered electrons.
const LEAST_SHARE: f64 = 0.05;

/// The factors by which the images on each detector are multiplied, so that vacuum is right. `in_windows` makes the shares of the beam that
/// detectors in windows see without a specimen. A factor is 1 where nothing is cropped, where the settings do not ask for the correction, and
/// for detectors that see little of the direct beam.
pub(super) fn direct_beam_factors(
    plan: &Plan,
    in_windows: impl FnOnce() -> Option<Vec<f64>>,
) -> Vec<f64> {
    let settings = &plan.settings;
    let shares: Vec<f64> = settings.detectors.iter().map(|d| direct_share(settings, d)).collect();
    let cropped = settings.large_probe_box() && settings.tail_correction;
    if !(cropped && settings.direct_beam) || shares.iter().all(|share| *share < LEAST_SHARE) {
        return vec![1.0; shares.len()];
    }
    let found = in_windows().unwrap_or_else(|| found_in_the_middle(plan));
    let factor = |(share, found): (&f64, f64)| match *share >= LEAST_SHARE && found > 0.0 {
        true => share / found,
        false => 1.0,
    };
    let mut factors: Vec<f64> = shares.iter().zip(found).map(factor).collect();
    // All parts of a centre of mass have the factor of its electrons, so that it stays as it is.
    let mut electrons = 1.0;
    for (detector, factor) in settings.detectors.iter().zip(&mut factors) {
        match detector.centre_of_mass {
            None => {}
            Some(CentreOfMass::Electrons) => electrons = *factor,
            Some(_) => *factor = electrons,
        }
    }
    factors
}

/// The share of the beam on a detector without a specimen.
fn direct_share(settings: &Settings, detector: &Detector) -> f64 {
    let semiangle = settings.optics.semiangle_mrad;
    let part = |([inner, outer], share): ([f64; 2], f64)| {
        let outer = outer.min(semiangle);
        share * (outer * outer - inner * inner).max(0.0) / semiangle.powi(2)
    };
    detector.azimuth_share() * detector.annuli(semiangle).into_iter().map(part).sum::<f64>()
}

/// The share of a probe in the middle of its window or box that falls on each detector without a specimen.
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
