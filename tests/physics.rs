//! Conservation laws, limits and published numbers.

use stemgen::detect::Detector;
use stemgen::engine::settings::EXACT_BAND_FRACTION;
use stemgen::engine::{
    Algorithm, GridChoice, Images, Phonons, Plan, ProbeBox, ProbeRaster, ProbeStep, Scan, Settings,
    Site, diffraction, exit_wave, lens_image, simulate, window_for,
};
use stemgen::optics::{Aberration, Aberrations, ApertureEdge, Optics};
use stemgen::potential::scattering::Parametrization;
use stemgen::potential::slices::Slicing;
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

/// Pt [001], nx x ny x nz cells.
fn platinum(cells: [usize; 3]) -> (Vec<Site>, [f64; 3]) {
    const EDGE: f64 = 3.924;
    let mut sites = Vec::new();
    for i in 0..cells[0] * cells[1] * cells[2] {
        let cell = [i % cells[0], i / cells[0] % cells[1], i / cells[0] / cells[1]];
        for p in [[0.0, 0.0, 0.25], [0.5, 0.5, 0.25], [0.5, 0.0, 0.75], [0.0, 0.5, 0.75]] {
            let position = [0, 1, 2].map(|k| (cell[k] as f64 + p[k]) * EDGE);
            let key = sites.len() as u64;
            sites.push(Site { position, number: 78, sigma_angstrom: 0.07, key });
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

#[test]
fn vacuum_conserves_intensity() {
    // One step conserves to 1e-6; single-precision transforms lose 1.3e-7 a step, always the same way.
    let algorithms = [Algorithm::Multislice, Algorithm::Prism { interpolation: [1, 1] }];
    for (algorithm, slices) in algorithms.into_iter().flat_map(|a| [(a, 4), (a, 100)]) {
        let settings = Settings {
            algorithm,
            detectors: vec![Detector::new("all", 0.0, 190.0)],
            slicing: Slicing::Thickness(100.0 / slices as f64),
            ..Settings::default()
        };
        let plan = plan(&settings, &[], [12.0, 13.0, 100.0]);
        assert_eq!(plan.slices.len(), slices);
        let scan = Scan { origin_angstrom: [3.3, 4.4], step_angstrom: [0.7; 2], shape: [2, 2] };
        let images = simulate(&plan, &[], &scan, &Silent).unwrap();
        for v in &images.data {
            let error = (v - 1.0).abs();
            println!("vacuum, {slices} slices: {error:e}");
            assert!(error < 1e-6_f32.max(1.5e-7 * slices as f32), "{slices} slices: {v}");
        }
    }
}

#[test]
fn moving_boundaries_within_gaps_changes_nothing() {
    let (sites, cell) = srtio3([3, 3, 3]);
    let settings =
        Settings { phonons: Some(Phonons { configurations: 1, seed: 5 }), ..Settings::default() };
    let scan = unit_cell_scan(3);
    let reference = plan(&settings, &sites, cell);
    let mut moved = reference.clone();
    for (i, b) in moved.slices.boundaries.iter_mut().enumerate().skip(1).take(5) {
        *b += if i % 2 == 0 { 0.4 } else { -0.45 };
    }
    let a = simulate(&reference, &sites, &scan, &Silent).unwrap();
    let b = simulate(&moved, &sites, &scan, &Silent).unwrap();
    assert_eq!(a.data, b.data);
    // and the check can fail: a boundary that passes an atomic plane does change the image
    moved.slices.boundaries[2] += 2.0;
    moved.slices.boundaries[3] += 2.0;
    moved.slices.boundaries[4] += 1.2;
    let c = simulate(&moved, &sites, &scan, &Silent).unwrap();
    assert!(largest_difference(&c.image(0, 0), &a.image(0, 0)) > 1e-3);
}

#[test]
fn where_the_cell_starts_does_not_matter() {
    let (mut sites, cell) = srtio3([3, 3, 3]);
    let settings =
        Settings { phonons: Some(Phonons { configurations: 1, seed: 5 }), ..Settings::default() };
    let scan = unit_cell_scan(3);
    let a = simulate(&plan(&settings, &sites, cell), &sites, &scan, &Silent).unwrap();
    // planes on the faces of the cell, and atoms listed in another period along x and z
    for (i, s) in sites.iter_mut().enumerate() {
        s.position[2] -= 0.25 * A;
        if i % 3 == 0 {
            s.position[0] += cell[0];
            s.position[2] -= cell[2];
        }
    }
    let b = simulate(&plan(&settings, &sites, cell), &sites, &scan, &Silent).unwrap();
    assert!(largest_difference(&b.image(0, 0), &a.image(0, 0)) < 1e-5);
}

#[test]
fn translating_the_specimen_translates_the_image() {
    let (sites, cell) = srtio3([3, 3, 3]);
    let settings = Settings {
        detectors: four_detectors(),
        phonons: Some(Phonons { configurations: 1, seed: 9 }),
        ..Settings::default()
    };
    let shift = [1.234, -2.777];
    let moved: Vec<Site> = sites
        .iter()
        .map(|s| {
            let [x, y, z] = s.position;
            Site { position: [x + shift[0], y + shift[1], z], ..*s }
        })
        .collect();
    let scan = unit_cell_scan(3);
    let o = scan.origin_angstrom;
    let moved_scan = Scan { origin_angstrom: [o[0] + shift[0], o[1] + shift[1]], ..scan };
    for algorithm in [Algorithm::Multislice, Algorithm::Prism { interpolation: [1, 1] }] {
        let settings = Settings { algorithm, ..settings.clone() };
        let plan = plan(&settings, &sites, cell);
        let a = simulate(&plan, &sites, &scan, &Silent).unwrap();
        let b = simulate(&plan, &moved, &moved_scan, &Silent).unwrap();
        for d in 0..4 {
            // transmission functions are products on the grid: not exactly band-limited
            let error = largest_difference(&b.image(0, d), &a.image(0, d));
            assert!(error < 2e-3, "{algorithm:?}, detector {d}: {error}");
        }
    }
}

#[test]
fn threads_do_not_change_a_byte() {
    let (sites, cell) = srtio3([3, 3, 2]);
    for algorithm in [
        Algorithm::Multislice,
        Algorithm::Prism { interpolation: [1, 1] },
        Algorithm::Window { width_angstrom: 7.8 },
    ] {
        let settings = Settings {
            algorithm,
            phonons: Some(Phonons { configurations: 2, seed: 1 }),
            ..Settings::default()
        };
        let plan = plan(&settings, &sites, cell);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| simulate(&plan, &sites, &unit_cell_scan(4), &Silent).unwrap())
        };
        assert_eq!(run(1).data, run(2).data);
        assert_eq!(run(2).data, run(3).data);
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

/// Images interpolated from probes 0.25 A apart against a probe at every point of the scan: rms difference over
/// the standard deviation of the image, for a scan of the whole (periodic) cell and for a part of it.
#[test]
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
            algorithm: Algorithm::Window { width_angstrom: 5.9 },
            detectors: full.detectors[..1].to_vec(),
            ..full.clone()
        };
        for (settings, limit) in [(full, 0.15), (windowed, 0.3)] {
            for scan in [&whole, &part] {
                let run = |probe_step| {
                    let plan = plan(&Settings { probe_step, ..settings.clone() }, &sites, cell);
                    let probes = ProbeRaster::new(&plan, scan).unwrap().scan().len();
                    (simulate(&plan, &sites, scan, &Silent).unwrap(), probes)
                };
                let (exact, all) = run(ProbeStep::Scan);
                let (interpolated, few) = run(ProbeStep::Angstrom(0.25));
                assert!(few as f64 <= 0.75 * all as f64, "{few} of {all}");
                for d in 0..settings.detectors.len() {
                    let (a, b) = (interpolated.image(0, d), exact.image(0, d));
                    let square: f32 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
                    let error = 100.0 * (square / a.len() as f32).sqrt() / b.std(0.0);
                    println!("{name} {}: {few} probes for {all}: {error:.4} %", exact.detectors[d]);
                    assert!(error < limit, "{name}: {error} %");
                }
            }
        }
    }
}

