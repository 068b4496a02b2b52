//! Recordings of places.

use super::{fails, json, python, stderr, stemgen};
use std::path::Path;

/// A small world with pixels of 0.02 nm that keeps its noise-free image.
fn world(folder: &std::path::Path) {
    let built = stemgen(folder)
        .args([
            "build",
            "test",
            "--set",
            "field.fov_nm=[5.04, 7.52]",
            "--set",
            "field.thickness_nm=0.4",
            "--keep-clean",
            "--audit",
            "0",
        ])
        .args(["--no-cache", "-o", "w.h5", "--quiet"])
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", stderr(&built));
}

fn acquire(folder: &std::path::Path, name: &str, options: &[&str]) {
    let output = stemgen(folder)
        .args(["acquire", "w.h5", "-o", name, "--region", "0.3,0.3,7.1,4.7", "--quiet"])
        .args(options)
        .output()
        .unwrap();
    assert!(output.status.success(), "{name}: {}", stderr(&output));
}

/// Each effect alone is found again in the file, by a program that knows nothing of ours, within its statistical error.
#[test]
fn every_effect_is_measured_back() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    world(here);
    acquire(here, "ideal.h5", &["--dose", "1e4", "--stages"]);
    // The world holds the image; of its recipe alone it has to be made.
    let plan = json(stemgen(here).args(["acquire", "w.h5", "-o", "p.h5", "--dry-run"]));
    assert!(plan["image"].is_null() && plan["shape"][0] == 128, "{plan}");
    let recipe = ["acquire", "test", "--set", "field.thickness_nm=0.4", "-o", "p.h5", "--dry-run"];
    let plan = json(stemgen(here).args(recipe).arg("--no-cache"));
    assert!(plan["image"]["estimated_range_s"][1].as_f64().unwrap() > 0.0, "{plan}");
    assert!(!here.join("p.h5").exists());
    let set = |key: &str| format!("acquisition.{key}");
    let with = |name: &str, keys: &[&str], more: &[&str]| {
        let keys: Vec<String> = keys.iter().map(|k| set(k)).collect();
        let mut options: Vec<&str> = keys.iter().flat_map(|k| ["--set", k]).collect();
        options.extend_from_slice(more);
        acquire(here, name, &options);
    };
    with("dqe.h5", &["dqe=0.6"], &["--dose", "1e5", "--stages"]);
    let two = ["--frames", "2", "--keep-frames", "--dose", "1e7"];
    with("drift.h5", &["drift_nm_per_s=[0.012,-0.008]"], &two);
    let fast = ["--dose", "1e8", "--dwell-us", "1"];
    with("hum.h5", &["hum_angstrom=[0.05,0]"], &fast);
    with("jitter.h5", &["line_jitter_angstrom=0.05"], &fast);
    with(
        "saturation.h5",
        &["saturation_pa=40"],
        &["--current-pa", "400", "--dwell-us", "1000", "--stages"],
    );
    let late = ["afterglow_share=0.4", "afterglow_us=15"];
    with("afterglow.h5", &late, &["--dose", "1e5", "--stages"]);
    let chain = ["gain_counts=20", "dark_counts=300", "read_noise_counts=30", "bits=16"];
    with("chain.h5", &chain, &["--dose", "1e4", "--stages"]);
    with("poor.h5", &["gain_counts=0.01", "bits=32"], &["--profile", "poor", "--dose", "1e9"]);
    println!("{}", python("check_recordings.py", &[here]));
}

/// The noise-free image of the world and that of its recipe give the same recording.
#[test]
fn a_world_and_its_recipe_are_recorded_alike() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    world(here);
    let place = ["--region", "2.0,2.0,3.0,3.0", "--profile", "poor", "--dose", "1e5", "--no-cache"];
    let recipe =
        ["acquire", "test", "--set", "field.fov_nm=[5.04, 7.52]", "-o", "r.h5", "--stages"];
    let thin = ["--set", "field.thickness_nm=0.4"];
    let printed = json(stemgen(here).args(recipe).args(thin).args(place));
    assert_eq!(printed["source"], "made from the recipe");
    let printed =
        json(stemgen(here).args(["acquire", "w.h5", "-o", "w1.h5", "--stages"]).args(place));
    assert_eq!(printed["source"], "the noise-free image of the world");
    let again = ["acquire", "w.h5", "-o", "w2.h5", "--stages", "--threads", "1"];
    json(stemgen(here).args(again).args(place));
    println!("{}", python("check_recordings.py", &[Path::new("alike"), here]));
}

