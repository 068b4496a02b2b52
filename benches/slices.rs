//! Error and time of slices in a specimen without planes: a tilted Pt sphere of 2.8 nm in one phonon configuration.
//!
//! `cargo bench --bench slices [-- SPAN ...]`: atoms within SPAN Angstrom along the beam share a slice, at one height for the whole
//! cell, and where the atoms of each window are. Against slices of 0.02 A: rms error of bright pixels (above 40 % of the maximum) relative to their own intensity, their mean error, rms
//! error of all pixels over the maximum, and CPU seconds (Linux; 0 elsewhere).

use stemgen::engine::phonons::displaced;
use stemgen::engine::{Algorithm, Plan, ProbeStep, Scan, Settings, Site, simulate};
use stemgen::potential::slices::Slicing;
use stemgen::progress::Silent;

const BOX: [f64; 3] = [34.0, 34.0, 30.0];
const RADIUS: f64 = 14.0;

/// Displaced atoms of a sphere, turned by two angles.
fn sphere() -> Vec<Site> {
    const A: f64 = 3.924;
    let (s1, c1) = 0.37_f64.sin_cos();
    let (s2, c2) = 0.81_f64.sin_cos();
    let mut sites = Vec::new();
    for i in -16_i32..=16 {
        for j in -16_i32..=16 {
            for k in -16_i32..=16 {
                if (i + j + k) % 2 != 0 {
                    continue;
                }
                let [x, y, z] = [i, j, k].map(|n| 0.5 * A * f64::from(n));
                let (y, z) = (c1 * y - s1 * z, s1 * y + c1 * z);
                let (x, z) = (c2 * x - s2 * z, s2 * x + c2 * z);
                if x * x + y * y + z * z < RADIUS * RADIUS {
                    let position = [x + 17.0, y + 17.0, z + 15.0];
                    let key = sites.len() as u64;
                    sites.push(Site { position, number: 78, sigma_angstrom: 0.07, key });
                }
            }
        }
    }
    let moved = |s: &Site| Site { position: displaced(s, 1, 0), sigma_angstrom: 0.0, ..*s };
    sites.iter().map(moved).collect()
}

fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn main() {
    let sites = sphere();
    let z: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
    let scan = Scan { origin_angstrom: [12.0; 2], step_angstrom: [0.28; 2], shape: [36, 36] };
    let image = |slicing: Slicing| {
        let algorithm = Algorithm::Window { width_angstrom: 5.9 };
        let probe_step = ProbeStep::Scan;
        let settings = Settings { algorithm, probe_step, slicing, ..Settings::default() };
        let plan = Plan::new(&settings, BOX, &z).expect("a plan");
        let start = cpu_seconds();
        let images = simulate(&plan, &sites, &scan, &Silent).expect("an image");
        (images.image(0, 0).mapv(f64::from), cpu_seconds() - start, plan.slices.len())
    };
    let mut asked: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    if asked.is_empty() {
        asked = vec![0.1, 0.15, 0.25, 0.35, 0.5];
    }
    let (exact, seconds, slices) = image(Slicing::Grouped(0.02));
    println!("{} atoms; 0.02 A: {slices} slices, {seconds:.1} s", sites.len());
    let top = exact.iter().fold(0.0_f64, |m, v| m.max(*v));
    for span in asked {
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
            println!(
                "{span:>5} A, {name:10}: {slices:4} slices, {seconds:5.1} s; bright {:.2} % rms ({:+.2} % mean), all {:.3} %",
                100.0 * rms,
                100.0 * mean,
                100.0 * (square / exact.len() as f64).sqrt() / top
            );
        }
    }
}