#[test]
fn probes_stand_at_the_scan_where_that_takes_fewer() {
    let (sites, cell) = srtio3([2, 2, 1]);
    let windowed =
        Settings { algorithm: Algorithm::Window { width_angstrom: 5.9 }, ..Settings::default() };
    let raster = |settings: &Settings, step: f64, n: usize| {
        let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom: [step; 2], shape: [n, n] };
        ProbeRaster::new(&plan(settings, &sites, cell), &scan).map(|r| r.scan().clone())
    };
    // 7.81 A: 32 probes at most 0.2508 A apart; 2 A of a cell: 8 intervals and 5 probes beyond either end
    assert_eq!(raster(&windowed, cell[0] / 60.0, 60).unwrap().shape, [32, 32]);
    let part = raster(&windowed, 0.05, 41).unwrap();
    assert_eq!(part.shape, [19, 19]);
    assert!((part.origin_angstrom[0] + 1.25).abs() < 1e-9, "{:?}", part.origin_angstrom);
    assert_eq!(raster(&windowed, 0.3, 26).unwrap().shape, [26, 26]);
    assert_eq!(raster(&windowed, 0.05, 1).unwrap().shape, [1, 1]);
    assert_eq!(raster(&Settings::default(), cell[0] / 60.0, 60).unwrap().shape, [60, 60]);
    let coarse = Settings { probe_step: ProbeStep::Angstrom(0.29), ..windowed };
    assert!(raster(&coarse, 0.1, 9).unwrap_err().to_string().contains("0.2836"));
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

#[test]
fn default_band_fraction_is_exact_to_a_thousandth() {
    let (sites, cell) = srtio3([5, 5, 10]);
    let base =
        Settings { phonons: Some(Phonons { configurations: 1, seed: 2 }), ..Settings::default() };
    let exact_grid = Settings { band_fraction: EXACT_BAND_FRACTION, ..base.clone() };
    let run = |settings: &Settings| {
        simulate(&plan(settings, &sites, cell), &sites, &unit_cell_scan(4), &Silent).unwrap()
    };
    let (a, b) = (run(&base), run(&exact_grid));
    let error = largest_difference(&a.image(0, 0), &b.image(0, 0));
    println!("band fraction 0.8 against 2/3: {error}");
    assert!(error < 1e-3, "{error}");
}

