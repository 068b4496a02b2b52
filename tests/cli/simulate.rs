//! `stemgen simulate`.

use super::{file, json, python, stderr, stdout, stemgen};
use std::path::Path;
use std::process::Command;

/// A small, quick simulation of silicon.
fn silicon(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--scan-end", "2.7155,2.7155", "--sampling", "0.1", "--quiet"]);
    command.args(["--detector", "ADF=40-80", "--detector", "BF=0-10"]);
    command
}

#[test]
fn files_are_read_by_h5py() {
    let folder = tempfile::tempdir().unwrap();
    let run =
        silicon(folder.path()).args(["--png", "--thicknesses", "2.7,5.431"]).output().unwrap();
    assert!(run.status.success() && stdout(&run).is_empty(), "{}", stderr(&run));
    let told = python("check_images.py", &[&folder.path().join("si.h5")]);
    assert_eq!(told, "ADF 2 10 10\nBF 2 10 10\n");
    let mut names: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let pictures = ["si_ADF_2.7A.png", "si_ADF_5.4A.png", "si_BF_2.7A.png", "si_BF_5.4A.png"];
    assert_eq!(names, [&["si.h5"], &pictures[..]].concat());
}

#[test]
fn every_algorithm_runs_and_threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let phonons = ["--phonons", "2", "--sigma", "Si=0.08", "--repeat", "2,2,1"];
    for algorithm in ["multislice", "prism", "window"] {
        let mut digests = Vec::new();
        for threads in ["1", "2"] {
            let name = format!("{algorithm}{threads}.h5");
            let mut command = silicon(folder.path());
            command.args(["--algorithm", algorithm, "--threads", threads, "-o", &name]);
            let run = command.args(phonons).output().unwrap();
            assert!(run.status.success(), "{}", stderr(&run));
            digests.push(python("digest.py", &[&path(&name)]));
        }
        assert_eq!(digests[0], digests[1], "{algorithm}");
        assert!(digests[0].contains("images/ADF (1, 10, 10) float32"), "{}", digests[0]);
    }
}

#[test]
fn plane_waves_give_exit_wave_and_image() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--plane-wave", "--defocus", "-60.5", "--sampling", "0.1", "--png"]);
    let summary = json(command.args(["--phonons", "2", "--sigma", "0.08"]));
    assert_eq!(summary["images"][0]["name"], "lens");
    let told = python("check_images.py", &[&folder.path().join("si.h5")]);
    assert!(told.starts_with("lens 1 "), "{told}");
    assert!(folder.path().join("si_lens.png").exists());
}

#[test]
fn a_dry_run_tells_the_numbers_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/srtio3.cif"));
    let plan = json(command.args(["--repeat", "5,5,10", "--dry-run"]));
    assert_eq!(plan["wave_grid"]["points"], serde_json::json!([480, 480]));
    assert_eq!(plan["potential_grid"]["points"], serde_json::json!([480, 480]));
    let number = |key: &str| plan[key].as_f64().unwrap();
    assert!((number("wavelength_angstrom") - 0.025079).abs() < 1e-6);
    // 0.8 wavelength / (2 pixel), with pixels of 19.525 A / 480
    assert!((number("band_limit_mrad") - 246.6).abs() < 0.1, "{}", plan["band_limit_mrad"]);
    assert_eq!(plan["slices"]["count"], 20);
    let thickest = plan["slices"]["thickest_angstrom"].as_f64().unwrap();
    assert!((thickest - 1.9525).abs() < 1e-9, "{thickest}");
    assert_eq!((&plan["atoms"], &plan["composition"]["O"]), (&1250.into(), &750.into()));
    // a step of at most 0.2986 A in 19.525 A
    assert_eq!((&plan["scan"]["rows"], &plan["probes"]), (&66.into(), &(66 * 66).into()));
    assert_eq!((&plan["beams"], &plan["configurations"]), (&0.into(), &1.into()));
    assert!(number("memory_bytes") > 50e6 && number("memory_bytes") < 500e6);
    assert!(number("estimated_time_s") > 0.0);
    assert_eq!(plan["warnings"], serde_json::json!([]));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn crystals_are_turned_and_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stemgen(folder.path());
    command.arg("simulate").arg(file("structures/si.cif"));
    command.args(["--zone", "-1,1,0", "--repeat", "1,1,3", "--dry-run", "--algorithm", "prism"]);
    let plan = json(&mut command);
    let size: Vec<f64> =
        plan["box_angstrom"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((size[2] - 3.0 * 5.431 * 2.0_f64.sqrt()).abs() < 1e-3, "{size:?}");
    assert!(plan["beams"].as_u64().unwrap() > 10);
    assert!(plan["warnings"][0].as_str().unwrap().contains("--repeat"), "{}", plan["warnings"]);
}

#[test]
fn a_warning_is_a_sentence_without_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let mut simulate = stemgen(folder.path());
    simulate.args(["simulate", &file("structures/si.cif"), "--accuracy", "1", "--energy", "80"]);
    let plan = json(simulate.arg("--dry-run"));
    let warnings: Vec<&str> =
        plan["warnings"].as_array().unwrap().iter().map(|w| w.as_str().unwrap()).collect();
    assert!(warnings.iter().any(|w| w.contains("was not measured for")), "{warnings:?}");
    assert!(warnings.iter().all(|w| !w.contains("  ")), "{warnings:?}");
    let mut build = stemgen(folder.path());
    build.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--accuracy", "1", "--dry-run"]);
    let told = stderr(&build.output().unwrap());
    let warning = told.lines().find(|l| l.contains("was not measured for")).expect(&told);
    assert!(!warning.contains("  "), "{warning}");
}

#[test]
fn what_lies_outside_the_cell_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let atoms =
        "2\nLattice=\"12 0 0 0 12 0 0 0 4\" Properties=species:S:1:pos:R:3\nSi 6 6 1\nSi -3 6 1\n";
    std::fs::write(folder.path().join("turned.xyz"), atoms).unwrap();
    let mut command = stemgen(folder.path());
    let plan = json(command.args(["simulate", "turned.xyz", "--dry-run", "--scan-end", "15,12"]));
    let warnings = plan["warnings"].to_string();
    for part in ["1 of 2 atoms lie outside the cell, up to 3.0 A", "from 0.000 to 15.000 A along x"]
    {
        assert!(warnings.contains(part), "no `{part}` in {warnings}");
    }
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_no_fault() {
    let folder = tempfile::tempdir().unwrap();
    let command = format!(
        "'{}' simulate '{}' --dry-run --json | true; exit ${{PIPESTATUS[0]}}",
        env!("CARGO_BIN_EXE_stemgen"),
        file("structures/si.cif")
    );
    let mut bash = Command::new("bash");
    let run = bash.args(["-c", &command]).current_dir(folder.path()).output().unwrap();
    assert!(run.status.success() && stderr(&run).is_empty(), "{}", stderr(&run));
}
