//! Conservation laws and symmetries, which hold for any specimen.

use super::specimens::{SRTIO3_ANGSTROM, displaced, srtio3, unit_cell};
use super::{Case, Group, percent, widened};
use crate::detect::Detector;
use crate::engine::{Algorithm, Images, Scan, Settings, Site, diffraction};
use crate::error::Result;
use crate::potential::slices::Slicing;
use crate::validate::check_runner::plan;
use crate::validate::difference::Difference;
use crate::validate::{Check, CheckRunner, Figure, Findings, Limit, Plot, Series, Style};

pub fn cases() -> Vec<Case> {
    let case = |name, title, about, quick, seconds, simulations, run| Case {
        name,
        title,
        group: Group::Laws,
        about,
        source: "No reference is needed: the law is the reference.",
        quick,
        seconds,
        simulations,
        run,
    };
    vec![
        case(
            "vacuum",
            "The propagator conserves intensity",
            "A probe through 100 A of vacuum in up to 200 slices, all angles detected: the intensity stays 1 but for the rounding of \
             single precision, 1.3e-7 a slice.",
            true,
            1.5,
            VACUUM_SLICES.len() * 2,
            vacuum,
        ),
        case(
            "intensity",
            "No intensity is gained, and patterns sum to detectors",
            "SrTiO3, 1.2 nm: all electrons below 200 mrad are at most the beam, and the pixels of the diffraction pattern sum to the \
             intensity on the detector.",
            true,
            0.7,
            2,
            intensity,
        ),
        case(
            "translation",
            "Moving the specimen moves the image",
            "One configuration of displaced atoms, moved together with the scan by a distance that is no multiple of a pixel; multislice and \
             PRISM. Transmission functions are products on a grid and not strictly band-limited, which leaves about 0.1 %.",
            true,
            4.0,
            4,
            translation,
        ),
        case(
            "cell-origin",
            "Where the cell starts does not matter",
            "The same crystal with its planes in the middle of the cell and on its faces, and atoms listed in neighbouring periods.",
            true,
            0.8,
            2,
            origin,
        ),
        case(
            "slices",
            "Where slices are cut within a gap does not matter",
            "Slice boundaries moved by up to 0.45 A between atomic planes: the same bytes. Moved past a plane, the image does change, so that \
             the check can fail.",
            false,
            1.2,
            3,
            slices,
        ),
        case(
            "threads",
            "The number of threads does not change a byte",
            "Three engines on one, two and three threads.",
            false,
            7.0,
            9,
            threads,
        ),
    ]
}

fn largest(a: &Images, b: &Images, detector: usize) -> f64 {
    let (a, b) = (widened(a.image(0, detector)), widened(b.image(0, detector)));
    Difference::between(a.view(), b.view()).largest
}

const VACUUM_SLICES: [usize; 4] = [4, 20, 100, 200];

fn vacuum(runner: &CheckRunner) -> Result<Findings> {
    let scan = Scan { origin_angstrom: [3.3, 4.4], step_angstrom: [0.7; 2], shape: [2, 2] };
    let mut findings = Findings::default();
    let mut series = Vec::new();
    let engines = [("multislice", Algorithm::Multislice), ("PRISM", prism())];
    for (name, algorithm) in engines {
        let mut points = Vec::new();
        for slices in VACUUM_SLICES {
            let settings = Settings {
                algorithm,
                detectors: vec![Detector::new("all", 0.0, 190.0)],
                slicing: Slicing::Thickness(100.0 / slices as f64),
                ..Settings::default()
            };
            let images = runner.simulate(&settings, &[], [12.0, 13.0, 100.0], &scan)?;
            let error = images.data.iter().map(|v| f64::from((v - 1.0).abs())).fold(0.0, f64::max);
            let limit = 1e-6_f64.max(1.5e-7 * slices as f64);
            let what = format!("{name}, {slices} slices: intensity lost or gained");
            findings.checks.push(Check::new(what, error, "of the beam", Limit::AtMost(limit)));
            points.push((slices as f64, error.max(1e-9)));
        }
        series.push(Series { name: name.into(), points, style: Style::Both });
    }
    let limit = VACUUM_SLICES.map(|n| (n as f64, 1e-6_f64.max(1.5e-7 * n as f64)));
    series.push(Series { name: "limit".into(), points: limit.to_vec(), style: Style::Dashed });
    findings.figures.push(Figure::Plot(Plot {
        title: "Intensity lost or gained in vacuum".into(),
        x: "slices".into(),
        y: "fraction of the beam".into(),
        logarithmic: [true, true],
        series,
    }));
    Ok(findings)
}

fn prism() -> Algorithm {
    Algorithm::Prism { interpolation: [1, 1] }
}

fn intensity(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 3])?;
    let settings = Settings {
        detectors: vec![Detector::new("HAADF", 68.0, 200.0), Detector::new("all", 0.0, 200.0)],
        ..Settings::default()
    };
    let plan = plan(&settings, &sites, cell)?;
    let at = [SRTIO3_ANGSTROM; 2];
    let scan = Scan { origin_angstrom: at, step_angstrom: [1.0; 2], shape: [1, 1] };
    let all = f64::from(runner.execute(&plan, &sites, &scan)?.data[[0, 1, 0, 0]]);
    let share = runner.share();
    let pattern = diffraction(&plan, &sites, at, &share)?;
    share.complete();
    let wavelength = settings.optics.wavelength_angstrom();
    let inside = |y: usize, x: usize| {
        let [kx, ky] = plan.wave_grid.k(y, x);
        kx.hypot(ky) * wavelength < 0.2
    };
    let pixels = pattern.indexed_iter().filter(|((y, x), _)| inside(*y, *x));
    let sum: f64 = pixels.map(|(_, v)| f64::from(*v)).sum();
    Ok(Findings {
        checks: vec![
            Check::new(
                "below 200 mrad on a Sr column",
                all,
                "of the beam",
                Limit::Between(0.9, 1.0),
            ),
            Check::new(
                "pattern less detector",
                (sum - all).abs(),
                "of the beam",
                Limit::AtMost(1e-5),
            ),
        ],
        figures: Vec::new(),
    })
}

