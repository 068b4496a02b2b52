//! Error and time of slices in specimens without planes: a tilted Pt sphere of 2.8 nm in one phonon configuration, and a Au sphere on 3 nm of
//! carbon at rest.
//!
//! `cargo bench --bench slices [-- [gold] SPAN ...]`: atoms within SPAN Angstrom along the beam share a slice, at one height for the whole
//! cell, and where the atoms of each window are. Against slices of 0.02 A: rms error of bright pixels (above 40 % of the maximum) relative to
//! their own intensity, their mean error, rms error of all pixels over the maximum and over the mean, and CPU seconds (Linux; 0 elsewhere).

use stemgen::engine::{Algorithm, Plan, ProbeStep, Scan, Settings, displaced, simulate};
use stemgen::potential::Slicing;
use stemgen::progress::Silent;
use stemgen::structure::Site;

/// Edges of the box in Angstrom, atoms, and the scan.
struct Case {
    name: &'static str,
    cell: [f64; 3],
    sites: Vec<Site>,
    scan: Scan,
    window: f64,
}

/// The positions within `radius` Angstrom of a face-centred cubic crystal, turned by two angles.
fn sphere(edge: f64, radius: f64, turns: [f64; 2]) -> Vec<[f64; 3]> {
    let [(s1, c1), (s2, c2)] = turns.map(f64::sin_cos);
    let mut positions = Vec::new();
    for i in -16_i32..=16 {
        for j in -16_i32..=16 {
            for k in -16_i32..=16 {
                if (i + j + k) % 2 != 0 {
                    continue;
                }
                let [x, y, z] = [i, j, k].map(|n| 0.5 * edge * f64::from(n));
                let (y, z) = (c1 * y - s1 * z, s1 * y + c1 * z);
                let (x, z) = (c2 * x - s2 * z, s2 * x + c2 * z);
                if x * x + y * y + z * z < radius * radius {
                    positions.push([x, y, z]);
                }
            }
        }
    }
    positions
}

fn scan(origin: [f64; 2], shape: [usize; 2]) -> Scan {
    Scan { origin_angstrom: origin, step_angstrom: [0.28; 2], shape }
}

fn platinum() -> Case {
    let site = |(key, p): (usize, [f64; 3])| {
        let position = [p[0] + 17.0, p[1] + 17.0, p[2] + 15.0];
        Site { position, number: 78, sigma_angstrom: 0.07, anisotropy: None, key: key as u64 }
    };
    let moved = |s: Site| Site { position: displaced(&s, 1, 0), sigma_angstrom: 0.0, ..s };
    let sites = sphere(3.924, 14.0, [0.37, 0.81]).into_iter().enumerate().map(site).map(moved);
    let (name, cell, scan) = ("Pt", [34.0, 34.0, 30.0], scan([12.0; 2], [36, 36]));
    Case { name, cell, sites: sites.collect(), scan, window: 5.9 }
}

/// A sphere of some 400 atoms behind random carbon of 0.1 atoms per cubic Angstrom, no two nearer than 1.3 A.
fn gold_on_carbon() -> Case {
    const EDGE: f64 = 40.0;
    const FILM: f64 = 30.0;
    let mut carbon: Vec<[f64; 3]> = Vec::new();
    let mut draws = 0;
    while carbon.len() < (0.1 * EDGE * EDGE * FILM) as usize {
        let one = [0, 1, 2].map(|k| {
            let uniform = stemgen::rng::uniform(1, stemgen::rng::Purpose::AccuracySample, k, draws);
            uniform * [EDGE, EDGE, FILM][k as usize]
        });
        draws += 1;
        let near = |o: &[f64; 3]| {
            let apart = |k: usize| {
                let d = o[k] - one[k];
                if k < 2 { d - EDGE * (d / EDGE).round() } else { d }
            };
            (0..3).map(|k| apart(k).powi(2)).sum::<f64>() < 1.3 * 1.3
        };
        if !carbon.iter().any(near) {
            carbon.push(one);
        }
    }
    let gold = sphere(4.078, 11.2, [0.0; 2]).into_iter();
    let gold = gold.map(|p| (79, [p[0] + 20.0, p[1] + 20.0, p[2] + FILM + 13.0]));
    let all = carbon.into_iter().map(|p| (6, p)).chain(gold).enumerate();
    let site = |(key, (number, position))| Site {
        position,
        number,
        sigma_angstrom: 0.0,
        anisotropy: None,
        key: key as u64,
    };
    let (name, cell) = ("Au on carbon", [EDGE, EDGE, 56.0]);
    Case {
        name,
        cell,
        sites: all.map(site).collect(),
        scan: scan([26.0, 16.0], [14, 14]),
        window: 11.7,
    }
}

fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn main() {
    let mut asked: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    if asked.is_empty() {
        asked = vec![0.1, 0.15, 0.25, 0.35, 0.5];
    }
    let gold = std::env::args().any(|a| a == "gold");
    let case = if gold { gold_on_carbon() } else { platinum() };
    errors(&case, &asked);
}

fn errors(case: &Case, asked: &[f64]) {
    let z: Vec<f64> = case.sites.iter().map(|s| s.position[2]).collect();
    let image = |slicing: Slicing| {
        let algorithm = Algorithm::Window { width_angstrom: case.window };
        let probe_step = ProbeStep::Scan;
        let settings = Settings { algorithm, probe_step, slicing, ..Settings::default() };
        let plan = Plan::new(&settings, case.cell, &z).expect("a plan");
        let start = cpu_seconds();
        let images = simulate(&plan, &case.sites, &case.scan, &Silent).expect("an image");
        (images.image(0, 0).mapv(f64::from), cpu_seconds() - start, plan.slices.len())
    };
    let (exact, seconds, slices) = image(Slicing::Grouped(0.02));
    println!("{}, {} atoms; 0.02 A: {slices} slices, {seconds:.1} s", case.name, case.sites.len());
    let top = exact.iter().fold(0.0_f64, |m, v| m.max(*v));
    let middle = exact.mean().unwrap_or_default();
    for &span in asked {
        for (name, slicing) in
            [("one height", Slicing::Grouped(span)), ("local", Slicing::Local(span))]
        {
            let (ours, seconds, slices) = image(slicing);
            let pairs = || ours.iter().zip(&exact);
            let bright = pairs().filter(|p| *p.1 > 0.4 * top).map(|(a, b)| a / b - 1.0);
            let bright: Vec<f64> = bright.collect();
            let n = bright.len() as f64;
            let rms = (bright.iter().map(|d| d * d).sum::<f64>() / n).sqrt();
            let mean = bright.iter().sum::<f64>() / n;
            let square = pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let all = 100.0 * (square / exact.len() as f64).sqrt();
            println!(
                "{span:>5} A, {name:10}: {slices:4} slices, {seconds:5.1} s; bright {:.2} % rms ({:+.2} % mean), all {:.3} % of the maximum, {:.2} % of the mean",
                100.0 * rms,
                100.0 * mean,
                all / top,
                all / middle,
            );
        }
    }
}
