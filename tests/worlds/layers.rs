//! Layers of one unit cell: MoS2, WSe2 and graphene, with several kinds of defects and coincidence boundaries of hexagonal lattices.

use std::collections::BTreeMap;

use crate::common::specimen;
use crate::specimens::{assert_rate, number};
use stemgen::recipe::{Difficulty, PointDefect, Recipe, Region};
use stemgen::specimen::{Boundary, BoundaryKind, SiteKind, SpecimenSite};

const TIERS: [Difficulty; 3] = [Difficulty::Easy, Difficulty::Medium, Difficulty::Hard];

/// Defects of a kind and sites of the element, both of the full field.
fn counted(sites: &[SpecimenSite], recipe: &Recipe, defect: &PointDefect) -> [u64; 2] {
    let host = number(&defect.element);
    let by = defect.by.as_deref().map(number);
    let guests: Vec<u8> = recipe
        .defects
        .iter()
        .filter(|d| d.element == defect.element)
        .filter_map(|d| d.by.as_deref().map(number))
        .collect();
    let belongs = |s: &&SpecimenSite| match s.kind {
        SiteKind::Substitution => guests.contains(&s.number),
        _ => s.number == host,
    };
    let is = |s: &&SpecimenSite| match by {
        Some(by) => s.kind == SiteKind::Substitution && s.number == by,
        None => s.kind == SiteKind::Vacancy && s.number == host,
    };
    let all = sites.iter().filter(belongs);
    [all.clone().count() as u64, all.filter(is).count() as u64]
}

#[test]
fn layers_have_the_rates_of_their_recipes() {
    for material in ["mos2", "wse2", "graphene"] {
        for tier in TIERS {
            let recipe = Recipe::load(material, tier).unwrap();
            let sites = specimen(&recipe).unwrap().sites(&recipe.field.full_region());
            assert!(sites.len() > 300_000, "{material}: {}", sites.len());
            let vacancies = recipe.vacancies.as_ref().unwrap();
            let first =
                PointDefect { element: vacancies.element.clone(), by: None, rate: vacancies.rate };
            for defect in recipe.defects.iter().chain([&first]) {
                // Where two kinds are drawn for a site, the first of the recipe counts.
                let others = recipe.defects.iter().chain([&first]);
                let before: f64 = others
                    .filter(|d| d.element == defect.element && *d != defect)
                    .map(|d| d.rate)
                    .sum();
                let [all, found] = counted(&sites, &recipe, defect);
                let what = format!("{material} {tier:?} {defect:?}");
                let expected = defect.rate;
                let slack = 5.0 * (expected / all as f64).sqrt() + expected * before;
                let rate = found as f64 / all as f64;
                assert!((rate - expected).abs() < slack, "{what}: {rate}");
            }
        }
    }
}

#[test]
fn defects_of_several_kinds_meet_as_often_as_chance_has_it() {
    let mut recipe = Recipe::load("mos2", Difficulty::Easy).unwrap();
    recipe.boundaries.as_mut().unwrap().count = 0;
    recipe.vacancies.as_mut().unwrap().rate = 0.1;
    let rates = [("S", None, 0.1), ("S", Some("Se"), 0.2), ("Mo", Some("W"), 0.3)];
    recipe.defects = rates[1..]
        .iter()
        .map(|(element, by, rate)| PointDefect {
            element: (*element).into(),
            by: by.map(str::to_owned),
            rate: *rate,
        })
        .collect();
    for element in ["Se", "W"] {
        recipe.phonons.sigma_angstrom.insert(element.into(), 0.06);
    }
    let all = specimen(&recipe).unwrap().query(&Region { x: [20.0, 60.0], y: [20.0, 60.0] });
    let mut contents = BTreeMap::<(usize, usize), u64>::new();
    let mut columns = 0;
    for column in &all.columns {
        let sites = &all.sites[column.sites.clone()];
        if sites.len() == 2 {
            let of = |kind| sites.iter().filter(|s| s.kind == kind).count();
            *contents.entry((of(SiteKind::Vacancy), of(SiteKind::Substitution))).or_default() += 1;
            columns += 1;
            // The library has no columns of two kinds.
            let mixed = of(SiteKind::Vacancy) == 1 && of(SiteKind::Substitution) == 1;
            assert!(!mixed || column.unit.is_none());
        }
    }
    let (vacant, replaced) = (0.1, 0.9 * 0.2);
    let whole = 1.0 - vacant - replaced;
    let expected = [
        ((0, 0), whole * whole),
        ((1, 0), 2.0 * vacant * whole),
        ((2, 0), vacant * vacant),
        ((0, 1), 2.0 * replaced * whole),
        ((0, 2), replaced * replaced),
        ((1, 1), 2.0 * vacant * replaced),
    ];
    for (what, rate) in expected {
        let found = contents.get(&what).copied().unwrap_or(0);
        assert_rate([columns, found], rate, 5.0, &format!("{what:?} of {columns}"));
    }
    let metal = PointDefect { element: "Mo".into(), by: Some("W".into()), rate: 0.3 };
    assert_rate(counted(&all.sites, &recipe, &metal), 0.3, 5.0, "W on Mo");
}

