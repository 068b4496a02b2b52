//! `stemgen info`: what a world holds, and the command that makes it again.

use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::path::Path;

fn build(folder: &Path, arguments: &[&str]) {
    let mut command = stemgen(folder);
    let output = command.arg("build").args(arguments).args(["--no-png", "--quiet"]).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
}

/// What `info` tells of the world `w.h5`.
fn printed(folder: &Path) -> serde_json::Value {
    let all = json(stemgen(folder).args(["info", "w.h5"]));
    assert_eq!(all["worlds"].as_array().unwrap().len(), 1);
    all["worlds"][0].clone()
}

/// Builds `w.h5`, runs the command that `info` tells in a folder of its own, and compares all datasets. Returns that command.
fn made_again(arguments: &[&str]) -> String {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    build(first.path(), &[arguments, &["-o", "w.h5"]].concat());
    let printed = printed(first.path());
    assert_eq!(printed["again"]["note"], serde_json::Value::Null, "{arguments:?}");
    let line = printed["command"].as_str().unwrap().to_owned();
    if line.contains("--recipe") {
        let mut command = stemgen(first.path());
        let out = second.path().join("w.toml");
        let output = command.args(["info", "w.h5", "--recipe-out"]).arg(&out).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(std::fs::read_to_string(&out).unwrap(), printed["again"]["recipe"]);
    }
    // As it is typed: a shell reads it.
    let program = Path::new(env!("CARGO_BIN_EXE_stemgen"));
    let run = std::process::Command::new("sh")
        .current_dir(second.path())
        .env("PATH", format!("{}:{}", program.parent().unwrap().display(), env!("PATH")))
        .env("STEMGEN_CACHE", super::cache(first.path()))
        .args(["-c", &format!("{line} --quiet --no-png")])
        .output()
        .unwrap();
    assert!(run.status.success(), "{line}: {}", stderr(&run));
    let digest = |folder: &Path| python("digest.py", &[&folder.join("w.h5")]);
    assert_eq!(digest(first.path()), digest(second.path()), "{line}");
    line
}

