//! The SrTiO3 specimen at full size: rates, clusters, boundaries, and that every region shows the
//! same atoms.

use super::cases::cases;
use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use crate::common::specimen;
use proptest::prelude::*;
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::{BoundaryKind, SiteKind, Specimen, SpecimenSite};

const OXYGEN: u8 = 8;

struct Case {
    difficulty: Difficulty,
    recipe: Recipe,
    specimen: std::sync::Arc<dyn Specimen>,
}

static CASES: LazyLock<Vec<Case>> = LazyLock::new(|| {
    let case = |difficulty| {
        let recipe = Recipe::load("srtio3", difficulty).unwrap();
        Case { difficulty, specimen: specimen(&recipe).unwrap(), recipe }
    };
    Difficulty::ALL.into_iter().map(case).collect()
});

fn field(recipe: &Recipe) -> Region {
    recipe.field.full_region()
}

fn planes(case: &Case) -> Vec<f64> {
    case.specimen.boundaries().iter().map(|b| b.line_nm[0][0]).collect()
}

/// Oxygen sites and vacancies at most and at least some distance from the boundaries.
#[derive(Default)]
struct Tally {
    all: [u64; 2],
    far: [u64; 2],
    above_cap: bool,
}

fn tally(case: &Case) -> Tally {
    let planes = planes(case);
    let mut tally = Tally::default();
    let mut bins: HashMap<i64, [u64; 2]> = HashMap::new();
    for site in case.specimen.sites(&field(&case.recipe)) {
        let vacant = site.kind == SiteKind::Vacancy;
        assert!(!vacant || site.number == OXYGEN);
        if site.number != OXYGEN {
            continue;
        }
        let x = site.position_nm[0];
        let d = planes.iter().map(|p| (x - p).abs()).fold(f64::INFINITY, f64::min);
        let add = |c: &mut [u64; 2]| {
            c[0] += 1;
            c[1] += u64::from(vacant);
        };
        add(&mut tally.all);
        add(bins.entry((d * 2.0) as i64).or_default());
        if d > 20.0 {
            add(&mut tally.far);
        }
    }
    let over = |[n, v]: &[u64; 2]| *v as f64 / *n as f64 > 0.25 + 4.0 * (0.19 / *n as f64).sqrt();
    tally.above_cap = bins.values().any(over);
    tally
}

fn assert_rate([sites, vacant]: [u64; 2], expected: f64, what: &str) {
    let (n, rate) = (sites as f64, vacant as f64 / sites as f64);
    let error = (expected * (1.0 - expected) / n).sqrt();
    assert!((rate - expected).abs() < 3.0 * error, "{what}: {rate} of {n}, expected {expected}");
}

#[test]
fn rates_clusters_and_boundaries_are_those_of_the_tables() {
    let table = [(1, 0.05, 0.6, 36.8699), (2, 0.03, 0.7, 22.6199), (3, 0.01, 0.8, 8.7974)];
    for (case, (count, rate, clustered, degrees)) in CASES.iter().zip(table) {
        let name = case.difficulty.name();
        let boundaries = case.specimen.boundaries();
        assert_eq!(boundaries.len(), count, "{name}");
        for (k, boundary) in boundaries.iter().enumerate() {
            let expected = 100.0 * (k + 1) as f64 / (count + 1) as f64;
            assert!((boundary.line_nm[0][0] - expected).abs() < 0.2, "{name}");
            let BoundaryKind::Grain { misorientation_deg, .. } = boundary.kind else {
                panic!("{boundary:?}")
            };
            assert!((misorientation_deg - degrees).abs() < 1e-3, "{name}");
        }
        let tally = tally(case);
        assert_rate(tally.all, rate, name);
        assert_rate(tally.far, (1.0 - clustered) * rate, name);
        assert!(!tally.above_cap, "{name}");
        assert!((case.specimen.facts().thickness_nm - 26.0 * 0.3905).abs() < 1e-9);
    }
}

