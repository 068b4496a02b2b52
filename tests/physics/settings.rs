//! Any finite settings give finite images, or an error that names one.

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestCaseResult, TestRng, TestRunner};
use stemgen::detect::Detector;
use stemgen::engine::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, Plan, ProbeBox, ProbeStep, Scan,
    Settings, simulate,
};
use stemgen::optics::{Aberration, Aberrations};
use stemgen::potential::{Projection, Slicing};
use stemgen::progress::Silent;
use stemgen::structure::Site;

const CELL: [f64; 3] = [6.0, 7.0, 4.0];

/// A usual value more often than not, or any finite one.
fn value(usual: f64) -> impl Strategy<Value = f64> {
    let edges = [0.0, -1.0, 1e-308, 5e-324, 1e-9, 0.5, 1.0, 2.0, 1e3, 1e9, 1e308, -1e308, f64::MAX];
    prop_oneof![
        60 => (0.8..1.25).prop_map(move |f: f64| f * usual),
        2 => proptest::sample::select(edges.to_vec()),
        1 => any::<f64>().prop_filter("finite", |v| v.is_finite()),
    ]
}

fn algorithm() -> impl Strategy<Value = Algorithm> {
    let factor = prop_oneof![20 => 1_usize..3, 1 => Just(0), 1 => any::<usize>()];
    prop_oneof![
        Just(Algorithm::Multislice),
        [factor.clone(), factor].prop_map(|interpolation| Algorithm::Prism { interpolation }),
        value(5.0).prop_map(|width_angstrom| Algorithm::Window { width_angstrom }),
    ]
}

fn optics_and_detectors() -> impl Strategy<Value = (Settings, [f64; 2])> {
    (
        value(200.0),
        value(20.0),
        value(50.0),
        value(0.3),
        0_u8..6,
        [value(60.0), value(120.0)],
        value(1.0),
    )
        .prop_map(
            |(energy, semiangle, magnitude, azimuth_rad, order, [inner, outer], scan)| {
                let mut settings = Settings::default();
                settings.optics.energy_kev = energy;
                settings.optics.semiangle_mrad = semiangle;
                let aberration = Aberration {
                    order,
                    symmetry: (order + 1) % 2,
                    magnitude_angstrom: magnitude,
                    azimuth_rad,
                };
                settings.optics.aberrations = Aberrations(vec![aberration]);
                settings.detectors = vec![Detector::new("a", inner, outer)];
                (settings, [scan, 0.5])
            },
        )
}

fn numerics() -> impl Strategy<Value = Settings> {
    let grid = prop_oneof![
        3 => Just(GridChoice::Auto),
        1 => value(0.1).prop_map(GridChoice::Sampling),
        1 => [0_usize..200, 0_usize..200].prop_map(GridChoice::Points),
    ];
    let slicing = prop_oneof![
        Just(Slicing::Planes),
        value(1.0).prop_map(Slicing::Thickness),
        value(0.5).prop_map(Slicing::Grouped),
        value(0.5).prop_map(Slicing::Local),
    ];
    let step = prop_oneof![
        Just(ProbeStep::Auto),
        Just(ProbeStep::Scan),
        value(0.3).prop_map(ProbeStep::Angstrom)
    ];
    let expansion = prop_oneof![
        Just(Expansion::Auto),
        Just(Expansion::Off),
        value(0.01).prop_map(Expansion::Error)
    ];
    let projection = prop_oneof![3 => Just(Projection::Infinite), 1 => Just(Projection::Finite)];
    let phonons = proptest::option::of(0_u32..3);
    let thickness = proptest::option::of(value(3.0));
    let tail =
        (value(1.2), value(0.7), value(0.02), proptest::option::of(0_usize..4), any::<[bool; 3]>());
    ((grid, slicing, step, expansion, projection), phonons, thickness, algorithm(), tail).prop_map(
        |(
            (grid, slicing, probe_step, expansion, projection),
            phonons,
            thickness,
            algorithm,
            tail,
        )| {
            let (angle_margin, band_fraction, band_taper, oversampling, [large, warn, tails]) =
                tail;
            Settings {
                grid,
                slicing,
                probe_step,
                expansion,
                projection,
                algorithm,
                angle_margin,
                band_fraction,
                band_taper,
                oversampling,
                tail_correction: tails,
                probe_box: large.then_some(ProbeBox::Large),
                beyond_limit: if warn { BeyondLimit::Warn } else { BeyondLimit::Error },
                phonons: phonons.map(|configurations| Phonons { configurations, seed: 1 }),
                thicknesses_angstrom: thickness.into_iter().collect(),
                ..Settings::default()
            }
        },
    )
}

fn sites() -> Vec<Site> {
    let site = |key, position, number| Site {
        position,
        number,
        sigma_angstrom: 0.08,
        anisotropy: None,
        key,
    };
    vec![site(0, [1.5, 1.5, 1.0], 38), site(1, [4.0, 5.0, 3.0], 8)]
}

/// Images that were made, of so many cases.
static IMAGES: AtomicUsize = AtomicUsize::new(0);
const CASES: u32 = 300;

#[test]
fn images_are_finite() {
    let config =
        ProptestConfig { cases: CASES, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner =
        TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let strategy = (optics_and_detectors(), numerics());
    runner.run(&strategy, |((optics, raster), numerics)| finite(optics, raster, numerics)).unwrap();
    let images = IMAGES.load(Relaxed);
    assert!(images > 30, "{images} images of {CASES} cases: most settings are refused");
}

fn finite(optics: Settings, [step, origin]: [f64; 2], numerics: Settings) -> TestCaseResult {
    let settings = Settings { optics: optics.optics, detectors: optics.detectors, ..numerics };
    let sites = sites();
    let heights: Vec<f64> = sites.iter().map(|site| site.position[2]).collect();
    let Ok(plan) = Plan::new(&settings, CELL, &heights) else { return Ok(()) };
    // What takes long is allowed; here it is not worth the time.
    let pixels = |n: [usize; 2]| n[0] * n[1];
    let largest = pixels(plan.potential_grid.points).max(pixels(plan.transmission_grid.points));
    if largest > 1 << 18 || plan.slices.len() > 40 || plan.beams > 2000 {
        return Ok(());
    }
    let scan = Scan { origin_angstrom: [origin; 2], step_angstrom: [step, 0.4], shape: [2, 3] };
    if let Ok(images) = simulate(&plan, &sites, &scan, &Silent) {
        IMAGES.fetch_add(1, Relaxed);
        for thickness in 0..plan.thicknesses_angstrom().len() {
            prop_assert!(images.image(thickness, 0).iter().all(|v| v.is_finite()));
        }
    }
    Ok(())
}
