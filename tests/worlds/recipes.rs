//! Recipes: what is accepted, and what is said of those that are not.
//!
//! A file in `recipes/bad` holds the lines that differ from a built-in recipe (that of SrTiO3, or of the
//! comment `# base:`), first the comment `# expected:` with what the error has to say. `# remove: text` drops
//! lines of the original.

use std::path::Path;

use crate::common::specimen;
use stemgen::recipe::{Difficulty, Recipe, Region};
use stemgen::specimen::SiteKind;
use stemgen::structure::{Atom, Structure, elements, min_pair_distance, shortest_distances};

const GOOD: &str = include_str!("../../generate/srtio3.toml");

/// The built-in recipe with the changes of a bad one.
fn changed(changes: &str) -> String {
    let base = changes.lines().find_map(|l| l.strip_prefix("# base: ")).unwrap_or("srtio3");
    let path =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join(format!("generate/{base}.toml"));
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
fn bad_recipes_are_refused_with_the_fault() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("tests/recipes/bad");
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

/// Name, rates of the tiers, pixel in nm, thermal displacements in Angstrom.
type Material = (&'static str, [f64; 3], f64, &'static [(&'static str, f64)]);

#[test]
fn tiers_differ_as_in_the_table() {
    let materials: [Material; 4] = [
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
fn an_unknown_material_is_refused_with_the_nearest() {
    let message = Recipe::load("srtoi3", Difficulty::Easy).unwrap_err().to_string();
    assert!(message.contains("did you mean `srtio3`?"), "{message}");
    assert!(
        "heavy".parse::<Difficulty>().unwrap_err().to_string().contains("easy, medium or hard")
    );
}

#[test]
fn a_difficulty_is_asked_for_where_there_are_some() {
    let error = |text: &str, d| Recipe::from_toml_str("r.toml", text, d).unwrap_err().to_string();
    assert!(error(GOOD, None).contains("choose a tier; the recipe has easy"));
    let plain = Recipe::load("srtio3", Difficulty::Easy).unwrap().to_toml();
    assert!(error(&plain, Some(Difficulty::Easy)).contains("no [difficulty.easy]"));
}

/// The text of the first block of some language in a Markdown text.
fn block<'t>(markdown: &'t str, language: &str) -> &'t str {
    let start = markdown.split(&format!("```{language}\n")).nth(1).unwrap();
    start.split("```").next().unwrap()
}

#[test]
fn the_recipe_of_the_documentation_needs_only_a_crystal() {
    let text = include_str!("../../generate/README.md");
    let folder = tempfile::tempdir().unwrap();
    let (cif, toml) = (folder.path().join("ceo2.cif"), folder.path().join("ceo2.toml"));
    std::fs::write(&cif, block(text, "cif")).unwrap();
    std::fs::write(&toml, block(text, "toml")).unwrap();
    let recipe = Recipe::from_file(&toml, None).unwrap();
    let ceria = specimen(&recipe).unwrap();
    // The resolved recipe holds the crystal.
    std::fs::remove_file(&cif).unwrap();
    assert_eq!(Recipe::from_toml_str("elsewhere", &recipe.to_toml(), None).unwrap(), recipe);
    let sites = ceria.sites(&recipe.field.full_region());
    let count = |number: u8, kind: SiteKind| {
        sites.iter().filter(|s| s.number == number && s.kind == kind).count() as f64
    };
    let (cerium, gadolinium) = (count(58, SiteKind::Pristine), count(64, SiteKind::Substitution));
    let (oxygen, vacant) = (count(8, SiteKind::Pristine), count(8, SiteKind::Vacancy));
    assert_eq!(sites.len() as f64, cerium + gadolinium + oxygen + vacant);
    let near = |found: f64, expected: f64, n: f64| {
        let error = (expected * (1.0 - expected) / n).sqrt();
        assert!((found - expected).abs() < 3.0 * error, "{found}, expected {expected}");
    };
    near(gadolinium / (cerium + gadolinium), 0.10, cerium + gadolinium);
    near(vacant / (oxygen + vacant), 0.025, oxygen + vacant);
    // Four formula units per cell, but for the little that a boundary costs.
    let field = recipe.field.full_region();
    let volume = (field.x[1] - field.x[0]) * (field.y[1] - field.y[0]) * ceria.facts().thickness_nm;
    let density = (cerium + gadolinium) / volume * 0.54113f64.powi(3) / 4.0;
    assert!((0.99..1.001).contains(&density), "{density}");
    let ratio = (oxygen + vacant) / (cerium + gadolinium);
    assert!((1.98..2.01).contains(&ratio), "{ratio}");
    assert_eq!(ceria.boundaries().len(), 1);
    let atoms = ceria.sites(&Region { x: [24.0, 26.0], y: [10.0, 13.0] }).into_iter();
    let atoms = atoms.map(|s| Atom::new(s.number, s.position_nm.map(|v| 10.0 * v)));
    let cell = [[2000.0, 0.0, 0.0], [0.0, 2000.0, 0.0], [0.0, 0.0, 2000.0]];
    let shortest = shortest_distances(&Structure { cell, atoms: atoms.collect() }, 4.0);
    let least =
        |a: u8, b: u8| shortest.iter().filter(|(p, _)| **p == (a, b)).map(|(_, d)| *d).next();
    assert!(least(8, 58).unwrap() > 0.8 * 2.343 - 1e-3 && least(58, 58).unwrap() > 3.0 - 1e-6);
}

#[test]
fn other_crystals_make_grains() {
    // (crystal, zone axis, y axis, distance of nearest neighbours in Angstrom)
    let cases = [
        ("pt", "[001]", "[010]", 2.774),
        ("pt", "[111]", "[11-2]", 2.774),
        ("si", "[110]", "[1-10]", 2.352),
        ("gan", "[11-20]", "[0001]", 1.95),
        ("gan", "[0001]", "[1-100]", 1.95),
        ("gaas", "[001]", "[110]", 2.448),
    ];
    for (crystal, zone, y, nearest) in cases {
        let text = block(include_str!("../../generate/README.md"), "toml")
            .replace("\"ceo2.cif\"", &format!("\"{crystal}\""))
            .replace("[001]", zone)
            .replace("[010]", y)
            .replace("sigma = 5\n", "")
            .replace("[boundaries.min_distance_angstrom]\nCe-Ce = 3.0\n", "");
        let mut table: toml::Table = toml::from_str(&text).unwrap();
        ["vacancies", "substitutions"].iter().for_each(|t| drop(table.remove(*t)));
        let structure = stemgen::structure::crystals::crystal(crystal).unwrap();
        let symbols = structure.atoms.iter().map(|a| elements::symbol(a.number).to_owned());
        let sigmas: toml::Table = symbols.map(|s| (s, toml::Value::Float(0.07))).collect();
        table["phonons"]["sigma_angstrom"] = toml::Value::Table(sigmas);
        let recipe = Recipe::from_toml_str("r.toml", &table.to_string(), None).unwrap();
        let grains = specimen(&recipe).unwrap_or_else(|e| panic!("{crystal} {zone}: {e}"));
        for x in [10.0, 24.0] {
            let region = Region { x: [x, x + 2.0], y: [8.0, 14.0] };
            let sites = grains.sites(&region);
            let density = sites.len() as f64 / (12.0 * grains.facts().thickness_nm);
            let cell = stemgen::structure::lattice::determinant(&structure.cell) * 1e-3;
            let perfect = structure.atoms.len() as f64 / cell;
            // Two nanometres about a boundary lack a few columns.
            let lost = 1.0 - density / perfect;
            let most = if x < 20.0 { 0.05 } else { 0.12 };
            assert!((-0.05..most).contains(&lost), "{crystal} {zone} at {x}: {lost}");
            let atoms = sites.iter().map(|s| Atom::new(s.number, s.position_nm.map(|v| 10.0 * v)));
            let box_ = [[2000.0, 0.0, 0.0], [0.0, 2000.0, 0.0], [0.0, 0.0, 2000.0]];
            let found =
                min_pair_distance(&Structure { cell: box_, atoms: atoms.collect() }).unwrap();
            let least = if x < 20.0 { 0.99 } else { 0.8 };
            assert!(found > least * nearest - 0.01, "{crystal} {zone} at {x}: {found}");
        }
    }
}

/// Paths of all numbers in a table.
fn numbers(value: &toml::Value, path: &[String], out: &mut Vec<Vec<String>>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let deeper = [path, std::slice::from_ref(key)].concat();
                numbers(value, &deeper, out);
            }
        }
        toml::Value::Integer(_) | toml::Value::Float(_) => out.push(path.to_vec()),
        toml::Value::Array(items) if items.iter().all(|i| !i.is_str()) => out.push(path.to_vec()),
        _ => {}
    }
}

fn entry<'t>(value: &'t mut toml::Value, path: &[String]) -> &'t mut toml::Value {
    path.iter().fold(value, |value, key| value.get_mut(key).unwrap())
}

