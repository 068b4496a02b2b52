//! Specimens of all tiers, and what tests measure in them.
//!
//! Each test file uses a part of this.
#![allow(dead_code)]

use std::collections::HashMap;
use std::sync::LazyLock;

use crate::common::specimen;
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::{Sites, Specimen};
use stemgen::structure::{Atom, Structure, elements, min_pair_distance};

/// A specimen of the full field.
pub struct Case {
    pub name: String,
    pub recipe: Recipe,
    pub specimen: std::sync::Arc<dyn Specimen>,
}

pub static CASES: LazyLock<HashMap<(&str, Difficulty), Case>> = LazyLock::new(|| {
    let mut cases = HashMap::new();
    for material in ["batio3", "sige", "gan"] {
        for difficulty in Difficulty::ALL {
            let recipe = Recipe::load(material, difficulty).unwrap();
            let name = format!("{material} {}", difficulty.name());
            let specimen = specimen(&recipe).unwrap();
            cases.insert((material, difficulty), Case { name, recipe, specimen });
        }
    }
    cases
});

pub fn cases(material: &'static str) -> impl Iterator<Item = &'static Case> {
    Difficulty::ALL.into_iter().map(move |d| &CASES[&(material, d)])
}

/// Calls `f` for parts of the full field.
pub fn by_parts(specimen: &dyn Specimen, recipe: &Recipe, mut f: impl FnMut(Sites)) {
    let field = recipe.field.full_region();
    let height = field.y[1] - field.y[0];
    let edge = |k: u32| field.y[0] + height * f64::from(k) / 10.0;
    for k in 0..10 {
        let y = [edge(k), if k == 9 { field.y[1] } else { edge(k + 1) }];
        f(specimen.query(&Region { x: field.x, y }));
    }
}

#[track_caller]
pub fn assert_rate([sites, defects]: [u64; 2], expected: f64, sigmas: f64, what: &str) {
    let (n, rate) = (sites as f64, defects as f64 / sites as f64);
    let error = (expected * (1.0 - expected) / n).sqrt();
    assert!((rate - expected).abs() < sigmas * error, "{what}: {rate} of {n}, expected {expected}");
}

pub fn number(symbol: &str) -> u8 {
    elements::atomic_number(symbol).unwrap()
}

/// Shortest distance in Angstrom among the atoms of a region, vacant sites counted as atoms.
pub fn shortest(specimen: &dyn Specimen, region: &Region) -> f64 {
    let atoms: Vec<Atom> = specimen
        .sites(region)
        .iter()
        .map(|s| Atom::new(s.number, s.position_nm.map(|v| 10.0 * v)))
        .collect();
    let cell = [[5000.0, 0.0, 0.0], [0.0, 5000.0, 0.0], [0.0, 0.0, 5000.0]];
    min_pair_distance(&Structure { cell, atoms }).unwrap()
}

pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / 2f64.sqrt())
}

/// Distance of a point from the corners and segments of the lines, and whether it lies to the right
/// of the nearest.
pub fn signed_distance(lines: &[Vec<[f64; 2]>], [x, y]: [f64; 2]) -> (usize, f64) {
    let mut best = (0, f64::INFINITY);
    for (n, line) in lines.iter().enumerate() {
        for s in line.windows(2) {
            if s[0][1] - y > best.1.abs() || y - s[1][1] > best.1.abs() {
                continue;
            }
            let (d, q) = ([s[1][0] - s[0][0], s[1][1] - s[0][1]], [x - s[0][0], y - s[0][1]]);
            let t = ((d[0] * q[0] + d[1] * q[1]) / (d[0] * d[0] + d[1] * d[1])).clamp(0.0, 1.0);
            let (dx, dy) = (q[0] - t * d[0], q[1] - t * d[1]);
            let distance = (dx * dx + dy * dy).sqrt();
            if distance < best.1.abs() {
                let side = d[1] * q[0] - d[0] * q[1];
                best = (n, distance.copysign(side));
            }
        }
    }
    best
}
