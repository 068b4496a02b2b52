//! `stemgen list`, `stemgen show-recipe`, and options that change a recipe.

use super::{fails, file, json, stderr, stdout, stemgen};
use stemgen::io::WorldFile;
use stemgen::recipe::{Difficulty, Recipe};

#[test]
fn the_list_holds_every_recipe_and_tier() {
    let here = std::env::temp_dir();
    let rows = json(stemgen(&here).arg("list"));
    let rows = rows.as_array().unwrap();
    let tiers = |name| Recipe::tiers(name).unwrap().len().max(1);
    assert_eq!(rows.len(), Recipe::built_in().map(tiers).sum::<usize>());
    let medium = &rows[1];
    assert_eq!((&medium["recipe"], &medium["difficulty"]), (&"srtio3".into(), &"medium".into()));
    assert_eq!(medium["rates"][0]["rate"], 0.03);
    assert_eq!(medium["phonon_configurations"], 8);
    assert_eq!(medium["sites_counted"], false);
    // 25.6 cells a side of 100 nm, each of 5 atoms, 26 cells thick.
    let expected = 5.0 * 26.0 * (1000.0 / 3.905_f64).powi(2);
    let sites = medium["sites"].as_f64().unwrap();
    assert!((sites / expected - 1.0).abs() < 0.02, "{sites}, expected {expected}");
    let text = stdout(&stemgen(&here).arg("list").output().unwrap());
    assert_eq!(text.lines().count(), rows.len() + 1);
    assert!(text.contains("O vacancies 5.0 %") && text.contains("0.02015"), "{text}");
    let printed = fails(stemgen(&here).args(["list", "srtoi3"]));
    assert!(printed.contains("did you mean `srtio3`"), "{printed}");
}

#[test]
fn files_of_recipes_stand_where_names_do() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(file("generate/srtio3.toml"), folder.path().join("mine.toml")).unwrap();
    let run = |arguments: &[&str]| json(stemgen(folder.path()).args(arguments));
    let rows = run(&["list", "mine.toml"]);
    assert_eq!(rows.as_array().unwrap().len(), 3);
    let tier = ["--difficulty", "easy", "--grid", "1x1"];
    let written = run(&[&["specimen", "mine.toml"], &tier[..]].concat());
    assert_eq!(written["output"], "srtio3_easy_1x1.extxyz");
    assert!(written["defects"]["vacancy"].as_u64().unwrap_or(1) > 0, "{written}");
    let clean = [&["specimen", "mine.toml", "--unset", "vacancies", "--seed", "3"], &tier[..]];
    let clean = run(&clean.concat());
    assert_eq!(clean["output"], "srtio3_easy_1x1_seed3.extxyz");
    assert_eq!(clean["defects"], serde_json::json!({}));
}

/// Atoms of one's own: planned, listed, written and drawn without a recipe; what does not fit is told.
#[test]
fn files_of_atoms_stand_where_recipes_do() {
    let folder = tempfile::tempdir().unwrap();
    let head =
        "Lattice=\"12 0 0 0 12 0 0 0 9\" Properties=species:S:1:pos:R:3:occupancy:R:1:defect:S:1";
    let rows = "Au 2 2 2 1 none\nAu 2 2 5 1 none\nAg 6 6 2 1 substitution_Ag\nX 9 9 2 0 vacancy_Au";
    let text = format!("4\n{head}\n{rows}\n");
    let write = |text: &str| std::fs::write(folder.path().join("own.xyz"), text).unwrap();
    write(&text);
    let run = |arguments: &[&str]| json(stemgen(folder.path()).args(arguments));
    let written = run(&["specimen", "own.xyz"]);
    assert_eq!(written["output"], "own.extxyz");
    assert_eq!((&written["sites"], &written["columns"]), (&4.into(), &3.into()));
    assert_eq!(written["defects"], serde_json::json!({"substitution_Ag": 1, "vacancy_Au": 1}));
    let planned = stemgen(folder.path()).args(["build", "own.xyz", "--dry-run"]).output().unwrap();
    assert!(planned.status.success() && stderr(&planned).contains("no atom vibrates"));
    assert_eq!(run(&["list", "own.xyz"]).as_array().unwrap().len(), 1);
    let shown = stemgen(folder.path()).args(["show-recipe", "own.xyz"]).output().unwrap();
    std::fs::write(folder.path().join("own.toml"), &shown.stdout).unwrap();
    let again = run(&["specimen", "own.toml", "-o", "again.extxyz"]);
    assert_eq!((&again["sites"], &again["atoms"]), (&4.into(), &written["atoms"]));
    let printed = fails(stemgen(folder.path()).args(["build", "own.xyz", "--difficulty", "easy"]));
    assert!(printed.contains("a file of atoms has no tiers"), "{printed}");
    write(&text.replace("vacancy_Au", "hole"));
    let printed = fails(stemgen(folder.path()).args(["build", "own.xyz"]));
    assert!(printed.contains("own.xyz:6: defect is `hole`"), "{printed}");
    let printed = fails(stemgen(folder.path()).args(["build", "own.toml"]));
    assert!(printed.contains("own.xyz has changed since the recipe was resolved"), "{printed}");
}

