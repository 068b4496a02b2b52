//! The dose at which a defect is seen, from simulated images.

use stemgen::detectability::{
    DetectabilityJob, DetectabilityReport, DetectabilityRequest, DoseVerdict,
};
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};

/// A question about a recipe with few configurations and a coarse patch.
fn request(recipe: &str) -> DetectabilityRequest {
    let recipe = Recipe::load(recipe, Difficulty::Easy).unwrap().checked().unwrap();
    let mut request = DetectabilityRequest::of_recipe(&recipe).unwrap();
    (request.configurations, request.ring_mrad) = (6, 0.0);
    request.step_angstrom = Some(0.3);
    request
}

fn found(request: DetectabilityRequest) -> DetectabilityReport {
    DetectabilityJob::new(request, "material").unwrap().run(&Silent).unwrap()
}

#[test]
fn sulphur_of_a_layer_needs_far_less_dose_than_oxygen_of_a_crystal() {
    let layer = found(request("mos2"));
    let mut crystal = request("srtio3");
    crystal.thicknesses_nm = vec![2.0];
    let crystal = found(crystal);
    let dose = |report: &DetectabilityReport| {
        let needed = report.cases[0].detectors[0].needed();
        // A dose, or a lower limit of it.
        needed.electrons_per_angstrom2.or(needed.range[0]).unwrap()
    };
    let layer_result = &layer.cases[0].detectors[0];
    assert_eq!(layer_result.needed().verdict, DoseVerdict::Found);
    assert!(layer_result.contrast_percent < -20.0, "{layer_result:?}");
    assert!(dose(&crystal) > 10.0 * dose(&layer), "{} {}", dose(&crystal), dose(&layer));
    // At the needed dose the reported power is the power that was asked for.
    let mut again = request("mos2");
    again.doses = vec![dose(&layer), 4.0 * dose(&layer)];
    let again = found(again);
    let [one, four] = &again.cases[0].detectors[0].doses[..] else { panic!() };
    assert!((one.known.power - 0.9).abs() < 1e-6, "{one:?}");
    assert!((four.known.d_prime / one.known.d_prime - 2.0).abs() < 1e-9);
    let [error, half] = [one, four].map(|at| at.position_error_angstrom[0]);
    assert!((error / half - 2.0).abs() < 1e-9 && error > 0.0 && error < 1.0);
}

#[test]
fn equal_displacements_leave_little_scatter_in_the_difference() {
    let mut request = request("srtio3");
    (request.thicknesses_nm, request.configurations) = (vec![2.0], 8);
    request.defects = vec!["column:O".parse().unwrap(), "vacancy:O@top".parse().unwrap()];
    let report = found(request);
    let [column, one] = &report.cases[..] else { panic!() };
    assert_eq!((column.column.as_str(), one.column.as_str()), ("O5", "O5"));
    let information = |case: &stemgen::detectability::DetectabilityCase| {
        let found = &case.detectors[0];
        (found.information_angstrom2, found.information_error_angstrom2)
    };
    let ((all, error), (single, _)) = (information(column), information(one));
    assert!(error < 0.2 * all, "{error} {all}");
    // Five atoms change five times as much, so the information is about 25 times as large.
    assert!(all > 8.0 * single, "{all} {single}");
}

#[test]
fn the_best_annulus_needs_no_more_than_the_detector() {
    let mut request = request("mos2");
    request.ring_mrad = 20.0;
    let report = found(request);
    let case = &report.cases[0];
    let (best, rings) = (case.best_annulus.as_ref().unwrap(), case.all_rings.as_ref().unwrap());
    let detector = &case.detectors[0];
    assert!(best.annulus_mrad[0] < 68.0, "{best:?}");
    assert!(best.information_angstrom2 > detector.information_angstrom2);
    assert!(rings.information_angstrom2 >= 0.99 * best.information_angstrom2, "{rings:?} {best:?}");
}

#[test]
fn the_scatter_of_few_averaged_configurations_costs_dose() {
    let mut request = request("mos2");
    (request.configurations, request.averaged) = (16, Some(1));
    (request.experiments, request.doses) = (1000, vec![1e4]);
    let report = found(request);
    let result = &report.cases[0].detectors[0];
    let at = &result.doses[0];
    let [linear, mixture] = [&at.linear, &at.mixture].map(|test| test.as_ref().unwrap());
    // Errors of an area from 1000 experiments are below 0.02.
    assert!(linear.d_prime < 1.05 * at.known.d_prime, "{linear:?} {:?}", at.known);
    assert!(mixture.auc < at.known.auc + 0.02, "{mixture:?} {:?}", at.known);
}
