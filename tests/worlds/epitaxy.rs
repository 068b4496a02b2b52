//! Si/Ge and InGaN specimens at full size against the tables of the worlds, measured from the sites.

use std::collections::{BTreeMap, HashSet};

use crate::common::specimen;
use crate::specimens::{CASES, Case, assert_rate, by_parts, cases, normal_cdf, number, shortest};
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::SiteKind;

/// Sites and guests in equal parts of the field's width.
fn guests(case: &Case, host: u8, guest: u8, bins: usize) -> Vec<[u64; 2]> {
    let field = case.recipe.field.full_region();
    let mut out = vec![[0; 2]; bins];
    by_parts(&*case.specimen, &case.recipe, |part| {
        for site in &part.sites {
            let is_guest = site.number == guest;
            assert_eq!(is_guest, site.kind == SiteKind::Substitution);
            if site.number == host || is_guest {
                let x = (site.position_nm[0] - field.x[0]) / (field.x[1] - field.x[0]);
                let tally = &mut out[((x * bins as f64) as usize).min(bins - 1)];
                tally[0] += 1;
                tally[1] += u64::from(is_guest);
            }
        }
    });
    out
}

#[test]
fn germanium_rises_linearly_to_twice_the_rate() {
    for (case, rate) in cases("sige").zip([0.05, 0.03, 0.01]) {
        let bins = guests(case, number("Si"), number("Ge"), 20);
        let all = bins.iter().fold([0; 2], |s, t| [s[0] + t[0], s[1] + t[1]]);
        assert_rate(all, rate, 3.0, &case.name);
        for (k, bin) in bins.iter().enumerate() {
            let expected = 2.0 * rate * (k as f64 + 0.5) / 20.0;
            assert_rate(*bin, expected, 4.0, &format!("{}, part {k}", case.name));
        }
        assert!(case.specimen.facts().phases.is_empty() && case.specimen.boundaries().is_empty());
    }
}

#[test]
fn silicon_germanium_follows_vegard_along_growth_and_silicon_across() {
    let (si, ge) = (5.431, 5.6578);
    for (case, rate) in cases("sige").zip([0.05, 0.03, 0.01]) {
        let field = case.recipe.field.full_region();
        let part = case.specimen.query(&Region { x: field.x, y: [20.0, 20.7681] });
        // Along x, columns at one height follow each other at a distance of a.
        let mut rows: BTreeMap<i64, Vec<f64>> = BTreeMap::new();
        for column in &part.columns {
            let [x, y] = column.position_nm;
            rows.entry((y * 1e4).round() as i64).or_default().push(x);
        }
        // Four heights along y a quarter of [1-10] apart, on each of which two kinds of column stand.
        let heights: Vec<i64> = rows.keys().copied().collect();
        let period = 1e3 * si / 2f64.sqrt() / 2.0;
        for pair in heights.windows(2) {
            assert!(((pair[1] - pair[0]) as f64 - period).abs() < 2.0, "{}", case.name);
        }
        for row in rows.values_mut() {
            row.sort_by(f64::total_cmp);
            let step = 4;
            for n in 0..row.len().saturating_sub(step) {
                let cells = 10.0 * (row[n + step] - row[n]) / si;
                let whole = cells.round();
                let middle = 0.5 * (row[n + step] + row[n]) - field.x[0];
                let fraction = 2.0 * rate * middle / (field.x[1] - field.x[0]);
                let expected = 1.0 + fraction.clamp(0.0, 2.0 * rate) * (ge / si - 1.0);
                let found = cells / whole;
                assert!((found - expected).abs() < 2e-5, "{}: {found} {expected}", case.name);
            }
        }
        let distance = shortest(&*case.specimen, &Region { x: [44.0, 48.0], y: [20.0, 23.0] });
        assert!((distance - 2.352).abs() < 0.03, "{}: {distance}", case.name);
    }
}

/// Ranges of x that lie in a well along a line of constant y.
fn wells_along(case: &Case, y: f64) -> Vec<[f64; 2]> {
    let field = case.recipe.field.full_region();
    let step = 1e-3;
    let count = ((field.x[1] - field.x[0]) / step) as usize;
    let mut out: Vec<[f64; 2]> = Vec::new();
    for n in 0..count {
        let x = field.x[0] + (n as f64 + 0.5) * step;
        if case.specimen.phase_at([x, y]) == 0 {
            continue;
        }
        match out.last_mut() {
            Some(last) if x - last[1] < 2.0 * step => last[1] = x,
            _ => out.push([x, x]),
        }
    }
    out
}

