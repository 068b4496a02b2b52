//! Comparison with arrays that abTEM 1.0.11 computed (see `golden/README.md`), beyond the cases of the
//! shipped suite (`tests/physics/validate.rs`).

use ndarray::{Array1, ArrayView2, Axis};
use stemgen::engine::{
    Algorithm, BeyondLimit, EXACT_BAND_FRACTION, GridChoice, ProbeBox, Scan, Settings, simulate,
};
use stemgen::optics::{Aberration, Aberrations};
use stemgen::potential::Slicing;
use stemgen::progress::Silent;
use stemgen::validate::Difference;
use stemgen::validate::golden::Golden;

/// The promise is 0.2 %.
const TOLERANCE: f64 = 2e-4;
const PRISM: Algorithm = Algorithm::Prism { interpolation: [1, 1] };

fn check(g: &Golden, settings: &Settings, reference: &str) {
    let images = simulate(&g.plan(settings).unwrap(), &g.sites, &g.scan(), &Silent).unwrap();
    let references = g.images(reference).unwrap();
    for (d, name) in images.detectors.iter().enumerate() {
        let expected: ArrayView2<f64> = references.index_axis(Axis(0), d);
        let ours = images.image(0, d).mapv(f64::from);
        let error = Difference::between(ours.view(), expected).largest;
        println!("{reference}, {name}: {error:.2e} of the maximum");
        assert!(error < TOLERANCE, "{reference}, {name}: {error}");
    }
}

/// Without interpolation PRISM is multislice: no array of its own is needed.
#[test]
#[ignore = "long"]
fn si_110_by_prism() {
    let g = Golden::load("si_110").unwrap();
    check(&g, &Settings { algorithm: PRISM, ..g.settings() }, "multislice");
}

/// abTEM's own PRISM normalises aberrated probes wrongly; ours agrees with its multislice.
#[test]
fn aberrated_probes_by_prism() {
    let g = Golden::load("srtio3_001_aberrated").unwrap();
    let mut settings = Settings { algorithm: PRISM, ..g.settings() };
    for term in ["C10=-80", "C12=30@0.3", "C21=2000@0.7", "C23=1500@0.2", "C30=1e5"] {
        settings.optics.aberrations.0.push(Aberration::parse(term).unwrap());
    }
    check(&g, &settings, "third_order");
}

/// Potentials on a finer grid, limited after the exponential.
#[test]
#[ignore = "long"]
fn oversampled_transmission_functions() {
    let g = Golden::load("displaced_bandlimit").unwrap();
    let expected = g.matrix("t_960_limited").unwrap();
    let slice = g.slice_angstrom();
    let mut settings = Settings {
        detectors: g.detectors(),
        beyond_limit: BeyondLimit::Warn,
        grid: GridChoice::Points([480, 480]),
        slicing: Slicing::Thickness(slice),
        oversampling: Some(2),
        band_taper: 0.02,
        band_fraction: EXACT_BAND_FRACTION,
        ..Settings::default()
    };
    settings.optics.aberrations = Aberrations::defocus(slice / 2.0);
    let plan = g.plan(&settings).unwrap();
    for (i, p) in g.positions().into_iter().enumerate() {
        let scan = Scan { origin_angstrom: p, step_angstrom: [1.0; 2], shape: [1, 1] };
        let images = simulate(&plan, &g.sites, &scan, &Silent).unwrap();
        for d in 0..4 {
            let ours = f64::from(images.data[[0, d, 0, 0]]);
            let theirs = expected[[i, d]];
            assert!(
                (ours / theirs - 1.0).abs() < 1e-3,
                "position {i}, detector {d}: {ours} {theirs}"
            );
        }
    }
}

/// Windows on displaced atoms, against abTEM refined in the grid.
#[test]
fn windows_of_displaced_atoms() {
    let g = Golden::load("displaced_refined").unwrap();
    let haadf = |name: &str| g.matrix(name).unwrap().column(3).to_owned();
    let limit: Array1<f64> = (haadf("exact_1920") * 4.0 - haadf("exact_960")) / 3.0;
    let base = Settings { detectors: Settings::default().detectors, ..g.converged_settings() };
    for (width_angstrom, tolerance) in [(7.8, 0.03), (11.7, 0.015)] {
        let algorithm = Algorithm::Window { width_angstrom };
        // abTEM's probe has norm 1 in the cell.
        let probe_box = Some(ProbeBox::Cell);
        let settings = Settings { algorithm, probe_box, ..base.clone() };
        let plan = g.plan(&settings).unwrap();
        let one = |origin_angstrom| {
            let scan = Scan { origin_angstrom, step_angstrom: [1.0; 2], shape: [1, 1] };
            f64::from(simulate(&plan, &g.sites, &scan, &Silent).unwrap().data[[0, 0, 0, 0]])
        };
        let ours: Array1<f64> = g.positions().into_iter().map(one).collect();
        let mean = limit.mean().unwrap();
        let errors = (&ours - &limit).mapv(|e| e / mean);
        println!("window {width_angstrom}: {errors:.4} of the mean");
        assert!(errors.iter().all(|e| e.abs() < tolerance), "{width_angstrom}: {errors}");
    }
}