/// A whole world in one scan: the tiles are the recording, `/clean` the image, and the truth follows.
#[test]
#[ignore = "long"]
fn worlds_are_recorded_in_one_scan() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let build = |name: &str, options: &[&str]| {
        let mut command = stemgen(here);
        command.args(["build", "test", "--set", "field.fov_nm=[5.04, 7.52]", "--keep-clean"]);
        command.args(["--set", "field.thickness_nm=0.4", "--audit", "0", "--no-cache", "--no-png"]);
        command.args(["-o", name]).args(options);
        command
    };
    let printed = json(&mut build("plain.h5", &[]));
    assert_eq!(printed["acquisition"], serde_json::Value::Null);
    let poor = ["--acquisition", "poor", "--set", "acquisition.drift_nm_per_s=[0.2, 0.1]"];
    let poor = [&poor[..], &["--set", "seed=3"]].concat();
    let printed = json(&mut build("poor.h5", &poor));
    assert_eq!(printed["acquisition"]["bits"], 8);
    assert!(build("again.h5", &poor).args(["--threads", "1", "-q"]).status().unwrap().success());
    let read = |name: &str| std::fs::read(here.join(name)).unwrap();
    assert!(read("poor.h5") == read("again.h5"), "threads change the recording");
    println!("{}", python("check_recordings.py", &[Path::new("world"), here]));

    // The pixels of the recipe itself are too coarse: the image is made at half of them.
    let coarse = |name: &str, options: &[&str]| {
        let mut command = stemgen(here);
        command.args([
            "build",
            "test",
            "--grid",
            "1x1",
            "--set",
            "field.thickness_nm=0.4",
            "--keep-clean",
            "--audit",
            "0",
            "--no-png",
        ]);
        command.args(["--no-cache", "-q", "-o", name]).args(options);
        assert!(command.status().unwrap().success());
    };
    coarse("coarse_plain.h5", &[]);
    coarse("coarse.h5", &["--acquisition", "ideal"]);
    println!("{}", python("check_recordings.py", &[Path::new("coarse"), here]));
    // Of a single tile, all but the edges.
    let printed = json(stemgen(here).args(["acquire", "coarse_plain.h5", "-o", "whole.h5"]));
    assert_eq!(printed["shape"], serde_json::json!([120, 120]));

    let printed = fails(&mut build("x.h5", &["--acquisition", "poor", "--no-noise"]));
    assert!(printed.contains("--no-noise"), "{printed}");
    let printed = fails(&mut build("x.h5", &["--set", "acquisition.frames=2", "--no-noise"]));
    assert!(printed.contains("a recording has noise"), "{printed}");
}

#[test]
fn what_cannot_be_recorded_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let refused = |options: &[&str], parts: &[&str]| {
        let printed = fails(stemgen(here).args(["acquire", "test", "-o", "x.h5"]).args(options));
        for part in parts {
            assert!(printed.contains(part), "{options:?}: no `{part}` in {printed}");
        }
        assert!(!here.join("x.h5").exists());
    };
    refused(&["--dwell-us", "-1"], &["acquisition.dwell_us", "0.01 to 1000000"]);
    refused(&["--frames", "0"], &["acquisition.frames", "1 to 10000"]);
    refused(&["--set", "acquisition.dqe=2"], &["acquisition.dqe", "0.01 to 1"]);
    refused(&["--set", "acquisition.bits=10"], &["8, 12 or 16"]);
    refused(&["--set", "acquisition.drft=1"], &["drft"]);
    refused(&["--set", "acquisition.drift_nm_per_s=[50,0]"], &["would leave the field", "x 0."]);
    refused(&["--region", "3,3,2,4"], &["--region"]);
    refused(&["--region", "0,0,1,1"], &["would leave the field"]);
    refused(&["--at", "100,2"], &["would leave the field"]);
    refused(&["--pixel-nm", "100"], &["0.0001 to 10 nm"]);
    refused(
        &["--region", "1,1,4,4", "--pixel-nm", "1e-4", "--frames", "900", "--keep-frames"],
        &["memory"],
    );
    refused(&["--dose", "1e30"], &["dose"]);
    refused(&["--current-pa", "1e9"], &["pA"]);
    let printed = fails(stemgen(here).args(["acquire", "test", "-o", "x.png"]));
    assert!(printed.contains("did you mean x.h5"), "{printed}");
}