const WELLS: [(f64, usize, f64, f64, f64); 3] =
    [(0.05, 5, 4.0, 0.0, 0.20), (0.03, 6, 3.0, 0.25, 0.13), (0.01, 8, 2.0, 0.5, 0.05)];

#[test]
fn indium_has_its_mean_and_stays_in_the_wells() {
    for (case, (rate, count, width, roughness, in_wells)) in cases("gan").zip(WELLS) {
        let all = guests(case, number("Ga"), number("In"), 1)[0];
        assert_rate(all, rate, 3.0, &case.name);
        assert_eq!(case.specimen.facts().phases, ["barrier", "well"]);
        let mut inside = [0u64; 2];
        let centres: Vec<f64> =
            (0..count).map(|k| -0.0161 + 80.0 * (k as f64 + 0.5) / count as f64).collect();
        by_parts(&*case.specimen, &case.recipe, |part| {
            for site in part.sites.iter().filter(|s| s.number != number("N")) {
                let x = site.position_nm[0];
                let d = centres.iter().map(|c| (x - c).abs()).fold(f64::INFINITY, f64::min);
                let indium = site.number == number("In");
                // Four standard deviations and more from an interface there is no doubt.
                if d < width / 2.0 - 4.5 * roughness {
                    inside[0] += 1;
                    inside[1] += u64::from(indium);
                }
                assert!(!indium || d < width / 2.0 + 5.0 * roughness + 1e-6, "{} {d}", case.name);
            }
        });
        if inside[0] > 0 {
            let fraction = inside[1] as f64 / inside[0] as f64;
            assert!((fraction - in_wells).abs() < 0.007, "{}: {fraction}", case.name);
        }
    }
}

#[test]
fn wells_are_as_many_and_as_wide_as_asked() {
    for (case, (_, count, width, roughness, _)) in cases("gan").zip(WELLS) {
        let field = case.recipe.field.full_region();
        assert_eq!(case.specimen.boundaries().len(), 2 * count);
        let ys = (0..40).map(|k| 1.0 + 2.0 * f64::from(k));
        let all: Vec<Vec<[f64; 2]>> = ys.map(|y| wells_along(case, y)).collect();
        for k in 0..count {
            let mean = |f: &dyn Fn([f64; 2]) -> f64| {
                all.iter().map(|wells| f(wells[k])).sum::<f64>() / all.len() as f64
            };
            let centre = field.x[0] + 80.0 * (k as f64 + 0.5) / count as f64;
            let tolerance = 0.003 + 0.5 * roughness;
            assert!((mean(&|w| w[1] - w[0]) - width).abs() < tolerance, "{}", case.name);
            assert!((mean(&|w| 0.5 * (w[0] + w[1])) - centre).abs() < tolerance, "{}", case.name);
        }
        assert!(all.iter().all(|wells| wells.len() == count), "{}", case.name);
    }
}

