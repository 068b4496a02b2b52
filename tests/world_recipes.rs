//! Recipes: what is accepted, and what is said of those that are not.
//!
//! A file in `recipes/bad` holds the lines that differ from a built-in recipe (that of SrTiO3, or of the
//! comment `# base:`), first the comment `# expected:` with what the error has to say. `# remove: text` drops
//! lines of the original.

use std::path::Path;

use stemgen::world::{Difficulty, Recipe, specimen};

const GOOD: &str = include_str!("../generate/srtio3.toml");

/// The built-in recipe with the changes of a bad one.
fn changed(changes: &str) -> String {
    let base = changes.lines().find_map(|l| l.strip_prefix("# base: ")).unwrap_or("srtio3");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("generate/{base}.toml"));
    let good = std::fs::read_to_string(path).unwrap();
    let mut text = String::new();
    let removed: Vec<&str> = changes.lines().filter_map(|l| l.strip_prefix("# remove: ")).collect();
    for line in good.lines() {
        if !removed.iter().any(|r| line.starts_with(r)) {
            text += line;
            text += "\n";
        }
        for (head, body) in sections(changes) {
            if line.split('#').next().unwrap().trim() == head {
                text += &body;
            }
        }
    }
    text
}

/// Lines to insert after each header; those without header stand first.
fn sections(changes: &str) -> Vec<(String, String)> {
    let mut out = vec![("version = 1".to_owned(), String::new())];
    for line in changes.lines().filter(|l| !l.starts_with('#')) {
        if line.starts_with('[') {
            out.push((line.trim().to_owned(), String::new()));
        } else if let Some(last) = out.last_mut() {
            last.1 += line;
            last.1 += "\n";
        }
    }
    out
}

#[test]
fn bad_recipes_are_told_what_is_wrong() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recipes/bad");
    let (mut count, mut faults) = (0, Vec::new());
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let changes = std::fs::read_to_string(&path).unwrap();
        let expected: Vec<&str> =
            changes.lines().filter_map(|l| l.strip_prefix("# expected: ")).collect();
        assert!(!expected.is_empty(), "{}: no `# expected:`", path.display());
        let result = Recipe::from_toml_str("bad.toml", &changed(&changes), Some(Difficulty::Easy))
            .and_then(|recipe| specimen(&recipe));
        let message = result.err().map_or("no error".into(), |e| e.to_string());
        for text in expected.iter().filter(|text| !message.contains(**text)) {
            faults.push(format!("{}: {message}\n  expected: {text}", path.display()));
        }
        count += 1;
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count >= 40);
}

/// Rate of the defects of a recipe.
fn rate(recipe: &Recipe) -> f64 {
    let vacancies = recipe.vacancies.as_ref().map(|v| v.rate);
    vacancies.or(recipe.alloy.as_ref().map(|a| a.rate)).unwrap()
}

#[test]
fn tiers_differ_as_in_the_table() {
    let materials: [(&str, [f64; 3], f64, &[(&str, f64)]); 4] = [
        ("SrTiO3", [0.05, 0.03, 0.01], 0.02015, &[("Sr", 0.084), ("Ti", 0.060), ("O", 0.085)]),
        ("batio3", [0.04, 0.03, 0.015], 0.02015, &[("Ba", 0.080), ("Ti", 0.080), ("O", 0.090)]),
        ("sige", [0.05, 0.03, 0.01], 0.02013, &[("Si", 0.078), ("Ge", 0.085)]),
        ("gan", [0.05, 0.03, 0.01], 0.03221, &[("Ga", 0.059), ("N", 0.063), ("In", 0.065)]),
    ];
    for (material, rates, pixel_nm, sigmas) in materials {
        let table = rates.into_iter().zip([(4, 1e4), (8, 5e3), (16, 1e3)]);
        for (difficulty, (expected, (configurations, dose))) in
            Difficulty::ALL.into_iter().zip(table)
        {
            let recipe = Recipe::load(material, difficulty).unwrap();
            assert_eq!(recipe.tier, Some(difficulty));
            assert_eq!(rate(&recipe), expected, "{material}");
            assert_eq!(recipe.phonons.configurations, configurations);
            let given = &recipe.phonons.sigma_angstrom;
            assert!(given.len() == sigmas.len() && sigmas.iter().all(|(e, s)| given[*e] == *s));
            assert_eq!(recipe.dose.electrons_per_angstrom2, dose);
            assert!((recipe.field.pixel_nm() - pixel_nm).abs() < 1e-5);
            assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        }
    }
}

#[test]
fn a_crop_keeps_the_pixel_and_the_centre() {
    let recipe = || Recipe::load("srtio3", Difficulty::Hard).unwrap();
    let full = recipe();
    let crop = recipe().with_grid(3, 4).unwrap();
    assert_eq!(crop.field.pixel_nm(), full.field.pixel_nm());
    assert_eq!(crop.field.built_grid(), [3, 4]);
    assert_eq!(crop.field.crop_origin_px(), [18 * 124, 18 * 124]);
    assert_eq!(crop.field.pixels([3, 4]), [376, 500]);
    assert_eq!(Recipe::from_toml_str("copy", &crop.to_toml(), None).unwrap(), crop);
    assert_eq!(recipe().with_grid(40, 40).unwrap(), full);
    for (rows, columns) in [(0, 1), (41, 1), (1, 41)] {
        let message = recipe().with_grid(rows, columns).unwrap_err().to_string();
        assert!(message.contains("40x40"), "{message}");
    }
}

#[test]
fn an_unknown_material_is_told_the_nearest() {
    let message = Recipe::load("srtoi3", Difficulty::Easy).unwrap_err().to_string();
    assert!(message.contains("did you mean `srtio3`?"), "{message}");
    assert!(
        "heavy".parse::<Difficulty>().unwrap_err().to_string().contains("easy, medium or hard")
    );
}

#[test]
fn a_difficulty_is_asked_for_where_there_are_some() {
    let error = |text: &str, d| Recipe::from_toml_str("r.toml", text, d).unwrap_err().to_string();
    assert!(error(GOOD, None).contains("say which difficulty"));
    let plain = Recipe::load("srtio3", Difficulty::Easy).unwrap().to_toml();
    assert!(error(&plain, Some(Difficulty::Easy)).contains("no [difficulty.easy]"));
}
