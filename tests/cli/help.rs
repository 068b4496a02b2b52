//! `--help` is compared with stored text; `STEMGEN_UPDATE=1 cargo test --test cli` renews it.

use super::{file, stderr, stdout, stemgen};
use std::path::Path;

fn compare(name: &str, arguments: &[&str]) {
    let output = stemgen(Path::new(".")).args(arguments).arg("--help").output().unwrap();
    assert!(output.status.success());
    let trimmed: Vec<String> = stdout(&output).lines().map(|l| l.trim_end().to_owned()).collect();
    let text = trimmed.join("\n") + "\n";
    let path = file(&format!("tests/cli/help/{name}.txt"));
    if std::env::var_os("STEMGEN_UPDATE").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let stored = std::fs::read_to_string(&path).unwrap();
    assert!(text == stored, "{path} differs; STEMGEN_UPDATE=1 renews it. Now:\n{text}");
}

#[test]
fn help_is_as_stored() {
    compare("stemgen", &[]);
    compare("simulate", &["simulate"]);
    compare("patterns", &["patterns"]);
    compare("integrate", &["integrate"]);
    compare("detectability", &["detectability"]);
    compare("rerun", &["rerun"]);
    compare("build", &["build"]);
    compare("specimen", &["specimen"]);
    compare("view", &["view"]);
    compare("tiles", &["tiles"]);
    compare("acquire", &["acquire"]);
    compare("live", &["live"]);
    compare("import", &["import"]);
    compare("audit", &["audit"]);
    compare("regenerate", &["regenerate"]);
    compare("slurm", &["slurm"]);
    compare("cache", &["cache"]);
    compare("cache-list", &["cache", "list"]);
    for action in ["export", "import", "verify", "fill", "clear"] {
        compare(&format!("cache-{action}"), &["cache", action]);
    }
    compare("validate", &["validate"]);
    compare("compare", &["compare"]);
    compare("verify", &["verify"]);
    compare("info", &["info"]);
    compare("card", &["card"]);
    compare("list", &["list"]);
    compare("show-recipe", &["show-recipe"]);
}

/// Terms that help uses and does not define.
#[test]
fn the_glossary_explains_the_terms() {
    let output = stemgen(Path::new(".")).arg("glossary").output().unwrap();
    let text = stdout(&output);
    for term in [
        "Window",
        "Mosaic",
        "Sub-tile",
        "Library",
        "Library cell",
        "Expansion",
        "Tail",
        "Bright columns",
        "Audit",
        "Configuration",
        "Profile",
    ] {
        assert!(text.contains(&format!("**{term}.**")), "{term}");
    }
    for command in ["build", "stemgen"] {
        let help = std::fs::read_to_string(file(&format!("tests/cli/help/{command}.txt"))).unwrap();
        assert!(help.contains("stemgen glossary"), "{command}");
    }
    let mut terms: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("**")).collect();
    let listed = terms.clone();
    terms.sort_by_key(|t| t.split('.').next().unwrap_or_default().to_lowercase());
    assert_eq!(listed, terms, "in the order of the alphabet");
    assert!(!text.contains("sheet"), "the word is library cell");
}

#[test]
fn usage_errors_leave_with_2() {
    let bad: [&[&str]; 6] = [
        &[],
        &["simulat"],
        &["simulate"],
        &["simulate", "si.cif", "--repeat", "3,3"],
        &["simulate", "si.cif", "--phonons", "3"],
        &["build"],
    ];
    for arguments in bad {
        let output = stemgen(Path::new(".")).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!stderr(&output).contains("panicked"));
    }
}
