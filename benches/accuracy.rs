//! Error of the windowed engine against the full grid: five structures, two thicknesses.
//!
//! `cargo bench --bench accuracy [-- WIDTH:MARGIN ...]`, for instance `7.8:1.2` for windows of 7.8 A whose band
//! limit is 1.2 times the detector's outer angle. For each: rms error over a raster of 3 x 3 A divided by the mean,
//! mean error where the image is brighter than half its maximum, and where it is darker than half its mean, and ms
//! per probe on all threads.

use ndarray::s;
use std::path::Path;
use std::time::Instant;
use stemgen::engine::{
    Algorithm, Expansion, Phonons, Plan, ProbeBox, ProbeStep, Scan, Settings, simulate,
};
use stemgen::progress::Silent;
use stemgen::structure::{self, Site, elements};

struct Case {
    name: &'static str,
    file: &'static str,
    zone: [i32; 3],
    repeat: [usize; 3],
    sigma: &'static [(&'static str, f64)],
    change: fn(&mut Vec<Site>, [f64; 3]),
}

const CASES: [Case; 5] = [
    Case {
        name: "SrTiO3 [001]",
        file: "srtio3.cif",
        zone: [0, 0, 1],
        repeat: [8, 8, 26],
        sigma: &[("Sr", 0.084), ("Ti", 0.060), ("O", 0.085)],
        change: |_, _| {},
    },
    Case {
        name: "BaTiO3 [001]",
        file: "batio3_tetragonal.cif",
        zone: [1, 0, 0],
        repeat: [8, 8, 25],
        sigma: &[("Ba", 0.080), ("Ti", 0.080), ("O", 0.090)],
        change: |_, _| {},
    },
    Case {
        name: "Si0.9Ge0.1 [110]",
        file: "si.cif",
        zone: [1, 1, 0],
        repeat: [4, 6, 13],
        sigma: &[("Si", 0.078), ("Ge", 0.085)],
        change: |sites, _| {
            for s in sites.iter_mut().filter(|s| s.key * 7919 % 10 == 0) {
                s.number = 32;
            }
        },
    },
    Case {
        name: "GaN [11-20]",
        file: "gan.cif",
        zone: [1, 1, 0],
        repeat: [6, 6, 31],
        sigma: &[("Ga", 0.059), ("N", 0.063)],
        change: |_, _| {},
    },
    Case {
        name: "Pt sphere, 2.4 nm",
        file: "pt.cif",
        zone: [1, 1, 0],
        repeat: [6, 8, 6],
        sigma: &[("Pt", 0.070)],
        change: |sites, size| {
            let centre = size.map(|l| 0.5 * l);
            sites.retain(|s| {
                let d: f64 = (0..3).map(|i| (s.position[i] - centre[i]).powi(2)).sum();
                d < 144.0
            });
        },
    },
];

/// Probes beyond the raster on every side.
const AROUND: usize = 15;

fn main() {
    let parse = |text: String| {
        let (width, margin) = text.split_once(':')?;
        Some((width.parse().ok()?, margin.parse().ok()?))
    };
    let mut asked: Vec<(f64, f64)> = std::env::args().filter_map(parse).collect();
    if asked.is_empty() {
        asked = [5.9, 7.8, 11.7].iter().flat_map(|&w| [1.0, 1.1, 1.2].map(|m| (w, m))).collect();
    }
    for case in CASES {
        run(&case, &asked);
    }
}

fn run(case: &Case, asked: &[(f64, f64)]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("structures").join(case.file);
    let structure = structure::read(&path).expect("a structure of the repository");
    let structure = structure.oriented(case.zone, None).expect("a zone axis");
    let structure = structure.repeat(case.repeat).expect("repeats");
    let size = structure.orthogonal_box().expect("a box");
    let sigma =
        |z: u8| case.sigma.iter().find(|s| s.0 == elements::symbol(z)).map_or(0.08, |s| s.1);
    let site = |(key, a): (usize, &structure::Atom)| Site {
        position: a.position,
        number: a.number,
        sigma_angstrom: 0.0,
        anisotropy: None,
        key: key as u64,
    };
    let mut sites: Vec<Site> = structure.atoms.iter().enumerate().map(site).collect();
    (case.change)(&mut sites, size);
    sites.iter_mut().for_each(|s| s.sigma_angstrom = sigma(s.number));
    let z: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
    let scan = Scan {
        origin_angstrom: [0.5 * size[0] - 1.6, 0.5 * size[1] - 1.4],
        step_angstrom: [0.25; 2],
        shape: [12, 12],
    };
    let base = Settings {
        phonons: Some(Phonons { configurations: 2, seed: 3 }),
        thicknesses_angstrom: vec![0.4 * size[2], size[2]],
        ..Settings::default()
    };
    // Windows serve patches of several Angstrom: the raster lies within a larger one.
    let around = Scan {
        origin_angstrom: scan.origin_angstrom.map(|x| x - AROUND as f64 * scan.step_angstrom[0]),
        shape: scan.shape.map(|n| n + 2 * AROUND),
        ..scan
    };
    let image = |settings: &Settings, scan: &Scan| {
        let plan = Plan::new(settings, size, &z).expect("a plan");
        let start = Instant::now();
        let images = simulate(&plan, &sites, scan, &Silent).expect("images");
        let ms = start.elapsed().as_secs_f64() * 1e3 / (2 * scan.len()) as f64;
        (images, ms, plan)
    };
    let (reference, ms, plan) =
        image(&Settings { probe_box: Some(ProbeBox::Large), ..base.clone() }, &scan);
    println!(
        "{}: {:.1} x {:.1} x {:.1} A, full grid {}^2, {ms:.1} ms per probe",
        case.name, size[0], size[1], size[2], plan.wave_grid.points[0]
    );
    for &(width_angstrom, angle_margin) in asked {
        for expansion in [Expansion::Off, Expansion::Auto] {
            let algorithm = Algorithm::Window { width_angstrom };
            let probe_step = ProbeStep::Scan;
            let settings =
                Settings { algorithm, angle_margin, probe_step, expansion, ..base.clone() };
            let (images, ms, plan) = image(&settings, &around);
            print!("{}", if expansion == Expansion::Off { "  each    " } else { "  expanded" });
            print!(
                " {width_angstrom:>5.1} A x{angle_margin:.2} {:>4}^2 {ms:>5.2} ms",
                plan.wave_grid.points[0]
            );
            for t in 0..2 {
                let inside = s![AROUND..AROUND + scan.shape[0], AROUND..AROUND + scan.shape[1]];
                let (a, b) = (images.image(t, 0), reference.image(t, 0));
                let a = a.slice(inside);
                let mean = b.mean().unwrap_or(0.0);
                let top = b.iter().fold(0.0_f32, |m, v| m.max(*v));
                let square = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
                let over = |keep: &dyn Fn(f32) -> bool| {
                    let pairs = || a.iter().zip(b).filter(|p| keep(*p.1));
                    let sums = pairs().fold((0.0, 0.0), |s, (a, b)| (s.0 + a, s.1 + b));
                    100.0 * (sums.0 / sums.1 - 1.0)
                };
                print!(
                    "  | {:>4.0} A: rms {:.2} %, bright {:+.2} %, dark {:+.2} %",
                    reference.thicknesses_angstrom[t],
                    100.0 * (square / a.len() as f32).sqrt() / mean,
                    over(&|v| v > 0.5 * top),
                    over(&|v| v < 0.5 * mean)
                );
            }
            println!();
        }
    }
}
