//! BaTiO3 specimens at full size against the tables of the worlds, measured from the sites.

use std::collections::BTreeMap;

use crate::common::specimen;
use crate::specimens::{
    CASES, Case, assert_rate, by_parts, cases, normal_cdf, shortest, signed_distance,
};
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::{BoundaryKind, SiteKind, SpecimenSite};

const TI: u8 = 22;
const BA: u8 = 56;
const OXYGEN: u8 = 8;

fn lines(case: &Case) -> Vec<Vec<[f64; 2]>> {
    case.specimen.boundaries().into_iter().map(|b| b.line_nm).collect()
}

#[test]
fn barium_titanate_boundaries_are_as_many_and_as_wavy_as_asked() {
    for (case, (count, waviness)) in cases("batio3").zip([(1, 0.0), (2, 0.05), (3, 0.10)]) {
        let field = case.recipe.field.full_region();
        let width = field.x[1] - field.x[0];
        let boundaries = case.specimen.boundaries();
        assert_eq!(boundaries.len(), count, "{}", case.name);
        for (k, boundary) in boundaries.iter().enumerate() {
            let sides = [k % 2, (k + 1) % 2];
            let sigma = case.recipe.domains.as_ref().unwrap().sharpness_sigma_px
                * case.recipe.field.pixel_nm();
            assert_eq!(boundary.kind, BoundaryKind::Phase { sides, sharpness_sigma_nm: sigma });
            let mean = width * (k + 1) as f64 / (count + 1) as f64 + field.x[0];
            let line = &boundary.line_nm;
            assert_eq!([line[0][1], line.last().unwrap()[1]], field.y);
            let excursions = || line.iter().map(|p| p[0] - mean);
            let greatest = excursions().fold(0.0, |g: f64, e| g.max(e.abs())) / width;
            assert!((greatest - waviness).abs() < 5e-4, "{}: {greatest}", case.name);
            let average = excursions().sum::<f64>() / line.len() as f64;
            assert!(average.abs() < 0.05, "{}: {average}", case.name);
        }
    }
}

#[test]
fn barium_titanate_vacancies_follow_rate_and_clusters() {
    for (case, (rate, clustered)) in cases("batio3").zip([(0.04, 0.6), (0.03, 0.7), (0.015, 0.8)]) {
        let lines = lines(case);
        // Columns of a part are tallied by their distance in steps of 1 nm.
        let mut all = [0u64; 2];
        let mut by_distance: BTreeMap<i64, [u64; 2]> = BTreeMap::new();
        let mut counts: BTreeMap<u8, u64> = BTreeMap::new();
        by_parts(&*case.specimen, &case.recipe, |part| {
            for column in &part.columns {
                let members = &part.sites[column.sites.clone()];
                members.iter().for_each(|s| *counts.entry(s.number).or_default() += 1);
                let oxygen = || members.iter().filter(|s| s.number == OXYGEN);
                if oxygen().next().is_none() {
                    continue;
                }
                let d = signed_distance(&lines, column.position_nm).1.abs();
                let vacant = oxygen().filter(|s| s.kind == SiteKind::Vacancy).count() as u64;
                for tally in [&mut all, by_distance.entry(d as i64).or_default()] {
                    tally[0] += oxygen().count() as u64;
                    tally[1] += vacant;
                }
            }
            let known = |s: &&SpecimenSite| match s.kind {
                SiteKind::Pristine => true,
                SiteKind::Vacancy => s.number == OXYGEN,
                SiteKind::Substitution => false,
            };
            assert_eq!(part.sites.iter().filter(known).count(), part.sites.len());
        });
        assert_rate(all, rate, 3.0, &case.name);
        let far = by_distance.range(20..).fold([0; 2], |s, (_, t)| [s[0] + t[0], s[1] + t[1]]);
        assert!(far[0] > 50_000, "{}: {far:?}", case.name);
        assert_rate(far, (1.0 - clustered) * rate, 3.0, &format!("{}, far away", case.name));
        // About the boundary the excess falls like a Gaussian of 5 nm, or the cap of 25 % is reached.
        let excess = |bins: std::ops::Range<i64>| {
            let t = by_distance.range(bins).fold([0; 2], |s, (_, t)| [s[0] + t[0], s[1] + t[1]]);
            t[1] as f64 / t[0] as f64 - (1.0 - clustered) * rate
        };
        let gaussian = |d: f64| (-0.5 * (d / 5.0f64).powi(2)).exp();
        let expected = (gaussian(10.5) + gaussian(11.5)) / (gaussian(5.5) + gaussian(6.5));
        let ratio = excess(10..12) / excess(5..7);
        assert!((ratio / expected - 1.0).abs() < 0.15, "{}: {ratio}, {expected}", case.name);
        assert!(excess(0..1) < 0.25, "{}", case.name);
        // One Ba and one Ti for three O.
        for (element, share) in [(BA, 0.2), (TI, 0.2), (OXYGEN, 0.6)] {
            let found = counts[&element] as f64 / counts.values().sum::<u64>() as f64;
            assert!((found - share).abs() < 1e-3, "{}: {found}", case.name);
        }
    }
}

