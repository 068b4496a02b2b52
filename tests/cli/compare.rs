//! `stemgen compare`.

use super::{fails, file, json, stderr, stdout, stemgen};
use serde_json::Value;
use std::path::Path;
use stemgen::validate::worlds::DEFAULT_ALPHA;

const VACANCIES: &str = "vacancies={element=\"O\", rate=0.2, cluster_fraction=0.0, \
                         cluster_sigma_nm=1.0, max_probability=0.9}";
/// 3 x 3 tiles of 64 px, 3.6 nm wide, 0.8 nm thick.
const FIELD: [&str; 8] = [
    "--set",
    "field.fov_nm=[3.6, 3.6]",
    "--set",
    "field.grid=[3, 3]",
    "--set",
    "field.tile_px=64",
    "--set",
    "dose.electrons_per_angstrom2=2e5",
];

fn build(folder: &Path, name: &str, changes: &[&str]) {
    build_from(folder, &file("tests/cli/tiny.toml"), name, changes);
}

fn build_from(folder: &Path, recipe: &str, name: &str, changes: &[&str]) {
    let mut command = stemgen(folder);
    command.args(["build", "--recipe", recipe, "--set", VACANCIES]).args(FIELD);
    for change in changes {
        command.args(["--set", change]);
    }
    let run = command.args(["-o", name, "--no-png", "--quiet"]).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
}

/// Exit code and verdicts by property.
fn compare(folder: &Path, other: &str) -> (i32, Vec<(String, String)>) {
    let mut command = stemgen(folder);
    command.args(["compare", "a.h5", other, "--json", "--overwrite"]);
    let run = command.output().unwrap();
    let report: Value =
        serde_json::from_str(&stdout(&run)).unwrap_or_else(|_| panic!("{}", stderr(&run)));
    let text = |v: &Value| v.as_str().unwrap().to_owned();
    let lines = report["lines"].as_array().unwrap();
    println!("{other}: {lines:#?}");
    let lines = lines.iter().map(|l| (text(&l["what"]), text(&l["verdict"]))).collect();
    (run.status.code().unwrap(), lines)
}

fn of<'a>(lines: &'a [(String, String)], verdict: &str) -> Vec<&'a str> {
    lines.iter().filter(|l| l.1 == verdict).map(|l| l.0.as_str()).collect()
}

#[test]
fn worlds_are_the_same_or_different() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    build(f, "a.h5", &[]);
    build(f, "seed.h5", &["seed=77"]);
    build(f, "dose.h5", &["seed=3", "dose.electrons_per_angstrom2=1e5"]);
    build(f, "rate.h5", &["seed=4", "vacancies.rate=0.5"]);
    let tiny = std::fs::read_to_string(file("tests/cli/tiny.toml")).unwrap();
    let other = tiny.replace("\"srtio3\"", "\"batio3_cubic\"");
    let other =
        other.replace("Sr = 0.084, Ti = 0.060, O = 0.085", "Ba = 0.08, Ti = 0.08, O = 0.09");
    std::fs::write(f.join("other.toml"), other).unwrap();
    build_from(f, "other.toml", "material.h5", &["seed=5"]);

    let (code, lines) = compare(f, "a.h5");
    assert!(code == 0 && of(&lines, "different").is_empty(), "{lines:?}");
    let (code, lines) = compare(f, "seed.h5");
    assert!(code == 0 && of(&lines, "different").is_empty(), "{lines:?}");
    assert!(of(&lines, "undecided").is_empty(), "{lines:?}");
    let (code, lines) = compare(f, "dose.h5");
    let different = of(&lines, "different");
    assert!(code == 3 && different.contains(&"dose estimated from the noise"), "{lines:?}");
    for same in [
        "vacancy_O per site",
        "nearest neighbours of columns",
        "sites",
        "elements",
        "mean of the image",
    ] {
        assert!(of(&lines, "same").contains(&same), "{same}: {lines:?}");
    }
    let (code, lines) = compare(f, "rate.h5");
    assert!(code == 3 && of(&lines, "different").contains(&"vacancy_O per site"), "{lines:?}");
    assert!(of(&lines, "same").contains(&"dose estimated from the noise"), "{lines:?}");
    let (code, lines) = compare(f, "material.h5");
    let different = of(&lines, "different");
    for property in
        ["elements", "nearest neighbours of columns", "intensity of columns", "mean of the image"]
    {
        assert!(code == 3 && different.contains(&property), "{property}: {lines:?}");
    }
    let page = std::fs::read_to_string(f.join("compare.html")).unwrap();
    for part in ["<svg", "data:image/png;base64,", "Power spectrum", "different", "1/nm"] {
        assert!(page.contains(part), "no `{part}`");
    }

    // the dose is measured, not read: 2e5 electrons per square Angstrom
    let report = json(stemgen(f).args(["compare", "a.h5", "seed.h5", "-o", "again.html"]));
    let dose = report["lines"]
        .as_array()
        .unwrap()
        .iter()
        .find(|l| l["unit"] == "electrons per A2")
        .unwrap();
    let (value, error) =
        (dose["a"]["value"].as_f64().unwrap(), dose["a"]["error"].as_f64().unwrap());
    assert!((value - 2e5).abs() < 4.0 * error && error < 0.1 * value, "{dose}");
    assert_eq!(report["alpha"].as_f64().unwrap(), DEFAULT_ALPHA);
}

#[test]
fn what_is_no_world_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let f = folder.path();
    std::fs::write(f.join("text.h5"), "no world").unwrap();
    let structure = file("tests/references/srtio3.xyz");
    let simulate = ["simulate", &structure, "-o", "image.h5", "--scan-points", "1,1", "--quiet"];
    assert!(stemgen(f).args(simulate).status().unwrap().success());
    for (name, expected) in
        [("text.h5", "not HDF5"), ("image.h5", "is not a world"), ("none.h5", "cannot read")]
    {
        let printed = fails(stemgen(f).args(["compare", name, name]));
        assert!(printed.contains(name) && printed.contains(expected), "{printed}");
    }
    assert!(!f.join("compare.html").exists());
}
