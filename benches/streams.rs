//! Labelled samples per second from a filled library, and where they come from.
//!
//! `cargo bench --bench streams [-- THICKNESS_NM SAMPLES]`. SrTiO3, hard, 16 phonon configurations, samples of 128 x 128 pixels of
//! 0.02 to 0.03 nm, at doses of 500 to 10 000 electrons per square Angstrom. The library is filled first, and kept in the cache.

use std::time::Instant;

use rayon::prelude::*;
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Override, Recipe};
use stemgen::specimen::specimen;
use stemgen::world::{BuildOptions, SampleOptions, training_sample};

fn main() {
    let numbers: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let thickness_nm = numbers.first().copied().unwrap_or(2.0);
    let samples = numbers.get(1).map_or(300, |n| *n as u64);
    let changes: Vec<Override> = [format!("field.thickness_nm={thickness_nm}")]
        .iter()
        .map(|c| c.parse().expect("a change"))
        .collect();
    let recipe = Recipe::load("srtio3", Difficulty::Hard).and_then(|r| r.with_overrides(&changes));
    let recipe = recipe.and_then(Recipe::checked).expect("a recipe");
    let specimen = specimen(&recipe).expect("a specimen");
    let policy = BuildOptions::default().policy(&recipe).expect("settings");
    let mut imager = policy.imaging.imager(&recipe, &specimen).expect("an imager");
    let begun = Instant::now();
    imager.prepare(&Silent).expect("a library");
    println!("library of {thickness_nm} nm ready after {:.0} s", begun.elapsed().as_secs_f64());
    println!("{:>8} {:>10} {:>14}", "threads", "turned", "samples per s");
    for round in 0..2 {
        for (turned, angle) in [("no", 0.0), ("yes", std::f64::consts::TAU)] {
            let options = SampleOptions {
                size_px: 128,
                pixel_nm: [0.02, 0.03],
                angle_rad: [0.0, angle],
                dose: [500.0, 1e4],
                sigma_px: 2.0,
                seed: 1,
                all_detectors: false,
            };
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                let first = round * samples;
                let make = |n: u64| {
                    training_sample(&recipe, &*specimen, &*imager, &options, n, &Silent)
                        .expect("a sample")
                };
                let begun = Instant::now();
                let counted: u64 = pool.expect("threads").install(|| {
                    let of = (first..first + samples).into_par_iter().map(make);
                    of.map(|s| s.counts.iter().map(|c| u64::from(*c)).sum::<u64>()).sum()
                });
                let rate = samples as f64 / begun.elapsed().as_secs_f64();
                println!("{threads:>8} {turned:>10} {rate:>14.1}   ({counted} electrons)");
            }
        }
    }
}