#[test]
fn interfaces_are_as_rough_as_asked() {
    // Enough indium to tell the inside of a well from the outside.
    for (difficulty, roughness) in [(Difficulty::Medium, 0.25), (Difficulty::Hard, 0.5)] {
        let mut recipe = Recipe::load("gan", difficulty).unwrap();
        recipe.alloy.as_mut().unwrap().rate = 0.15;
        let specimen = specimen(&recipe).unwrap();
        let (width, count) = {
            let wells = recipe.wells.as_ref().unwrap();
            (wells.width_nm, wells.count)
        };
        let centre = |k: usize| -0.0161 + 80.0 * (k as f64 + 0.5) / count as f64;
        let mut tally: BTreeMap<i64, [f64; 2]> = BTreeMap::new();
        by_parts(&*specimen, &recipe, |part| {
            for site in part.sites.iter().filter(|s| s.number != number("N")) {
                let x = site.position_nm[0];
                let d = (0..count).map(|k| (x - centre(k)).abs()).fold(f64::INFINITY, f64::min);
                let bin = tally.entry(((d - width / 2.0) * 100.0).floor() as i64).or_default();
                bin[0] += 1.0;
                bin[1] += f64::from(u8::from(site.number == number("In")));
            }
        });
        // Sum of squares for the best fraction.
        let misfit = |sigma: f64| -> f64 {
            let mut sums = [0.0; 3];
            for (bin, [n, indium]) in &tally {
                let d = (*bin as f64 + 0.5) / 100.0;
                let inside = normal_cdf(-d / sigma) - normal_cdf(-(d + width) / sigma);
                sums[0] += indium * indium / n;
                sums[1] += indium * inside;
                sums[2] += n * inside * inside;
            }
            sums[0] - sums[1] * sums[1] / sums[2]
        };
        let trials = (50..=150).map(|p| f64::from(p) / 100.0);
        let best =
            trials.min_by(|a, b| misfit(a * roughness).total_cmp(&misfit(b * roughness))).unwrap();
        assert!((best - 1.0).abs() < 0.1, "{}: {} of the roughness", difficulty.name(), best);
    }
}

#[test]
fn wells_are_strained_along_c_and_coherent_across() {
    let case = &CASES[&("gan", Difficulty::Easy)];
    let recipe = &case.recipe;
    let fraction = 0.2046;
    // Vegard and Poisson with the constants of Vurgaftman and Meyer (2003).
    let vegard = |gan: f64, inn: f64| gan + fraction * (inn - gan);
    let (a, c) = (vegard(3.189, 3.545), vegard(5.185, 5.703));
    let strain = (3.189 - a) / a;
    let c = c * (1.0 - 2.0 * vegard(106.0, 92.0) / vegard(398.0, 224.0) * strain);
    let part = case.specimen.query(&Region { x: [0.0, 79.9], y: [40.0, 40.5524] });
    let mut rows: BTreeMap<(i64, u8), Vec<f64>> = BTreeMap::new();
    for column in &part.columns {
        let [x, y] = column.position_nm;
        let nitrogen = part.sites[column.sites.start].number == number("N");
        rows.entry(((y * 1e3).round() as i64, u8::from(nitrogen))).or_default().push(x);
    }
    let mut seen = [0; 2];
    for row in rows.values_mut() {
        row.sort_by(f64::total_cmp);
        for pair in row.windows(2) {
            let spacing = 10.0 * (pair[1] - pair[0]);
            let wells = [8.0, 24.0, 40.0, 56.0, 72.0].map(|w| w - 0.0161);
            let place = |x: f64| wells.iter().map(|w| (x - w).abs()).fold(f64::INFINITY, f64::min);
            let (near, far) =
                (place(pair[0]).min(place(pair[1])), place(pair[0]).max(place(pair[1])));
            if far < 2.0 {
                assert!((spacing - c).abs() < 2e-3, "{spacing}, expected {c}");
                seen[1] += 1;
            } else if near > 2.0 && (pair[1] - pair[0]) < 1.0 {
                assert!((spacing - 5.185).abs() < 1e-4, "{spacing}");
                seen[0] += 1;
            }
        }
    }
    assert!(seen[0] > 100 && seen[1] > 50, "{seen:?}");
    // Across c, zigzag rows stand a sqrt(3) / 6 and a sqrt(3) / 3 apart.
    let heights: HashSet<i64> = rows.keys().map(|k| k.0).collect();
    let mut heights: Vec<i64> = heights.into_iter().collect();
    heights.sort_unstable();
    for pair in heights.windows(2) {
        let step = (pair[1] - pair[0]) as f64 * 1e-2;
        let units = step / (3.189 * 3f64.sqrt() / 6.0);
        assert!((units - units.round()).abs() < 0.02, "{step} A");
    }
    assert!((case.specimen.facts().thickness_nm - 31.0 * 0.3189).abs() < 1e-6);
    for case in cases("gan") {
        let distance = shortest(&*case.specimen, &Region { x: [4.0, 12.0], y: [20.0, 22.0] });
        assert!((1.93..1.96).contains(&distance), "{}: {distance}", case.name);
    }
    assert_eq!(recipe.field.full_region().x[0], -0.5 * recipe.field.pixel_nm());
}