/// Least distance per pair of elements (Angstrom) in one period of thickness at the boundaries.
fn least_distances(case: &Case, y: [f64; 2]) -> HashMap<(u8, u8), f64> {
    let mut least: HashMap<(u8, u8), f64> = HashMap::new();
    for plane in planes(case) {
        let region = Region { x: [plane - 1.2, plane + 1.2], y };
        let mut sites = case.specimen.sites(&region);
        sites.retain(|s| s.position_nm[2] < 0.8);
        sites.sort_by(|a, b| a.position_nm[1].total_cmp(&b.position_nm[1]));
        for (n, a) in sites.iter().enumerate() {
            let near = |b: &&SpecimenSite| b.position_nm[1] - a.position_nm[1] < 0.4;
            for b in sites[n + 1..].iter().take_while(near) {
                let d2: f64 = (0..3).map(|k| (a.position_nm[k] - b.position_nm[k]).powi(2)).sum();
                let pair = (a.number.min(b.number), a.number.max(b.number));
                let entry = least.entry(pair).or_insert(f64::INFINITY);
                *entry = entry.min(10.0 * d2.sqrt());
            }
        }
    }
    least
}

#[test]
fn atoms_keep_their_distance_along_every_boundary() {
    let number = |s: &str| stemgen::structure::elements::atomic_number(s).unwrap();
    for case in CASES.iter() {
        let least = least_distances(case, [-10.0, 110.0]);
        for (pair, &limit) in &case.recipe.boundaries.as_ref().unwrap().min_distance_angstrom {
            let (a, b) = pair.split_once('-').unwrap();
            let (a, b) = (number(a), number(b));
            let found = least.get(&(a.min(b), a.max(b))).copied().unwrap_or(f64::INFINITY);
            assert!(found > limit - 1e-6, "{}: {pair} {found} A", case.difficulty.name());
        }
    }
}

#[test]
fn any_angle_keeps_the_distances() {
    for degrees in [3.3, 17.0, 28.07, 45.0, 61.9, 90.0] {
        let mut recipe = Recipe::load("srtio3", Difficulty::Hard).unwrap();
        let boundaries = recipe.boundaries.as_mut().unwrap();
        (boundaries.misorientation_deg, boundaries.sigma) = (degrees, None);
        let specimen = specimen(&recipe).unwrap();
        let case = Case { difficulty: Difficulty::Hard, recipe, specimen };
        let least = least_distances(&case, [20.0, 80.0]);
        assert!(least[&(8, 22)] > 1.75 - 1e-6 && least[&(22, 22)] > 2.6 - 1e-6, "{degrees}");
        assert!(least[&(38, 38)] > 3.1 - 1e-6 && least[&(8, 38)] > 2.3 - 1e-6, "{degrees}");
    }
}

/// Positions in units of 1e-4 nm, and elements, of one layer of the boundary region.
fn layer(case: &Case, y: [f64; 2], shift: f64) -> HashSet<(i64, i64, u8)> {
    let mut out = HashSet::new();
    for plane in planes(case) {
        let region = Region { x: [plane - 1.0, plane + 1.0], y };
        for site in case.specimen.sites(&region).iter().filter(|s| s.position_nm[2] < 0.39) {
            let fixed = |v: f64| (v * 1e4).round() as i64;
            let [px, py, _] = site.position_nm;
            out.insert((fixed(px - plane), fixed(py - shift), site.number));
        }
    }
    out
}

#[test]
fn coincidence_boundaries_are_periodic_and_mirror_symmetric() {
    for (case, sum) in CASES.iter().zip([10.0f64, 26.0, 170.0]) {
        let period = 0.3905 * sum.sqrt();
        let y = [40.123, 50.123];
        let here = layer(case, y, 0.0);
        for n in [-6.0, 1.0, 5.0] {
            let shift = n * period;
            let there = layer(case, [y[0] + shift, y[1] + shift], shift);
            let near = |&(x, y, z): &(i64, i64, u8)| {
                (-1..=1).any(|i| (-1..=1).any(|j| there.contains(&(x + i, y + j, z))))
            };
            assert!(here.len() == there.len() && here.iter().all(near), "{n}");
        }
        let mirrored = here.iter().all(|&(x, y, z)| {
            (-2..=2).any(|i| (-1..=1).any(|j| here.contains(&(i - x, y + j, z))))
        });
        assert!(mirrored, "{}", case.difficulty.name());
    }
}

