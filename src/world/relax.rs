//! Outward relaxation of the atoms beside a vacancy.

use std::collections::{BTreeMap, HashMap};

use super::specimen::{SiteKind, SpecimenSite};

/// Neighbours up to this many times the shortest distance of their pair of elements move: more than
/// the nearest shell, less than the next.
const SHELL: f64 = 1.15;

/// How far from a vacancy of one element atoms of the others move.
#[derive(Debug, Clone, Default)]
pub struct Reach(BTreeMap<u8, f64>);

impl Reach {
    /// For vacancies of `element`; `shortest` are the shortest distances in the crystal in Angstrom.
    pub fn new(element: u8, shortest: &BTreeMap<(u8, u8), f64>) -> Self {
        let of = |(&(a, b), d): (&(u8, u8), &f64)| {
            let other = if a == element { b } else { a };
            ((a == element || b == element) && other != element).then_some((other, 0.1 * SHELL * d))
        };
        Reach(shortest.iter().filter_map(of).collect())
    }
    /// For atoms of `number`, in nm.
    fn of(&self, number: u8) -> f64 {
        self.0.get(&number).copied().unwrap_or(0.0)
    }
    /// The greatest, in nm.
    pub fn greatest_nm(&self) -> f64 {
        self.0.values().copied().fold(0.0, f64::max)
    }
}

/// Moves every site within `reach` of a vacancy by `distance_nm` away from it. The result does not depend on the order of `vacant`.
pub fn outward(
    sites: &mut [SpecimenSite],
    vacant: &[SpecimenSite],
    distance_nm: f64,
    reach: &Reach,
) {
    let edge = reach.greatest_nm();
    if edge <= 0.0 {
        return;
    }
    let cell = |p: [f64; 3]| p.map(|v| (v / edge).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<&SpecimenSite>> = HashMap::new();
    for vacancy in vacant {
        cells.entry(cell(vacancy.position_nm)).or_default().push(vacancy);
    }
    let around = |[i, j, k]: [i64; 3]| {
        (0..27).map(move |n| [i + n % 3 - 1, j + n / 3 % 3 - 1, k + n / 9 - 1])
    };
    for site in sites.iter_mut().filter(|s| s.kind != SiteKind::Vacancy) {
        let (from, reach_nm) = (site.position_nm, reach.of(site.number));
        let near = around(cell(from)).filter_map(|c| cells.get(&c)).flatten();
        let away = |v: &&SpecimenSite| {
            let d = [0, 1, 2].map(|k| from[k] - v.position_nm[k]);
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            (length < reach_nm && length > 1e-9).then(|| (v.key, d.map(|c| c / length)))
        };
        let mut pushes: Vec<(u64, [f64; 3])> = near.filter_map(away).collect();
        pushes.sort_by_key(|(key, _)| *key);
        for (_, direction) in pushes {
            for k in 0..3 {
                site.position_nm[k] += distance_nm * direction[k];
            }
        }
    }
}