fn four() -> Vec<Detector> {
    let detector = |(name, inner, outer)| Detector::new(name, inner, outer);
    [("BF", 0.0, 10.0), ("ABF", 10.0, 21.0), ("ADF", 30.0, 68.0), ("HAADF", 68.0, 200.0)]
        .map(detector)
        .to_vec()
}

fn translation(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 3])?;
    let shift = [1.234, -2.777];
    let moved = |s: &Site| {
        let [x, y, z] = s.position;
        Site { position: [x + shift[0], y + shift[1], z], ..*s }
    };
    let moved: Vec<Site> = sites.iter().map(moved).collect();
    let scan = unit_cell(8);
    let [x, y] = scan.origin_angstrom;
    let moved_scan = Scan { origin_angstrom: [x + shift[0], y + shift[1]], ..scan };
    let mut findings = Findings::default();
    for (name, algorithm) in [("multislice", Algorithm::Multislice), ("PRISM", prism())] {
        let settings = Settings { detectors: four(), algorithm, ..displaced(9) };
        let plan = plan(&settings, &sites, cell)?;
        let a = runner.execute(&plan, &sites, &scan)?;
        let b = runner.execute(&plan, &moved, &moved_scan)?;
        for (d, detector) in a.detectors.iter().enumerate() {
            let what = format!("{name}, {detector}: largest change, of the maximum");
            findings.checks.push(percent(what, largest(&b, &a, d), 2e-3));
        }
        let title = format!("{name}, HAADF: moved (ours) and in place (reference)");
        let (ours, reference) = (widened(b.image(0, 3)), widened(a.image(0, 3)));
        findings.figures.push(super::pair(title, ours, reference, &scan, 2e-3));
    }
    Ok(findings)
}

fn origin(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 3])?;
    let a = runner.simulate(&displaced(5), &sites, cell, &unit_cell(3))?;
    let elsewhere = |(i, s): (usize, &Site)| {
        let [x, y, z] = s.position;
        let z = z - 0.25 * SRTIO3_ANGSTROM;
        match i % 3 {
            0 => Site { position: [x + cell[0], y, z - cell[2]], ..*s },
            _ => Site { position: [x, y, z], ..*s },
        }
    };
    let elsewhere: Vec<Site> = sites.iter().enumerate().map(elsewhere).collect();
    let b = runner.simulate(&displaced(5), &elsewhere, cell, &unit_cell(3))?;
    let what = "largest change of HAADF, of the maximum";
    Ok(Findings { checks: vec![percent(what, largest(&b, &a, 0), 1e-5)], figures: Vec::new() })
}

fn slices(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 3])?;
    let reference = plan(&displaced(5), &sites, cell)?;
    let mut moved = reference.clone();
    for (i, b) in moved.slices.boundaries.iter_mut().enumerate().skip(1).take(5) {
        *b += if i % 2 == 0 { 0.4 } else { -0.45 };
    }
    let scan = unit_cell(3);
    let a = runner.execute(&reference, &sites, &scan)?;
    let b = runner.execute(&moved, &sites, &scan)?;
    for (boundary, by) in [(2, 2.0), (3, 2.0), (4, 1.2)] {
        moved.slices.boundaries[boundary] += by;
    }
    let c = runner.execute(&moved, &sites, &scan)?;
    Ok(Findings {
        checks: vec![
            Check::new("pixels that change within gaps", differing(&a, &b), "", Limit::AtMost(0.0)),
            Check::new(
                "largest change past a plane, of the maximum",
                100.0 * largest(&c, &a, 0),
                "%",
                Limit::AtLeast(0.1),
            ),
        ],
        figures: Vec::new(),
    })
}

/// Counts the pixels whose bytes differ.
fn differing(a: &Images, b: &Images) -> f64 {
    a.data.iter().zip(&b.data).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64
}

fn threads(runner: &CheckRunner) -> Result<Findings> {
    let (sites, cell) = srtio3([3, 3, 2])?;
    let mut findings = Findings::default();
    let window = Algorithm::Window { width_angstrom: 7.8 };
    for (name, algorithm) in
        [("multislice", Algorithm::Multislice), ("PRISM", prism()), ("windows", window)]
    {
        let plan = plan(&Settings { algorithm, ..displaced(1) }, &sites, cell)?;
        let run = |count| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build();
            let run = || runner.execute(&plan, &sites, &unit_cell(4));
            // Where no threads can be started, the case runs on the present ones.
            pool.map_or_else(|_| run(), |pool| pool.install(run))
        };
        let one = run(1)?;
        for count in [2, 3] {
            let what = format!("{name}: pixels that differ between 1 and {count} threads");
            findings.checks.push(Check::new(
                what,
                differing(&run(count)?, &one),
                "",
                Limit::AtMost(0.0),
            ));
        }
    }
    Ok(findings)
}
