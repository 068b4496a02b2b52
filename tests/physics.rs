//! Engines against each other, beyond the cases of the shipped suite (`tests/validate.rs`).

use stemgen::detect::Detector;
use stemgen::engine::{
    Algorithm, Images, Phonons, Plan, ProbeBox, Scan, Settings, Site, simulate, window_for,
};
use stemgen::optics::{Aberration, Optics};
use stemgen::progress::Silent;

const A: f64 = 3.905;

/// SrTiO3 [001], nx x ny x nz cells, the first plane a quarter cell below the surface.
fn srtio3(cells: [usize; 3]) -> (Vec<Site>, [f64; 3]) {
    let basis: [(u8, [f64; 3], f64); 5] = [
        (38, [0.0, 0.0, 0.0], 0.084),
        (22, [0.5, 0.5, 0.5], 0.060),
        (8, [0.5, 0.5, 0.0], 0.085),
        (8, [0.5, 0.0, 0.5], 0.085),
        (8, [0.0, 0.5, 0.5], 0.085),
    ];
    let mut sites = Vec::new();
    for ix in 0..cells[0] {
        for iy in 0..cells[1] {
            for iz in 0..cells[2] {
                for (number, p, sigma_angstrom) in basis {
                    let position = [
                        (ix as f64 + p[0]) * A,
                        (iy as f64 + p[1]) * A,
                        (iz as f64 + p[2] + 0.25) * A,
                    ];
                    let key = sites.len() as u64;
                    sites.push(Site { position, number, sigma_angstrom, key });
                }
            }
        }
    }
    (sites, cells.map(|n| n as f64 * A))
}

fn plan(settings: &Settings, sites: &[Site], cell: [f64; 3]) -> Plan {
    let z: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
    Plan::new(settings, cell, &z).unwrap()
}

fn unit_cell_scan(n: usize) -> Scan {
    let step = A / n as f64;
    Scan { origin_angstrom: [A, A], step_angstrom: [step, step], shape: [n, n] }
}

fn four_detectors() -> Vec<Detector> {
    vec![
        Detector::new("BF", 0.0, 10.0),
        Detector::new("ABF", 10.0, 21.0),
        Detector::new("ADF", 30.0, 68.0),
        Detector::new("HAADF", 68.0, 200.0),
    ]
}

fn largest_difference(a: &ndarray::ArrayView2<f32>, b: &ndarray::ArrayView2<f32>) -> f32 {
    let top = b.iter().fold(0.0_f32, |m, v| m.max(*v));
    a.iter().zip(b).map(|(x, y)| (x - y).abs() / top).fold(0.0, f32::max)
}

#[test]
fn prism_without_interpolation_is_multislice() {
    let (sites, cell) = srtio3([3, 3, 4]);
    let base = Settings {
        detectors: four_detectors(),
        phonons: Some(Phonons { configurations: 1, seed: 3 }),
        thicknesses_angstrom: vec![2.0 * A, 4.0 * A],
        ..Settings::default()
    };
    let scan = unit_cell_scan(5);
    let run = |algorithm| {
        let settings = Settings { algorithm, ..base.clone() };
        simulate(&plan(&settings, &sites, cell), &sites, &scan, &Silent).unwrap()
    };
    let exact = run(Algorithm::Multislice);
    let prism = run(Algorithm::Prism { interpolation: [1, 1] });
    for t in 0..2 {
        for d in 0..4 {
            let error = largest_difference(&prism.image(t, d), &exact.image(t, d));
            assert!(error < 1e-5, "thickness {t}, detector {d}: {error}");
        }
    }
}

