//! `stemgen detectability`.

use super::{fails, file, json, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

/// A quick question: one layer of MoS2, few configurations, no rings.
fn quick(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.args(["detectability", "mos2", "--difficulty", "easy"]);
    command.args(["--phonons", "4", "--rings", "0", "--step", "0.3"]);
    command
}

#[test]
fn a_recipe_gives_a_table_a_sentence_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plan = json(quick(here).arg("--dry-run"));
    assert_eq!(plan["columns"][0], "S2");
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 0, "a dry run writes nothing");
    let files = ["-o", "a.json", "-o", "a.csv", "-o", "a.svg"];
    let output = quick(here).args(files).output().unwrap();
    let text = stdout(&output);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(
        text.contains("A missing S atom in the middle of 0.6 nm of mos2 (column S2)"),
        "{text}"
    );
    assert!(text.contains("; the recipe gives 1e5."), "{text}");
    let again = quick(here).args(files).output().unwrap();
    assert!(!again.status.success() && stderr(&again).contains("--overwrite"));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(here.join("a.json")).unwrap()).unwrap();
    let printed = json(quick(here).args(["--quiet"]));
    assert_eq!(report["cases"], printed["cases"], "equal bytes in each run");
    let table = std::fs::read_to_string(here.join("a.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 5, "five doses");
    let width = |line: &str| line.split(',').count();
    assert!(table.lines().all(|line| width(line) == 20), "{table}");
    assert!(std::fs::read_to_string(here.join("a.svg")).unwrap().contains("</svg>"));
}

#[test]
fn your_own_atoms_need_their_vibrations() {
    let folder = tempfile::tempdir().unwrap();
    let si = file("structures/si.cif");
    let own = |more: &[&str]| {
        let mut command = stemgen(folder.path());
        command.args(["detectability", &si, "--zone", "1,1,0", "--thickness", "0.4"]);
        command.args(["--phonons", "4", "--rings", "0", "--step", "0.3", "--window", "6"]);
        command.args(more);
        command
    };
    let dopant = ["--defect", "substitution:Si:As@any", "--experiments", "500"];
    let found = json(own(&["--sigma", "0.078"]).args(dopant));
    let result = &found["cases"][0]["detectors"][0];
    assert!(result["contrast_percent"].as_f64().unwrap() > 5.0, "{result}");
    assert!(result["mixture"]["verdict"] == "found", "{result}");
    let message = fails(&mut own(&dopant));
    assert!(message.contains("--sigma"), "{message}");
    let message = fails(&mut own(&["--sigma", "0.078"]));
    assert!(message.contains("--defect vacancy:O@middle"), "{message}");
}

#[test]
fn wrong_options_name_their_remedy() {
    let folder = tempfile::tempdir().unwrap();
    for (options, words) in [
        (vec!["--defect", "vacancy:O"], "only Mo, S"),
        (vec!["--defect", "hole:S"], "substitution:Ti:Nb"),
        (vec!["--column", "Mo"], "columns that hold S are S"),
        (vec!["--power", "1.5"], "--power"),
        (vec!["--averaged", "8"], "expected 32 or more"),
        (vec!["--zone", "1,1,0"], "files of atoms"),
        (vec!["-o", "a.png"], ".svg"),
        (vec!["--accuracy", "1"], "leave both out"),
        (vec!["--dose", "1e6:1e2"], "the higher one"),
    ] {
        let message = fails(quick(folder.path()).args(&options));
        assert!(message.contains(words), "{options:?}: {message}");
    }
    let mut particles = stemgen(folder.path());
    let message = fails(particles.args(["detectability", "pt", "--difficulty", "easy"]));
    assert!(message.contains("crystal along a zone axis"), "{message}");
}