#[test]
fn no_number_makes_it_panic() {
    let floats = [-1.0, 1e-300, 0.3, 1e9, f64::NAN, f64::INFINITY];
    let integers = [-1, 0, 7, i64::MAX];
    let (mut good, mut bad) = (0, 0);
    for material in ["srtio3", "batio3", "sige", "gan"] {
        let mut small = Recipe::load(material, Difficulty::Medium).unwrap();
        (small.field.fov_nm, small.field.grid) = ([8.0, 8.0], [3, 3]);
        small.field.thickness_nm = 1.0;
        if let Some(wells) = &mut small.wells {
            wells.count = 1;
        }
        if let Some(domains) = &mut small.domains {
            domains.sharpness_sigma_px = 20.0;
        }
        small.clone().checked().unwrap();
        let base: toml::Value = toml::from_str(&small.to_toml()).unwrap();
        let mut paths = Vec::new();
        numbers(&base, &[], &mut paths);
        for path in paths {
            let values = floats.map(toml::Value::Float).into_iter();
            for value in values.chain(integers.map(toml::Value::Integer)) {
                let mut changed = base.clone();
                let target = entry(&mut changed, &path);
                *target = match target {
                    toml::Value::Array(items) => vec![value.clone(); items.len()].into(),
                    _ => value.clone(),
                };
                let text = toml::to_string(&changed).unwrap();
                let made = Recipe::from_toml_str("r.toml", &text, None).and_then(|r| {
                    let region = Region { x: [1.0, 3.0], y: [1.0, 2.0] };
                    Ok(specimen(&r)?.sites(&region.intersection(&r.field.full_region())))
                });
                match made {
                    Ok(sites) => {
                        let finite = |s: &stemgen::specimen::SpecimenSite| {
                            s.position_nm.iter().all(|v| v.is_finite())
                        };
                        assert!(sites.iter().all(finite), "{material} {path:?} = {value}");
                        good += 1;
                    }
                    Err(_) => bad += 1,
                }
            }
        }
    }
    assert!(good > 150 && bad > 500, "{good} {bad}");
}