#[test]
fn prism_with_aberrations_and_different_factors_per_axis_stays_close() {
    let (sites, cell) = srtio3([6, 6, 3]);
    let mut optics = Optics::default();
    for text in ["C10=-60", "C12=20@0.4", "C21=1e3@1.1", "C30=5e4"] {
        optics.aberrations.0.push(Aberration::parse(text).unwrap());
    }
    let base = Settings { detectors: four_detectors(), optics, ..Settings::default() };
    let scan = unit_cell_scan(3);
    let run = |algorithm| {
        let settings = Settings { algorithm, ..base.clone() };
        simulate(&plan(&settings, &sites, cell), &sites, &scan, &Silent).unwrap()
    };
    let exact = run(Algorithm::Multislice);
    for (interpolation, tolerance) in [([1, 1], 1e-5), ([1, 2], 0.02), ([2, 2], 0.03)] {
        let prism = run(Algorithm::Prism { interpolation });
        let error = largest_difference(&prism.image(0, 3), &exact.image(0, 3));
        assert!(error < tolerance, "{interpolation:?}: {error}");
    }
}

/// Root mean square difference of two images over the mean of the second.
fn rms(a: &Images, b: &Images) -> f32 {
    let (a, b) = (a.image(0, 0), b.image(0, 0));
    let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
    (square / a.len() as f32).sqrt() / b.mean().unwrap()
}

#[test]
fn windows_agree_with_the_full_grid() {
    let (sites, cell) = srtio3([6, 6, 10]);
    let base =
        Settings { phonons: Some(Phonons { configurations: 1, seed: 2 }), ..Settings::default() };
    let scan = unit_cell_scan(4);
    let run = |settings: &Settings| {
        simulate(&plan(settings, &sites, cell), &sites, &scan, &Silent).unwrap()
    };
    let exact = run(&Settings { probe_box: Some(ProbeBox::Large), ..base.clone() });
    for accuracy in [0.4, 0.8, 2.1] {
        let choice = window_for(accuracy, &base, cell[2]).unwrap();
        let algorithm = Algorithm::Window { width_angstrom: choice.width_angstrom };
        let windowed = Settings { algorithm, ..base.clone() };
        let error = 100.0 * rms(&run(&windowed), &exact);
        let without = 100.0 * rms(&run(&Settings { tail_correction: false, ..windowed }), &exact);
        println!("{accuracy} %, {algorithm:?}: rms {error} %, without the tail {without} %");
        assert!(error < accuracy as f32, "{accuracy}: {error}");
        assert!(accuracy > 1.0 || error < 0.9 * without, "{accuracy}: {error} {without}");
    }
}

/// Cores in closed form against potentials exponentiated on ever finer grids: SrTiO3, and Sr atoms in
/// disorder. (Much heavier atoms cannot be extrapolated so: what a grid misses at the nucleus turns in
/// phase with the logarithm of its pixel.)
#[test]
fn cores_in_closed_form_agree_with_refined_potentials() {
    let (perovskite, cell) = srtio3([3, 3, 4]);
    let disorder: Vec<Site> = (0..24)
        .map(|i| {
            let turn = f64::from(i) * 0.618_034;
            let position = [f64::from(i) * 0.49, turn.fract() * 11.7, 1.9 * f64::from(i % 6) + 1.0];
            Site { position, number: 38, sigma_angstrom: 0.0, key: i as u64 }
        })
        .collect();
    for (sites, cell) in [(perovskite, cell), (disorder, [11.76, 11.7, 11.4])] {
        let base = Settings::default();
        let run = |oversampling| {
            let settings = Settings { oversampling, ..base.clone() };
            simulate(&plan(&settings, &sites, cell), &sites, &unit_cell_scan(3), &Silent).unwrap()
        };
        let (coarse, fine) = (run(Some(3)), run(Some(6)));
        // the error of exponentials on a grid falls with the square of its pixel
        let mut limit = fine.clone();
        limit.data = (&fine.data * 4.0 - &coarse.data) / 3.0;
        let (ours, theirs) = (rms(&run(None), &limit), rms(&coarse, &limit));
        println!("cores: {ours}, potentials x3: {theirs}");
        assert!(ours < 2e-3 && ours < 0.5 * theirs, "{ours} {theirs}");
    }
}