#[test]
fn intensity_is_never_gained_and_patterns_sum_to_detectors() {
    let (sites, cell) = srtio3([3, 3, 3]);
    let settings = Settings {
        detectors: vec![Detector::new("HAADF", 68.0, 200.0), Detector::new("all", 0.0, 200.0)],
        ..Settings::default()
    };
    let plan = plan(&settings, &sites, cell);
    let scan = Scan { origin_angstrom: [A, A], step_angstrom: [1.0; 2], shape: [1, 1] };
    let images = simulate(&plan, &sites, &scan, &Silent).unwrap();
    let pattern = diffraction(&plan, &sites, [A, A], &Silent).unwrap();
    let all = images.image(0, 1)[[0, 0]];
    assert!(all < 1.0 && all > 0.9, "{all}");
    let sum: f64 = pattern
        .indexed_iter()
        .filter(|((y, x), _)| {
            let [kx, ky] = plan.wave_grid.k(*y, *x);
            kx.hypot(ky) * plan.settings.optics.wavelength_angstrom() < 0.2
        })
        .map(|(_, v)| f64::from(*v))
        .sum();
    assert!((sum - f64::from(all)).abs() < 1e-5, "{sum} {all}");
}

/// HAADF of single atoms grows as a power of Z between 1.5 and 2 (Krivanek et al., Nature 464
/// (2010) 571: 1.64 for 58-200 mrad).
#[test]
fn single_atom_haadf_exponent() {
    let numbers: [u8; 7] = [6, 8, 14, 22, 38, 47, 79];
    let haadf: Vec<f64> = numbers
        .iter()
        .map(|&number| {
            let site = Site { position: [6.0, 6.0, 1.0], number, sigma_angstrom: 0.08, key: 0 };
            let settings = Settings {
                phonons: Some(Phonons { configurations: 1, seed: 0 }),
                ..Settings::default()
            };
            let plan = plan(&settings, &[site], [12.0, 12.0, 2.0]);
            // integrated over the probe position, the cross section
            let scan = Scan { origin_angstrom: [4.5; 2], step_angstrom: [0.3; 2], shape: [11, 11] };
            let images = simulate(&plan, &[site], &scan, &Silent).unwrap();
            images.data.iter().map(|v| f64::from(*v)).sum()
        })
        .collect();
    let x: Vec<f64> = numbers.iter().map(|z| f64::from(*z).ln()).collect();
    let y: Vec<f64> = haadf.iter().map(|v| v.ln()).collect();
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let slope = x.iter().zip(&y).map(|(a, b)| (a - mx) * (b - my)).sum::<f64>()
        / x.iter().map(|a| (a - mx).powi(2)).sum::<f64>();
    println!("exponent {slope}");
    assert!((1.5..2.0).contains(&slope), "{slope}");
}

/// Kirkland, Advanced Computing in Electron Microscopy (2010), fig. 5.12: bright-field image of C, Si,
/// Cu, Au and U atoms 10 A apart; 200 kV, C_s 1.3 mm, defocus 700 A, aperture 10.37 mrad: the image
/// ranges from 0.72 to 1.03.
#[test]
fn kirkland_figure_5_12() {
    let numbers = [6, 14, 29, 79, 92];
    let sites: Vec<Site> = numbers
        .iter()
        .enumerate()
        .map(|(i, &number)| Site {
            position: [5.0 + 10.0 * i as f64, 25.0, 1.0],
            number,
            sigma_angstrom: 0.0,
            key: i as u64,
        })
        .collect();
    let mut aberrations = Aberrations::defocus(700.0);
    aberrations.0.push(Aberration::parse("C30=1.3e7").unwrap());
    let optics = Optics {
        semiangle_mrad: 10.37,
        aberrations,
        edge: ApertureEdge::Hard,
        ..Optics::default()
    };
    let settings = Settings {
        optics: optics.clone(),
        parametrization: Parametrization::Kirkland,
        grid: GridChoice::Points([512, 512]),
        detectors: vec![Detector::new("unused", 0.0, 10.0)],
        ..Settings::default()
    };
    let mut plan = plan(&settings, &sites, [50.0, 50.0, 2.0]);
    // the book focuses on the atoms
    plan.slices.boundaries = vec![1.0 - 1e-9, 1.0 + 1e-9];
    let exit = exit_wave(&plan, &sites, 0, &Silent).unwrap();
    let image = lens_image(&exit, [50.0, 50.0], &optics);
    let low = image.iter().fold(f32::MAX, |a, b| a.min(*b));
    let high = image.iter().fold(0.0_f32, |a, b| a.max(*b));
    println!("extrema {low} {high}");
    assert!((low - 0.72).abs() < 0.01 && (high - 1.03).abs() < 0.01, "{low} {high}");
}