/// Distance along c of the equatorial oxygen, which shares its column, from titanium: (0.015 + 0.018) c.
const POLAR_NM: f64 = 0.033 * 0.4018;

/// (boundary, signed distance, order parameter) of every Ti column near a boundary, from the shift
/// of its oxygen against its titanium.
fn order_parameters(case: &Case, within_nm: f64) -> Vec<(usize, f64, f64)> {
    let lines = lines(case);
    let mut out = Vec::new();
    by_parts(&*case.specimen, &case.recipe, |part| {
        for column in &part.columns {
            let members = &part.sites[column.sites.clone()];
            let x = |n: u8| members.iter().find(|s| s.number == n).map(|s| s.position_nm[0]);
            let (Some(titanium), Some(oxygen)) = (x(TI), x(OXYGEN)) else { continue };
            let (n, d) = signed_distance(&lines, column.position_nm);
            if d.abs() < within_nm {
                out.push((n, d, (oxygen - titanium) / POLAR_NM));
            }
        }
    });
    out
}

#[test]
fn the_polar_displacement_passes_with_the_sharpness_of_the_tier() {
    for (case, sigma_px) in cases("batio3").zip([80.0, 50.0, 25.0]) {
        let sigma = sigma_px * case.recipe.field.pixel_nm();
        let measured = order_parameters(case, 4.0 * sigma);
        assert!(measured.len() > 1000);
        let misfit = |s: f64| -> f64 {
            let term = |&(n, d, eta): &(usize, f64, f64)| {
                let rising = if n % 2 == 0 { d } else { -d };
                (eta - normal_cdf(rising / s)).powi(2)
            };
            measured.iter().map(term).sum::<f64>() / measured.len() as f64
        };
        let trials = (50..=150).map(|p| f64::from(p) / 100.0);
        let best = trials.min_by(|a, b| misfit(a * sigma).total_cmp(&misfit(b * sigma))).unwrap();
        assert!((best - 1.0).abs() <= 0.03, "{}: {best} of sigma", case.name);
        assert!(misfit(sigma).sqrt() < 0.02, "{}: {}", case.name, misfit(sigma).sqrt());
    }
}

#[test]
fn domains_have_the_lattice_of_their_phase_and_nothing_jumps() {
    for case in cases("batio3") {
        let field = case.recipe.field.full_region();
        let lines = lines(case);
        // One row of Ba columns across the field.
        let strip = Region { x: field.x, y: [40.0, 40.401] };
        let mut row: Vec<[f64; 2]> = Vec::new();
        let part = case.specimen.query(&strip);
        for column in &part.columns {
            let first = &part.sites[column.sites.start];
            if first.number == BA
                && row.first().is_none_or(|r| (r[1] - column.position_nm[1]).abs() < 0.1)
            {
                row.push(column.position_nm);
            }
        }
        row.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert!(row.len() > 240, "{}", case.name);
        let mut seen = [0; 2];
        for pair in row.windows(2) {
            let middle = [0.5 * (pair[0][0] + pair[1][0]), pair[0][1]];
            let spacing = 10.0 * (pair[1][0] - pair[0][0]);
            assert!((4.0089..4.0181).contains(&spacing), "{}: {spacing}", case.name);
            assert_eq!(pair[0][1], pair[1][1]);
            let (_, d) = signed_distance(&lines, middle);
            let phase = case.specimen.phase_at(middle);
            if d.abs() > 8.0 {
                assert!((spacing - [4.009, 4.018][phase]).abs() < 1e-4, "{}: {spacing}", case.name);
                seen[phase] += 1;
            }
        }
        assert!(seen[0] > 20 && seen[1] > 20, "{}: {seen:?}", case.name);
        assert!((case.specimen.facts().thickness_nm - 25.0 * 0.4009).abs() < 1e-9);
        for x in [20.0, 49.0, 51.0, 73.0] {
            let distance = shortest(&*case.specimen, &Region { x: [x, x + 3.0], y: [30.0, 33.0] });
            assert!(distance > 1.8, "{}: {distance} A at {x} nm", case.name);
        }
    }
}

#[test]
fn another_seed_bends_the_boundaries_otherwise_and_keeps_the_rate() {
    let first = &CASES[&("batio3", Difficulty::Hard)];
    let recipe = Recipe { seed: 2, ..first.recipe.clone() };
    let second = specimen(&recipe).unwrap();
    let apart = |k: usize| {
        let (a, b) = (&first.specimen.boundaries()[k], &second.boundaries()[k]);
        let pairs = a.line_nm.iter().zip(&b.line_nm);
        pairs.map(|(p, q)| (p[0] - q[0]).abs()).fold(0.0, f64::max)
    };
    assert!((0..3).all(|k| apart(k) > 1.0));
    let mut oxygen = [0u64; 2];
    by_parts(&*second, &recipe, |part| {
        for site in part.sites.iter().filter(|s| s.number == OXYGEN) {
            oxygen[0] += 1;
            oxygen[1] += u64::from(site.kind == SiteKind::Vacancy);
        }
    });
    assert_rate(oxygen, 0.015, 3.0, "seed 2");
}
