//! Outward relaxation of the cations beside a vacancy.

use std::collections::HashMap;

use super::specimen::{SiteKind, SpecimenSite};

/// Cations nearer than this to a vacancy move, in units of the cell edge: between the nearest
/// cations of an anion (0.5 and 0.71) and the next (1.1).
pub const REACH: f64 = 0.8;

/// Moves every site that is not of `element` by `distance_nm` away from each vacancy within
/// `reach_nm`. The result does not depend on the order of `vacant`.
pub fn outward(
    sites: &mut [SpecimenSite],
    vacant: &[SpecimenSite],
    element: u8,
    distance_nm: f64,
    reach_nm: f64,
) {
    let cell = |p: [f64; 3]| p.map(|v| (v / reach_nm).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<&SpecimenSite>> = HashMap::new();
    for vacancy in vacant {
        cells.entry(cell(vacancy.position_nm)).or_default().push(vacancy);
    }
    let around = |[i, j, k]: [i64; 3]| {
        (0..27).map(move |n| [i + n % 3 - 1, j + n / 3 % 3 - 1, k + n / 9 - 1])
    };
    for site in sites.iter_mut().filter(|s| s.number != element && s.kind != SiteKind::Vacancy) {
        let from = site.position_nm;
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