#[test]
fn counted_sites_are_those_that_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let rows = json(stemgen(folder.path()).args(["list", "test", "--count"]));
    let written = json(stemgen(folder.path()).args(["specimen", "test"]));
    assert_eq!(rows[0]["sites"], written["sites"]);
    assert_eq!(
        (&rows[0]["sites_counted"], &written["output"]),
        (&true.into(), &"test.extxyz".into())
    );
}

#[test]
fn a_shown_recipe_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let show = |arguments: &[&str]| {
        let run = stemgen(folder.path()).arg("show-recipe").args(arguments).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        stdout(&run)
    };
    let easy = show(&["srtio3", "--difficulty", "easy"]);
    let recipe = Recipe::from_toml_str("shown", &easy, None).unwrap();
    assert_eq!(recipe, Recipe::load("srtio3", Difficulty::Easy).unwrap());
    let changes = ["--set", "vacancies.rate=0.02", "--seed", "9", "--grid", "2x3"];
    let changed = show(&[&["srtio3", "--difficulty", "easy"], &changes[..]].concat());
    std::fs::write(folder.path().join("mine.toml"), &changed).unwrap();
    assert_eq!(show(&["--recipe", "mine.toml"]), changed);
    let recipe = Recipe::from_toml_str("shown", &changed, None).unwrap();
    assert_eq!((recipe.vacancies.unwrap().rate, recipe.seed), (0.02, 9));
    assert_eq!(recipe.field.built_grid(), [2, 3]);
    assert!(show(&["replay"]).contains("source = \"synthetic_replay\""));
}

#[test]
fn all_commands_tell_the_same_about_a_bad_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let easy = ["srtio3", "--difficulty", "easy"];
    let cases: [(&[&str], &[&str]); 6] = [
        (&["--set", "vacancies.rat=0.1"], &["--set vacancies.rat=0.1", "did you mean `rate`?"]),
        (&["--set", "vacancies.rate=1.5"], &["vacancies.rate = 1.5", "0.25"]),
        (
            &["--set", "seed=4", "--set", "boundaries.count=x"],
            &["boundaries.count=x", "whole number"],
        ),
        (&["--set", "vacancies.element=N"], &["vacancies.element"]),
        (&["--set", "seed"], &["key=value"]),
        (&["--grid", "41x1"], &["40x40"]),
    ];
    for (arguments, parts) in cases {
        for subcommand in ["build", "specimen", "show-recipe"] {
            let mut command = stemgen(folder.path());
            let printed = fails(command.arg(subcommand).args(easy).args(arguments));
            for part in parts {
                assert!(
                    printed.contains(part),
                    "{subcommand} {arguments:?}: no `{part}` in\n{printed}"
                );
            }
        }
    }
    for (key, part) in
        [("seed", "missing field `seed`"), ("vacancies.rat", "does not contain this key")]
    {
        let mut command = stemgen(folder.path());
        let printed = fails(command.args(["build"]).args(easy).args(["--unset", key]));
        assert!(
            printed.contains(&format!("--unset {key}: ")) && printed.contains(part),
            "{printed}"
        );
    }
    for (arguments, part) in
        [(&["srtio3"][..], "--difficulty"), (&["replay", "--difficulty", "easy"], "no difficulty")]
    {
        let printed = fails(stemgen(folder.path()).arg("build").args(arguments));
        assert!(printed.contains(part), "{arguments:?}: {printed}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing was begun");
}

#[test]
fn the_file_holds_the_changed_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--quiet", "-o", "w.h5"]);
    command.args(["--set", "dose.electrons_per_angstrom2=777", "--set", "source=mine"]);
    assert!(command.status().unwrap().success());
    let world = WorldFile::open(&folder.path().join("w.h5")).unwrap();
    let text = world.metadata().recipe.clone().unwrap();
    let recipe = Recipe::from_toml_str("w.h5", &text, None).unwrap();
    assert_eq!(recipe.dose.electrons_per_angstrom2, 777.0);
    assert_eq!(world.metadata().dose_electrons_per_angstrom2, Some(777.0));
    assert_eq!(world.metadata().source.as_deref(), Some("mine"));
}