#[test]
fn few_atoms_are_lost_at_a_boundary() {
    for case in CASES.iter() {
        for plane in planes(case) {
            let region = Region { x: [plane - 1.0, plane + 1.0], y: [20.0, 80.0] };
            let density = case.specimen.sites(&region).len() as f64 / 120.0;
            let perfect = 5.0 * 26.0 / (0.3905f64 * 0.3905);
            let ratio = density / perfect;
            assert!((0.90..=1.02).contains(&ratio), "{}: {ratio}", case.difficulty.name());
        }
    }
}

#[test]
fn a_crop_holds_the_sites_of_a_larger_one() {
    let recipe = |n| Recipe::load("srtio3", Difficulty::Easy).unwrap().with_grid(n, n).unwrap();
    let built = |r: &Recipe| {
        let shape = r.field.pixels(r.field.built_grid());
        Region::of_pixels(r.field.crop_origin_px(), shape, r.field.pixel_nm())
    };
    let (small, large) = (recipe(2), recipe(4));
    let sites = |r: &Recipe| specimen(r).unwrap().sites(&built(r));
    let of_large: HashMap<u64, SpecimenSite> =
        sites(&large).into_iter().map(|s| (s.key, s)).collect();
    let of_small = sites(&small);
    assert!(!of_small.is_empty() && of_small.iter().all(|s| of_large.get(&s.key) == Some(s)));
    let inside = |s: &&SpecimenSite| built(&small).contains([s.position_nm[0], s.position_nm[1]]);
    assert_eq!(of_large.values().filter(inside).count(), of_small.len());
}

#[test]
fn cations_beside_a_vacancy_move_away_when_asked() {
    let mut recipe = Recipe::load("srtio3", Difficulty::Easy).unwrap();
    let region = Region { x: [48.0, 52.0], y: [30.0, 34.0] };
    let rigid = specimen(&recipe).unwrap().sites(&region);
    recipe.vacancies.as_mut().unwrap().relaxation_angstrom = 0.1;
    let relaxed_specimen = specimen(&recipe).unwrap();
    let relaxed = relaxed_specimen.sites(&region);
    let moved = |(a, b): &(&SpecimenSite, &SpecimenSite)| a.position_nm != b.position_nm;
    let pairs: Vec<_> = rigid.iter().zip(&relaxed).collect();
    assert!(pairs.iter().all(|(a, b)| a.key == b.key));
    let count = pairs.iter().filter(|p| moved(p)).count();
    assert!(count > pairs.len() / 20 && count < pairs.len() / 2, "{count} of {}", pairs.len());
    assert!(pairs.iter().filter(|p| moved(p)).all(|(a, _)| a.number != OXYGEN));
    let part = Region { x: [49.0, 50.5], y: [31.0, 32.0] };
    let all: HashMap<u64, SpecimenSite> = relaxed.into_iter().map(|s| (s.key, s)).collect();
    assert!(relaxed_specimen.sites(&part).iter().all(|s| all.get(&s.key) == Some(s)));
}

proptest! {
    #![proptest_config(cases(40))]
    /// A region shows the same sites as the two halves that it falls into, and no key twice.
    #[test]
    fn regions_agree(
        tier in 0usize..3,
        x in -15.0f64..110.0,
        y in -15.0f64..110.0,
        w in 0.1f64..4.0,
        h in 0.1f64..4.0,
        cut in 0.0f64..1.0,
    ) {
        let specimen = &CASES[tier].specimen;
        let middle = x + cut * w;
        let ys = [y, y + h];
        let whole = specimen.sites(&Region { x: [x, x + w], y: ys });
        let mut parts = specimen.sites(&Region { x: [x, middle], y: ys });
        parts.extend(specimen.sites(&Region { x: [middle, x + w], y: ys }));
        let by_key = |sites: &[SpecimenSite]| -> HashMap<u64, [u64; 3]> {
            sites.iter().map(|s| (s.key, s.position_nm.map(f64::to_bits))).collect()
        };
        prop_assert_eq!(whole.len(), parts.len());
        prop_assert_eq!(by_key(&whole).len(), whole.len());
        prop_assert_eq!(by_key(&whole), by_key(&parts));
    }
}
