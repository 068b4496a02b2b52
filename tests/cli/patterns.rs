//! `stemgen patterns`, and `stemgen integrate`, which makes images of them.

use super::{fails, file, json, python, stemgen};
use std::path::Path;

/// A small scan of silicon, whose patterns take a second.
const SMALL: &[&str] = &[
    "--repeat",
    "4,4,2",
    "--scan-start",
    "8,8",
    "--scan-end",
    "10,9.5",
    "--scan-points",
    "4,3",
    "--pixels",
    "24",
    "--max-angle",
    "50",
];

fn silicon(folder: &Path) {
    std::fs::copy(file("structures/si.cif"), folder.join("si.cif")).unwrap();
}

fn done(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    json(stemgen(folder).args(arguments))
}

#[test]
fn patterns_are_written_for_other_programs_and_make_images() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let made = done(here, &[&["patterns", "si.cif"], SMALL, &["--png", "--threads", "1"]].concat());
    assert_eq!(
        (made["files"][0]["rows"].as_u64(), made["files"][0]["pixels"].as_u64()),
        (Some(3), Some(24))
    );
    let share = made["files"][0]["mean_sum"].as_f64().unwrap();
    assert!(share > 0.9 && share < 1.0, "{share}");
    assert!(here.join("si_mean.png").exists());
    let held = python("check_patterns.py", &[&here.join("si.emd")]);
    assert!(held.starts_with("float32 3 4 24 24") && held.trim_end().ends_with("10.86"), "{held}");
    // The same numbers on other threads.
    done(here, &[&["patterns", "si.cif"], SMALL, &["-o", "two.emd", "--threads", "2"]].concat());
    let values = |name: &str| {
        let all = python("digest.py", &[&here.join(name)]);
        let line = all.lines().find(|line| line.contains("datacube/data")).map(str::to_owned);
        line.unwrap_or_else(|| panic!("{all}"))
    };
    assert_eq!(values("si.emd"), values("two.emd"));
    let images = done(
        here,
        &[
            "integrate",
            "si.emd",
            "--annulus",
            "ABF=10-21",
            "--sectors",
            "DPC=0-21:4@45",
            "--com",
            "--icom",
            "--png",
            "--tiff",
            "32",
        ],
    );
    let names: Vec<&str> =
        images["images"].as_array().unwrap().iter().filter_map(|i| i["name"].as_str()).collect();
    assert_eq!(names, ["ABF", "DPC_0", "DPC_1", "DPC_2", "DPC_3", "com_x", "com_y", "icom"]);
    for name in names {
        assert!(here.join(format!("si_images_{name}.png")).exists(), "{name}");
        assert!(here.join(format!("si_images_{name}.tif")).exists(), "{name}");
    }
    let all = python("digest.py", &[&here.join("si_images.h5")]);
    assert!(all.contains("images/icom (1, 3, 4)"), "{all}");
}

#[test]
fn electrons_are_counted_at_every_thickness_and_defocus() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let more =
        ["--dose", "1e4", "--thicknesses", "5.4,10.8", "--defocus", "0:40:40", "-o", "s.emd"];
    let made = done(here, &[&["patterns", "si.cif"], SMALL, &more].concat());
    assert_eq!(made["files"].as_array().unwrap().len(), 4);
    let mut sums = Vec::new();
    for name in [
        "s_defocus_0A_5.4A.emd",
        "s_defocus_0A_10.9A.emd",
        "s_defocus_40A_5.4A.emd",
        "s_defocus_40A_10.9A.emd",
    ] {
        let held = python("check_patterns.py", &[&here.join(name)]);
        assert!(held.starts_with("uint32 3 4 24 24"), "{name}: {held}");
        // 0.25 A^2 for each probe.
        let mean: f64 = held.split_whitespace().nth(5).unwrap().parse().unwrap();
        assert!(mean > 2200.0 && mean < 2550.0, "{name}: {held}");
        sums.push(held);
    }
    sums.dedup();
    assert_eq!(sums.len(), 4, "each has draws of its own: {sums:?}");
    let images = done(here, &["integrate", "s_defocus_40A_5.4A.emd", "--annulus", "BF=0-21"]);
    assert_eq!(images["images"][0]["units"], "electrons");
}

#[test]
fn a_plan_says_what_patterns_take() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let wide = ["--repeat", "8,8,4", "--pixels", "128", "--dry-run"];
    let plan = done(here, &[&["patterns", "si.cif"], &wide[..]].concat());
    assert_eq!(plan["algorithm"]["name"], "window");
    let probes = plan["scan"][0].as_u64().unwrap() * plan["scan"][1].as_u64().unwrap();
    assert_eq!(plan["file_bytes"].as_u64(), Some(probes * 128 * 128 * 4));
    assert!(plan["memory_bytes"].as_u64() > Some(1 << 20));
    assert!(!here.join("si.emd").exists());
}

#[test]
fn mistakes_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    silicon(here);
    let refused = |arguments: &[&str], words: &str| {
        let told = fails(stemgen(here).args(arguments));
        assert!(told.contains(words), "{arguments:?}: {told}");
    };
    let patterns = |more: &[&str], words: &str| {
        refused(&[&["patterns", "si.cif"], SMALL, more].concat(), words);
    };
    patterns(&["-o", "x.h5"], "did you mean x.emd?");
    patterns(&["--detector", "HAADF=68-200"], "stemgen integrate");
    patterns(&["--source-size", "0.8"], "blurs images");
    patterns(&["--accuracy", "1"], "give the window of patterns by its width");
    patterns(&["--engine", "prism"], "PRISM");
    patterns(&["--sampling", "0.4"], "--sampling");
    refused(&["patterns", "si.cif", "--pixels", "1"], "2 to 4096");
    let large = ["--repeat", "40,40,1", "--pixels", "4096", "--scan-step", "0.01"];
    refused(&[&["patterns", "si.cif"], &large[..]].concat(), "free");
    assert!(std::fs::read_dir(here).unwrap().count() == 1, "nothing is left");
    done(here, &[&["patterns", "si.cif"], SMALL].concat());
    patterns(&[], "--overwrite");
    refused(&["integrate", "si.emd"], "--annulus");
    refused(&["integrate", "si.emd", "--annulus", "HAADF=68-200"], "reach to 50.0 mrad");
    refused(
        &["integrate", "si.emd", "--annulus", "A=0-10", "--annulus", "A=10-20"],
        "another name",
    );
    refused(&["integrate", "si.emd", "--sectors", "0-21"], "0-21:4@45");
    refused(&["integrate", "si.cif", "--com"], "si.cif");
    // A request for patterns is none for images.
    std::fs::write(here.join("r.toml"), "structure = \"si.cif\"\n[patterns]\npixels = 16\n")
        .unwrap();
    refused(&["simulate", "r.toml"], "stemgen patterns");
}
