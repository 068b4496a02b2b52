//! Engines against each other, beyond the cases of the shipped suite (`tests/physics/validate.rs`).

use stemgen::detect::Detector;
use stemgen::engine::{
    Algorithm, Expansion, Images, Phonons, Plan, ProbeBox, ProbeRaster, ProbeStep, Scan, Settings,
    simulate, window_for,
};
use stemgen::optics::{Aberration, Optics};
use stemgen::progress::Silent;
use stemgen::structure::Site;

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
                    sites.push(Site { position, number, sigma_angstrom, anisotropy: None, key });
                }
            }
        }
    }
    (sites, cells.map(|n| n as f64 * A))
}

/// Pt [001], nx x ny x nz cells.
fn platinum(cells: [usize; 3]) -> (Vec<Site>, [f64; 3]) {
    const EDGE: f64 = 3.924;
    let mut sites = Vec::new();
    for i in 0..cells[0] * cells[1] * cells[2] {
        let cell = [i % cells[0], i / cells[0] % cells[1], i / cells[0] / cells[1]];
        for p in [[0.0, 0.0, 0.25], [0.5, 0.5, 0.25], [0.5, 0.0, 0.75], [0.0, 0.5, 0.75]] {
            let position = [0, 1, 2].map(|k| (cell[k] as f64 + p[k]) * EDGE);
            let key = sites.len() as u64;
            sites.push(Site { position, number: 78, sigma_angstrom: 0.07, anisotropy: None, key });
        }
    }
    (sites, cells.map(|n| n as f64 * EDGE))
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
#[ignore = "long"]
fn prism_with_aberrations_and_different_factors_per_axis_stays_close() {
    let (sites, cell) = srtio3([6, 6, 2]);
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
    for accuracy in [0.4, 0.8, 3.3] {
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

/// Probes expanded in fewer waves, 1 % right, against each propagated in a window nearer around it, and against waves that are 0.1 %
/// right in the same windows: 0.27-0.37 % and 0.19-0.22 % of the mean image.
#[test]
fn expanded_probes_give_the_images_of_each() {
    let (sites, cell) = srtio3([6, 6, 10]);
    let scan = Scan { origin_angstrom: [3.0, 5.0], step_angstrom: [0.28; 2], shape: [13, 26] };
    let base = Settings {
        phonons: Some(Phonons { configurations: 1, seed: 2 }),
        algorithm: Algorithm::Window { width_angstrom: 7.8 },
        thicknesses_angstrom: vec![16.0, 39.0],
        detectors: vec![Detector::new("HAADF", 68.0, 200.0), Detector::new("ADF", 50.0, 90.0)],
        ..Settings::default()
    };
    let run = |expansion: Expansion| {
        let settings = Settings { expansion, ..base.clone() };
        let plan = plan(&settings, &sites, cell);
        simulate(&plan, &sites, &scan, &Silent).unwrap()
    };
    let each = run(Expansion::Off);
    let off = |images: &Images, from: &Images, t: usize, d: usize| {
        let (a, b) = (images.image(t, d), from.image(t, d));
        let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
        100.0 * (square / a.len() as f32).sqrt() / b.mean().unwrap()
    };
    let fine = run(Expansion::Error(0.001));
    for (expansion, limits) in [(Expansion::Auto, [0.4, 0.3]), (Expansion::Error(0.03), [1.0, 0.9])]
    {
        let images = run(expansion);
        for (t, d) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let errors = [off(&images, &each, t, d), off(&images, &fine, t, d)];
            println!("{expansion:?} {t} {d}: {errors:?} %");
            assert!(errors.iter().zip(limits).all(|(e, l)| *e < l), "{expansion:?}: {errors:?}");
            assert!(errors[1] > 1e-3, "nothing was expanded");
        }
    }
}

/// Images interpolated from probes 0.28 A apart against a probe at every point of the scan: rms difference over
/// the standard deviation of the image, for a scan of the whole (periodic) cell and for a part of it.
#[test]
#[ignore = "long"]
fn interpolated_images_are_those_of_a_probe_at_every_point() {
    let (srtio3, srtio3_cell) = srtio3([2, 2, 5]);
    let (pt, pt_cell) = platinum([2, 2, 5]);
    for (name, sites, cell) in [("SrTiO3", srtio3, srtio3_cell), ("Pt", pt, pt_cell)] {
        let step = 0.13;
        let points = (cell[0] / step).round();
        let whole = Scan {
            origin_angstrom: [0.0; 2],
            step_angstrom: [cell[0] / points; 2],
            shape: [points as usize; 2],
        };
        let part =
            Scan { origin_angstrom: [1.1, -0.7], step_angstrom: [0.12, 0.09], shape: [50, 40] };
        let phonons = Some(Phonons { configurations: 1, seed: 4 });
        let detectors = vec![Detector::new("HAADF", 68.0, 200.0), Detector::new("BF", 0.0, 10.0)];
        let full = Settings { phonons, detectors, ..Settings::default() };
        let windowed = Settings {
            algorithm: Algorithm::Window { width_angstrom: 7.8 },
            detectors: full.detectors[..1].to_vec(),
            expansion: Expansion::Off,
            ..full.clone()
        };
        for (settings, limits) in [(full, [0.15, 0.3]), (windowed, [0.3; 2])] {
            for scan in [&whole, &part] {
                let run = |probe_step| {
                    let plan = plan(&Settings { probe_step, ..settings.clone() }, &sites, cell);
                    let probes = ProbeRaster::new(&plan, scan).unwrap().scan().len();
                    (simulate(&plan, &sites, scan, &Silent).unwrap(), probes)
                };
                let (exact, all) = run(ProbeStep::Scan);
                let (interpolated, few) = run(ProbeStep::Angstrom(0.28));
                assert!(few as f64 <= 0.75 * all as f64, "{few} of {all}");
                for d in 0..settings.detectors.len() {
                    let (a, b) = (interpolated.image(0, d), exact.image(0, d));
                    let square: f32 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
                    let error = 100.0 * (square / a.len() as f32).sqrt() / b.std(0.0);
                    println!("{name} {}: {few} probes for {all}: {error:.4} %", exact.detectors[d]);
                    assert!(error < limits[d], "{name}: {error} %");
                }
            }
        }
    }
}

#[test]
fn probes_stand_at_the_scan_where_that_takes_fewer() {
    let (sites, cell) = srtio3([2, 2, 1]);
    let expanded =
        Settings { algorithm: Algorithm::Window { width_angstrom: 5.9 }, ..Settings::default() };
    let windowed = Settings { expansion: Expansion::Off, ..expanded.clone() };
    let raster = |settings: &Settings, step: f64, n: usize| {
        let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom: [step; 2], shape: [n, n] };
        ProbeRaster::new(&plan(settings, &sites, cell), &scan).map(|r| *r.scan())
    };
    // 7.81 A: 28 probes at most 0.2806 A apart; 4 A of a cell: 15 intervals and 3 probes beyond either end;
    // 2 A: the 16 probes that a value is made of
    assert_eq!(raster(&windowed, cell[0] / 60.0, 60).unwrap().shape, [28, 28]);
    let part = raster(&windowed, 0.05, 81).unwrap();
    assert_eq!(part.shape, [22, 22]);
    assert!((part.origin_angstrom[0] + 0.8).abs() < 1e-9, "{:?}", part.origin_angstrom);
    assert_eq!(raster(&windowed, 0.05, 41).unwrap().shape, [16, 16]);
    assert_eq!(raster(&windowed, 0.3, 26).unwrap().shape, [26, 26]);
    assert_eq!(raster(&windowed, 0.05, 1).unwrap().shape, [1, 1]);
    assert_eq!(raster(&Settings::default(), cell[0] / 60.0, 60).unwrap().shape, [60, 60]);
    // Expanded probes cost little, up to some for each wave.
    assert_eq!(raster(&expanded, cell[0] / 60.0, 60).unwrap().shape, [60, 60]);
    assert_eq!(raster(&expanded, 0.02, 200).unwrap().shape, [22, 22]);
    let coarse = Settings { probe_step: ProbeStep::Angstrom(0.31), ..windowed };
    assert!(raster(&coarse, 0.1, 9).unwrap_err().to_string().contains("0.2986"));
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
            Site { position, number: 38, sigma_angstrom: 0.0, anisotropy: None, key: i as u64 }
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