#[test]
#[ignore = "long"]
fn the_printed_command_makes_the_same_tiles_and_truth() {
    let tiny = file("tests/cli/tiny.toml");
    let small = ["test", "--grid", "1x1", "--set", "field.thickness_nm=0.4"];
    let with = |more: &[&'static str]| made_again(&[&small, more].concat());
    let of_file = |more: &[&str]| made_again(&[&["--recipe", &tiny], more].concat());

    let line = with(&["--seed", "5", "--no-noise", "--keep-clean"]);
    let common = "build test --set field.thickness_nm=0.4 --grid 1x1";
    assert_eq!(line, format!("stemgen {common} --seed 5 --no-noise --keep-clean -o w.h5"));
    let mosaic = ["--engine", "mosaic", "--window", "5", "--audit", "0", "--unset", "vacancies"];
    let line = with(&[&mosaic[..], &["--set", "boundaries.count=0"]].concat());
    assert!(line.contains("--grid 1x1 --engine mosaic --window 5 --audit 0"), "{line}");
    assert!(line.contains("--unset vacancies"), "{line}");

    // A recipe of one's own; the engine is named where sub-tiles or the method are not the usual ones.
    let line = of_file(&["--engine", "multislice"]);
    assert_eq!(line, "stemgen build --recipe w.toml --engine multislice -o w.h5");
    // So small a field is simulated in windows without a word.
    assert!(!of_file(&["--engine", "window"]).contains("--engine"));
}

#[test]
#[ignore = "long"]
fn the_printed_command_holds_options_of_the_numerics() {
    let small = ["test", "--grid", "1x1", "--set", "field.thickness_nm=0.4"];
    let with = |more: &[&'static str]| made_again(&[&small, more].concat());
    let line = with(&["--expansion", "0.5", "--subtile", "2", "--subtile-overlap", "0.2"]);
    assert!(line.contains("--expansion 0.5 --subtile 2 --subtile-overlap 0.2 -o"), "{line}");
    assert!(with(&["--acquisition", "routine"]).contains("--set acquisition.profile=routine"));
    let line = made_again(&["--recipe", &file("tests/cli/tiny.toml"), "--interpolation", "2,1"]);
    assert!(line.contains("--interpolation 2,1"), "{line}");
}

#[test]
#[ignore = "long"]
fn a_film_with_particles_is_made_again_too() {
    let changes = [
        "field.fov_nm=[3,3]",
        "field.grid=[2,2]",
        "field.thickness_nm=1",
        "particles.count=1",
        "particles.diameter_nm=[1.2,1.5]",
        "phonons.configurations=1",
    ];
    let changes = changes.iter().flat_map(|change| ["--set", change]);
    let words = ["pt", "--difficulty", "easy", "--audit", "0"].into_iter().chain(changes);
    let line = made_again(&words.collect::<Vec<_>>());
    assert!(line.starts_with("stemgen build pt --difficulty easy --set "), "{line}");
}

#[test]
fn the_contents_of_a_world_are_printed() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    build(here, &["test", "--grid", "1x2", "--set", "field.thickness_nm=0.4", "-o", "w.h5"]);
    let output = stemgen(here).args(["info", "w.h5", "--checksum"]).output().unwrap();
    let text = stdout(&output);
    assert!(output.status.success(), "{}", stderr(&output));
    for line in
        ["material", "seed", "sites", "tiles", "detectors", "engine", "SHA-256", "made again by"]
    {
        assert!(text.lines().any(|l| l.starts_with(line)), "no {line} in\n{text}");
    }
    let printed = printed(here);
    assert_eq!(
        (&printed["tiles"], &printed["material"]),
        (&serde_json::json!([1, 2]), &"test".into())
    );
    assert_eq!(printed["grain_boundaries"], 1);
    assert_eq!(printed["file_bytes"], std::fs::metadata(here.join("w.h5")).unwrap().len());
    let world = hdf5::File::open(here.join("w.h5")).unwrap();
    let types = world.dataset("ground_truth/atom_types").unwrap().read_1d::<i32>().unwrap();
    assert_eq!(printed["sites"], types.len());
    assert_eq!(printed["vacancies"], types.iter().filter(|t| **t == 1).count());
    let columns = world.dataset("ground_truth/columns/vacancies").unwrap().shape();
    assert_eq!(printed["columns"], columns[0]);
}

#[test]
fn what_is_no_world_or_names_no_engine_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("no.h5"), b"text").unwrap();
    let printed = fails(stemgen(here).args(["info", "no.h5"]));
    assert!(printed.contains("no.h5") && printed.contains("is not HDF5"), "{printed}");
    assert!(fails(stemgen(here).args(["info", "gone.h5"])).contains("gone.h5"));
    build(here, &["--recipe", &file("tests/cli/tiny.toml"), "-o", "w.h5"]);
    std::fs::copy(here.join("w.h5"), here.join("v.h5")).unwrap();
    let world = hdf5::File::open_rw(here.join("w.h5")).unwrap();
    world.group("metadata").unwrap().delete_attr("engine_parameters").unwrap();
    world.close().unwrap();
    let about = super::json(stemgen(here).args(["info", "w.h5", "v.h5"]));
    assert_eq!(about["worlds"][0]["command"], serde_json::Value::Null);
    assert!(about["worlds"][1]["command"].as_str().unwrap().contains("--recipe v.toml"));
    let two = ["info", "w.h5", "v.h5", "--recipe-out", "r.toml"];
    assert!(fails(stemgen(here).args(two)).contains("one world"));
    let onto = ["info", "v.h5", "--recipe-out", "v.h5", "--overwrite"];
    assert!(fails(stemgen(here).args(onto)).contains("read by this command"));
}
