//! Scores of the benchmark: rules by hand, and values of scikit-learn and scipy (tests/benchmark/make_references.py).

use std::collections::BTreeMap;

use ndarray::Array2;
use serde_json::Value;
use stemgen::benchmark::{
    DoseCurve, FoundColumn, FoundParticle, NO_PHASE, PAPER_RADIUS_NM, PlacedDefect,
    STRICT_RADIUS_NM, column_score, count_f1, defect_census, macro_f1, most_pairs, nearest_pairs,
    particle_census, phase_iou, spatial_f1, targeted_f1,
};

fn references(name: &str) -> Vec<Value> {
    let text = include_str!("../benchmark/references.json");
    let all: Value = serde_json::from_str(text).unwrap();
    let cases = all[name].as_array().unwrap().clone();
    assert!(cases.len() > 2);
    cases
}

fn read<T: serde::de::DeserializeOwned>(value: &Value) -> T {
    serde_json::from_value(value.clone()).unwrap()
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

#[test]
fn pairs_are_those_of_scipy() {
    for case in references("matching") {
        let (found, truth): (Vec<[f64; 2]>, Vec<[f64; 2]>) =
            (read(&case["found"]), read(&case["truth"]));
        let radius = case["radius_nm"].as_f64().unwrap();
        let expected = case["pairs"].as_u64().unwrap() as usize;
        assert_eq!(most_pairs(&found, &truth, radius), expected);
        let pairs = nearest_pairs(&found, &truth, radius);
        assert_eq!(pairs.len(), expected);
        let apart =
            |[f, t]: &[usize; 2]| (found[*f][0] - truth[*t][0]).hypot(found[*f][1] - truth[*t][1]);
        assert!(pairs.iter().all(|p| apart(p) <= radius));
        let sum: f64 = pairs.iter().map(apart).sum();
        assert!(near(sum, case["distance_nm"].as_f64().unwrap()), "{sum} {case}");
    }
}

#[test]
fn scores_are_those_of_scikit_learn() {
    for case in references("phases") {
        let map = |key: &str| {
            let rows: Vec<Vec<i32>> = read(&case[key]);
            Array2::from_shape_fn((rows.len(), rows[0].len()), |(i, j)| rows[i][j])
        };
        let found = phase_iou(Some(&map("found")), &map("truth")).unwrap();
        assert!(near(found, case["iou"].as_f64().unwrap()), "{found} {}", case["iou"]);
    }
    for case in references("classes") {
        let (found, truth): (Vec<i32>, Vec<i32>) = (read(&case["found"]), read(&case["truth"]));
        let pairs: Vec<[i32; 2]> = found.into_iter().zip(truth).map(|(a, b)| [a, b]).collect();
        assert!(near(macro_f1(&pairs), case["f1"].as_f64().unwrap()), "{case}");
    }
    for case in references("counts") {
        let counts = |key: &str| -> BTreeMap<String, u64> {
            let list: Vec<u64> = read(&case[key]);
            list.into_iter().enumerate().map(|(k, n)| (format!("kind {k}"), n)).collect()
        };
        let found = count_f1(&counts("found"), &counts("truth"));
        assert!(near(found, case["f1"].as_f64().unwrap()), "{found} {case}");
    }
    for case in references("precisions") {
        let (defects, scores): (Vec<bool>, Vec<f64>) =
            (read(&case["defect"]), read(&case["score"]));
        let place = |n: usize| [0.2 * n as f64, 1.0];
        let truth: Vec<[f64; 2]> = (0..defects.len()).filter(|n| defects[*n]).map(place).collect();
        let column =
            |(n, score): (usize, &f64)| FoundColumn { position_nm: place(n), score: *score };
        let found: Vec<FoundColumn> = scores.iter().enumerate().map(column).collect();
        let score = column_score(&found, &truth, STRICT_RADIUS_NM);
        assert!(
            near(score.average_precision, case["average_precision"].as_f64().unwrap()),
            "{case}"
        );
        assert!(
            near(score.precision, truth.len() as f64 / found.len() as f64) && score.recall == 1.0
        );
    }
}

#[test]
fn curves_are_those_of_brute_force() {
    for case in references("curves") {
        let mut curve = DoseCurve::default();
        let records: Vec<[f64; 2]> = read(&case["records"]);
        records.iter().for_each(|[share, score]| curve.record(*share, *score).unwrap());
        let expected = |key: &str| case[key].as_f64().unwrap();
        assert!(near(curve.metrics().dec_auc, expected("dec_auc_50")));
        let fine = curve.metrics_of(20_001);
        let pairs = [
            (fine.dec_auc, "dec_auc"),
            (fine.early_weighted, "early_weighted"),
            (fine.late_weighted, "late_weighted"),
            (fine.half_budget, "half_budget"),
        ];
        for (found, key) in pairs {
            assert!((found - expected(key)).abs() < 2e-4, "{key}: {found} {}", expected(key));
        }
        // The paper, 4340 episodes: K = 20 against 50 at most 0.0161, 50 against 100 ...: a jump at the first record weighs half a step.
        let [coarse, usual] = [20, 50].map(|k| curve.metrics_of(k).dec_auc);
        assert!((coarse - usual).abs() < 0.5 / 19.0 + 0.5 / 49.0);
    }
}

fn defect(kind: &str, x: f64, y: f64) -> PlacedDefect {
    PlacedDefect { kind: kind.into(), position_nm: [x, y] }
}

#[test]
fn a_census_is_by_counts_or_by_places() {
    let truth = [
        defect("vacancy", 1.0, 1.0),
        defect("vacancy", 9.0, 9.0),
        defect("substitution", 5.0, 5.0),
    ];
    let counts = |v: u64, s: u64| -> BTreeMap<String, u64> {
        [("vacancy".to_owned(), v), ("substitution".to_owned(), s)].into()
    };
    let census = |counts: &BTreeMap<String, u64>, places: Option<&[PlacedDefect]>| {
        defect_census(counts, places, &truth, PAPER_RADIUS_NM)
    };
    assert!(near(census(&counts(2, 1), None), 1.0));
    // 2 of 2, and 1 of 3 claimed: F1 1 and 0.5.
    assert!(near(census(&counts(2, 3), None), 0.75));
    assert!(near(census(&counts(0, 0), None), 0.0));
    // Right places count more than wrong counts, and the other way round.
    assert!(near(census(&counts(9, 9), Some(&truth)), 1.0));
    assert!(near(census(&counts(2, 1), Some(&[])), 1.0));
    // A type that nobody lists does not count; one that is claimed and not there does.
    let empty = BTreeMap::new();
    assert!(near(defect_census(&empty, None, &[], PAPER_RADIUS_NM), 1.0));
    assert!(near(count_f1(&counts(1, 0), &empty), 0.0));
    // 5 nm are wide, 0.1 nm are not.
    let guess = [
        defect("vacancy", 3.0, 3.0),
        defect("vacancy", 7.0, 7.0),
        defect("substitution", 7.0, 7.0),
    ];
    assert!(near(spatial_f1(&guess, &truth, PAPER_RADIUS_NM), 1.0));
    assert!(near(spatial_f1(&guess, &truth, STRICT_RADIUS_NM), 0.0));
    // One found place is not a pair with two true ones.
    assert!(near(targeted_f1(&guess[..1], &truth, Some("vacancy"), 50.0), 2.0 / 3.0));
    assert!(near(targeted_f1(&guess, &truth, Some("interstitial"), 5.0), 1.0));
    assert!(near(targeted_f1(&guess, &[], Some("vacancy"), 5.0), 0.0));
}

#[test]
fn nothing_said_of_phases_is_right_where_there_is_one() {
    let (one, two) =
        (Array2::zeros((4, 4)), Array2::from_shape_fn((4, 4), |(i, _)| (i / 2) as i32));
    let phase_iou = |found: Option<&Array2<i32>>, truth| phase_iou(found, truth).unwrap();
    assert!(near(phase_iou(None, &one), 1.0) && near(phase_iou(None, &two), 0.0));
    assert!(near(phase_iou(Some(&two), &two), 1.0));
    // Half of the pixels of one phase, as another: (8 / 16 + 0) / 2.
    assert!(near(phase_iou(Some(&two), &one), 0.25));
    let silent = Array2::from_elem((4, 4), NO_PHASE);
    assert!(near(phase_iou(Some(&silent), &two), 0.0));
    let half =
        Array2::from_shape_fn((4, 4), |(i, j)| if j < 2 { (i / 2) as i32 } else { NO_PHASE });
    assert!(near(phase_iou(Some(&half), &two), 0.5));
    // Where the truth is not known, nothing is right or wrong.
    let part =
        Array2::from_shape_fn((4, 4), |(i, j)| if j < 2 { (i / 2) as i32 } else { NO_PHASE });
    assert!(near(phase_iou(Some(&two), &part), 1.0));
    assert!(stemgen::benchmark::phase_iou(Some(&one), &Array2::zeros((4, 5))).is_err());
}

fn particle(x: f64, diameter_nm: f64, morphology: &str) -> FoundParticle {
    FoundParticle { position_nm: [x, 0.0], diameter_nm, morphology: morphology.into() }
}

#[test]
fn a_census_of_particles_has_three_parts() {
    let truth = [particle(0.0, 4.0, "cube"), particle(20.0, 2.0, "rod")];
    let found =
        [particle(1.0, 3.0, "cube"), particle(21.0, 5.0, "cube"), particle(60.0, 1.0, "rod")];
    let tiles = [[true, true], [true, true], [true, false], [false, false]];
    let score = particle_census(&tiles, &found, &truth, PAPER_RADIUS_NM);
    // Holding: 2 of 3 claimed, 2 there: 0.8; empty: 1 claimed of 2 there: 2/3.
    assert!(near(score.detection, 0.5 * (0.8 + 2.0 / 3.0)));
    // 1 - 1/4, and 1 - 3/2, which is at least 0.
    assert!(near(score.sizing, 0.375));
    // Cube: 2 claimed, 1 there, 1 hit: 2/3; rod: 0.
    assert!(near(score.morphology, 1.0 / 3.0));
    assert!(near(score.total(), 0.5 * score.detection + 0.3 * 0.375 + 0.2 / 3.0));
    // No particle in the tiles that were seen.
    let empty = [[false, false]; 3];
    assert!(near(particle_census(&empty, &[], &[], 5.0).total(), 1.0));
    assert!(near(particle_census(&empty, &found[..1], &[], 5.0).total(), 0.0));
    assert!(near(particle_census(&[[true, false]], &[], &[], 5.0).total(), 0.0));
    // "No particle" everywhere is right in most tiles: 11 of 13, F1 of the empty ones 22 / 24.
    let mut mostly = vec![[false, false]; 11];
    mostly.extend([[false, true]; 2]);
    let score = particle_census(&mostly, &[], &truth, 5.0);
    assert!(near(score.detection, 0.5 * 22.0 / 24.0) && near(score.sizing + score.morphology, 0.0));
}

/// The paper's areas of "no particle": right where there is none, and half of 0.46 where there are some.
#[test]
fn no_particle_has_the_areas_of_the_paper() {
    let area = |score: f64| {
        let mut curve = DoseCurve::default();
        curve.record(0.1, score).unwrap();
        curve.metrics().dec_auc
    };
    let none = particle_census(&[[false, false]; 50], &[], &[], 5.0).total();
    assert!((area(none) - 0.908).abs() < 5e-4);
    let mut tiles = vec![[false, false]; 43];
    tiles.extend([[false, true]; 7]);
    let some = particle_census(&tiles, &[], &[particle(0.0, 3.0, "cube")], 5.0).total();
    assert!((area(some) - 0.21).abs() < 5e-3, "{}", area(some));
}

#[test]
fn columns_of_one_score_count_at_once() {
    let column = |x: f64, score: f64| FoundColumn { position_nm: [x, 0.0], score };
    let truth = [[0.0, 0.0], [1.0, 0.0]];
    let tied = column_score(&[column(5.0, 0.5), column(0.0, 0.5)], &truth, STRICT_RADIUS_NM);
    assert!(
        near(tied.average_precision, 0.25) && near(tied.precision, 0.5) && near(tied.recall, 0.5)
    );
    let nothing = column_score(&[], &[], STRICT_RADIUS_NM);
    assert!(near(nothing.precision + nothing.recall + nothing.average_precision, 3.0));
    // Two claims for one column: one is wrong.
    let twice = column_score(&[column(0.0, 0.9), column(0.02, 0.8)], &truth[..1], STRICT_RADIUS_NM);
    assert!(near(twice.precision, 0.5) && near(twice.average_precision, 1.0));
}