#[test]
fn hexagonal_cells_are_not_strained() {
    for (material, a, heavy) in [("mos2", 3.1602, "Mo"), ("wse2", 3.282, "W")] {
        let recipe = Recipe::load(material, Difficulty::Hard).unwrap();
        let made = specimen(&recipe).unwrap();
        let lines: Vec<f64> = made.boundaries().iter().map(|b| b.line_nm[0][0]).collect();
        let sites = made.sites(&Region { x: [28.0, 48.0], y: [30.0, 34.0] });
        let metal = number(heavy);
        let inside: Vec<[f64; 3]> = sites
            .iter()
            .filter(|s| s.number == metal && s.kind != SiteKind::Substitution)
            .map(|s| s.position_nm)
            .filter(|p| lines.iter().all(|x| (p[0] - x).abs() > 1.0))
            .collect();
        let mut neighbours = 0;
        for (n, p) in inside.iter().enumerate() {
            for q in &inside[..n] {
                let apart = 10.0 * ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sqrt();
                if apart < 1.3 * a {
                    assert!((apart - a).abs() < 1e-6, "{material}: {apart}");
                    neighbours += 1;
                }
            }
        }
        assert!(neighbours > 2 * inside.len(), "{neighbours} of {}", inside.len());
    }
}

/// Of a coincidence boundary all columns repeat, so that the library shows them; those with two kinds of defects have no like.
#[test]
fn boundaries_of_layers_are_in_the_library() {
    for material in ["mos2", "wse2", "graphene"] {
        for tier in TIERS {
            let recipe = Recipe::load(material, tier).unwrap();
            let made = specimen(&recipe).unwrap();
            let boundaries = made.boundaries();
            let expected = recipe.boundaries.as_ref().unwrap();
            assert_eq!(boundaries.len(), expected.count);
            for Boundary { line_nm, kind } in boundaries {
                let BoundaryKind::Grain { misorientation_deg, sigma } = kind else {
                    panic!("{kind:?}")
                };
                assert!((misorientation_deg - expected.misorientation_deg).abs() < 0.01);
                assert_eq!(sigma, expected.sigma);
                let x = line_nm[0][0];
                let near = made.query(&Region { x: [x - 0.6, x + 0.6], y: [20.0, 80.0] });
                let unlike = near.columns.iter().filter(|c| c.unit.is_none());
                let mixed = |sites: &[SpecimenSite]| {
                    let kinds = sites.iter().filter(|s| s.kind != SiteKind::Pristine);
                    kinds.count() >= 2
                };
                let lone = unlike.filter(|c| !mixed(&near.sites[c.sites.clone()])).count();
                // A content that a small pool lacks is seldom.
                let all = near.columns.len();
                assert!(lone * 200 < all, "{material} {tier:?}: {lone} of {all}");
            }
        }
    }
}

#[test]
fn wrong_defects_are_refused() {
    let base = Recipe::load("mos2", Difficulty::Easy).unwrap();
    let refused = |change: &dyn Fn(&mut Recipe)| {
        let mut recipe = base.clone();
        change(&mut recipe);
        recipe.checked().unwrap_err().to_string()
    };
    let defect = |element: &str, by: Option<&str>, rate: f64| PointDefect {
        element: element.into(),
        by: by.map(str::to_owned),
        rate,
    };
    let message = refused(&|r| r.defects = vec![defect("O", None, 0.1)]);
    assert!(message.contains("defects.element") && message.contains("S, Mo"), "{message}");
    let message = refused(&|r| r.defects = vec![defect("S", Some("S"), 0.1)]);
    assert!(message.contains("defects.by"), "{message}");
    let message = refused(&|r| r.defects = vec![defect("S", None, 1.5)]);
    assert!(message.contains("defects.rate"), "{message}");
    let message = refused(&|r| r.defects = vec![defect("Mo", None, 0.1), defect("Mo", None, 0.2)]);
    assert!(message.contains("a different kind of defect"), "{message}");
    let message = refused(&|r| r.boundaries.as_mut().unwrap().misorientation_deg = 25.0);
    assert!(message.contains("21.79") && message.contains("38.21"), "{message}");
    let mut strontium = Recipe::load("batio3", Difficulty::Easy).unwrap();
    strontium.defects = vec![defect("O", None, 0.01)];
    let message = strontium.checked().unwrap_err().to_string();
    assert!(message.contains("defects") && message.contains("grains"), "{message}");
}
