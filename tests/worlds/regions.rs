//! What holds for specimens of every kind: seeds, relaxation, and that every region shows the same atoms.

use super::cases::cases;
use std::collections::{HashMap, HashSet};

use crate::common::specimen;
use crate::specimens::{CASES, assert_rate, number};
use proptest::prelude::*;
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::{SiteKind, SpecimenSite};

const TI: u8 = 22;
const GA: u8 = 31;

#[test]
fn seeds_change_atoms_but_not_statistics() {
    for material in ["srtio3", "batio3", "sige", "gan"] {
        let base = Recipe::load(material, Difficulty::Easy).unwrap();
        let field = base.field.full_region();
        let strip = Region { x: field.x, y: [30.0, 40.0] };
        let of = |seed: u64| {
            let recipe = Recipe { seed, ..base.clone() };
            let sites = specimen(&recipe).unwrap().sites(&strip);
            let defects: HashSet<u64> =
                sites.iter().filter(|s| s.kind != SiteKind::Pristine).map(|s| s.key).collect();
            (sites.len() as f64, defects)
        };
        let (first, second) = (of(1), of(2));
        assert!((first.0 / second.0 - 1.0).abs() < 0.02, "{material}");
        let (a, b) = (first.1.len() as f64, second.1.len() as f64);
        assert!((a - b).abs() < 5.0 * (a + b).sqrt(), "{material}: {a} {b}");
        let common = first.1.intersection(&second.1).count() as f64;
        assert!(common < 0.3 * a, "{material}: {common} of {a}");
        assert_eq!(of(1).1, first.1);
    }
}

#[test]
fn vacancies_and_relaxation_work_in_every_kind_of_specimen() {
    for (material, element) in [("batio3", "O"), ("gan", "N"), ("sige", "Si")] {
        let mut recipe = Recipe::load(material, Difficulty::Easy).unwrap();
        recipe.vacancies = Some(stemgen::recipe::Vacancies {
            element: element.into(),
            rate: 0.05,
            cluster_fraction: 0.0,
            cluster_sigma_nm: 5.0,
            clusters: 0,
            max_probability: 0.25,
            relaxation_angstrom: 0.0,
        });
        let region = Region { x: [36.0, 42.0], y: [30.0, 36.0] };
        let rigid = specimen(&recipe).unwrap().sites(&region);
        let sites = rigid.iter().filter(|s| s.number == number(element)).count() as u64;
        let vacant = rigid.iter().filter(|s| s.kind == SiteKind::Vacancy).count() as u64;
        assert!(rigid.iter().all(|s| s.kind != SiteKind::Vacancy || s.number == number(element)));
        if material != "sige" {
            assert_rate([sites, vacant], 0.05, 4.0, material);
        }
        recipe.vacancies.as_mut().unwrap().relaxation_angstrom = 0.1;
        let relaxed = specimen(&recipe).unwrap().sites(&region);
        let moved = rigid.iter().zip(&relaxed).filter(|(a, b)| a.position_nm != b.position_nm);
        let moved: Vec<_> = moved.map(|(a, _)| a).collect();
        // Ti has 6 O beside it, Ga 4 N; Si only has Ge to move.
        assert!(moved.iter().all(|s| s.number != number(element)), "{material}");
        let bonded = if material == "batio3" { TI } else { GA };
        let share = moved.iter().filter(|s| s.number == bonded).count() as f64
            / rigid.iter().filter(|s| s.number == bonded).count() as f64;
        let expected = match material {
            "batio3" => 1.0 - 0.95f64.powi(6),
            "gan" => 1.0 - 0.95f64.powi(4),
            _ => continue,
        };
        assert!((share - expected).abs() < 0.03, "{material}: {share} {expected}");
    }
}

proptest! {
    #![proptest_config(cases(60))]
    /// A region shows the same sites as the two halves that it falls into, and no key twice.
    #[test]
    fn regions_agree(
        which in 0usize..9,
        x in -15.0f64..110.0,
        y in -15.0f64..110.0,
        w in 0.1f64..4.0,
        h in 0.1f64..4.0,
        cut in 0.0f64..1.0,
        vertical in any::<bool>(),
    ) {
        let material = ["batio3", "sige", "gan"][which / 3];
        let specimen = &CASES[&(material, Difficulty::ALL[which % 3])].specimen;
        let whole = Region { x: [x, x + w], y: [y, y + h] };
        let (mut first, mut second) = (whole, whole);
        if vertical {
            (first.x[1], second.x[0]) = (x + cut * w, x + cut * w);
        } else {
            (first.y[1], second.y[0]) = (y + cut * h, y + cut * h);
        }
        let all = specimen.sites(&whole);
        let mut parts = specimen.sites(&first);
        parts.extend(specimen.sites(&second));
        let by_key = |sites: &[SpecimenSite]| -> HashMap<u64, (u8, [u64; 3])> {
            sites.iter().map(|s| (s.key, (s.number, s.position_nm.map(f64::to_bits)))).collect()
        };
        prop_assert_eq!(all.len(), parts.len());
        prop_assert_eq!(by_key(&all).len(), all.len());
        prop_assert_eq!(by_key(&all), by_key(&parts));
    }
}
