//! Worlds in parts: `--shard`, whatever the number of parts, their order, and what becomes of them.

use super::{fails, file, json, stderr, stdout, stemgen};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A mosaic whose library takes most of the time, in many sub-tiles.
const MOSAIC: [&str; 10] = [
    "--engine",
    "mosaic",
    "--window",
    "5",
    "--audit",
    "1",
    "--subtile",
    "0.6",
    "--subtile-overlap",
    "0.1",
];
/// Windows in many sub-tiles.
const WINDOWS: [&str; 6] = ["--engine", "window", "--subtile", "0.6", "--subtile-overlap", "0.1"];

/// A build with a cache of its own.
fn build(folder: &Path, method: &[&str]) -> Command {
    let mut command = stemgen(folder);
    command.env("STEMGEN_CACHE", folder.join("cache"));
    command.args(["build", "--recipe", &file("tests/cli/tiny.toml"), "--no-png", "-o", "w.h5"]);
    command.args(method);
    command
}

fn start(mut command: Command, shard: &str) -> Child {
    command.args(["--shard", shard, "--threads", "1", "--quiet"]);
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// The bytes of a world that one process built.
fn alone(method: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let run = build(folder.path(), method).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    std::fs::read(folder.path().join("w.h5")).unwrap()
}

/// All parts at once, twice: sub-tiles of a mosaic take the library of all parts. Then the end; returns what that tells.
fn in_parts(folder: &Path, method: &[&str], count: usize) -> serde_json::Value {
    for _ in 0..2 {
        let parts: Vec<Child> =
            (0..count).map(|k| start(build(folder, method), &format!("{k}/{count}"))).collect();
        for part in parts {
            let ended = part.wait_with_output().unwrap();
            assert!(ended.status.success(), "{}", stderr(&ended));
        }
    }
    let left: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!left.contains(&"w.h5".into()) && !left.contains(&"w.h5.lock".into()), "{left:?}");
    json(&mut build(folder, method))
}

#[test]
fn any_number_of_parts_makes_the_same_bytes() {
    let outside = [&MOSAIC[..], &["--no-cache"]].concat();
    for method in [&MOSAIC[..], &WINDOWS, &outside] {
        let whole = alone(method);
        for count in [1, 3, 7] {
            let folder = tempfile::tempdir().unwrap();
            let told = in_parts(folder.path(), method, count);
            assert!(told["subtiles"].as_u64().unwrap() > 7, "{told}");
            assert_eq!(told["subtiles_resumed"], told["subtiles"], "{told}");
            assert_ne!(told["library"][1].as_u64(), Some(18), "{told}");
            let bytes = std::fs::read(folder.path().join("w.h5")).unwrap();
            assert!(bytes == whole, "{method:?} in {count}");
            assert!(!folder.path().join("w.h5.work").exists());
        }
    }
}

#[test]
fn killed_parts_and_missing_ones_do_no_harm() {
    let whole = alone(&MOSAIC);
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for wait_ms in [0, 60, 120, 250, 400] {
        let mut part = start(build(here, &MOSAIC), "1/3");
        std::thread::sleep(Duration::from_millis(wait_ms));
        let _ = part.kill();
        part.wait().unwrap();
    }
    // Parts of another number of them, out of order, one of them never.
    for shard in ["2/4", "0/4", "3/4"] {
        let ended = start(build(here, &MOSAIC), shard).wait_with_output().unwrap();
        assert!(ended.status.success(), "{}", stderr(&ended));
    }
    let run = build(here, &MOSAIC).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(std::fs::read(here.join("w.h5")).unwrap() == whole);
}

#[test]
fn parts_say_what_they_did_and_what_comes_next() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let part = |shard: &str| {
        let output = build(here, &MOSAIC).args(["--shard", shard]).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        stdout(&output)
    };
    let told = part("0/2");
    assert!(told.contains("0/2 of w.h5") && told.contains("lack 9 images"), "{told}");
    let told = part("1/2");
    assert!(told.contains("sub-tiles") && told.contains("without --shard"), "{told}");
    let mut task = build(here, &MOSAIC);
    task.args(["--shard", "slurm"]).env("SLURM_ARRAY_TASK_ID", "11");
    task.env("SLURM_ARRAY_TASK_MIN", "10").env("SLURM_ARRAY_TASK_COUNT", "2");
    let told = json(&mut task);
    assert_eq!((&told["shard"], &told["library_lacks"]), (&[1, 2].into(), &0.into()), "{told}");
    assert_eq!(told["subtiles_resumed"], told["subtiles"], "{told}");
}

#[test]
fn parts_of_another_world_are_refused_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let ended = start(build(here, &WINDOWS), "0/2").wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", stderr(&ended));
    let kept = || std::fs::read_dir(here.join("w.h5.work")).unwrap().count();
    let before = kept();
    assert!(before > 2);
    let told = fails(build(here, &WINDOWS).args(["--seed", "5", "--shard", "1/2"]));
    assert!(told.contains("sub-tiles of another build (seed = 1, now seed = 5)"), "{told}");
    let other = ["--engine", "window", "--subtile", "0.9", "--subtile-overlap", "0.1"];
    let told = fails(build(here, &other).args(["--shard", "1/2"]));
    assert!(told.contains("sub-tiles of another build"), "{told}");
    assert_eq!(kept(), before);
    let run = build(here, &WINDOWS).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let told = fails(build(here, &WINDOWS).args(["--shard", "1/2"]));
    assert!(told.contains("w.h5") && told.contains("exists"), "{told}");
}

#[test]
fn bad_shards_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    for (shard, said) in
        [("2/2", "0/2 to 1/2"), ("1", "K/N"), ("0/0", "above 0"), ("slurm", "job array")]
    {
        let mut command = build(folder.path(), &WINDOWS);
        let told = fails(command.args(["--shard", shard]).env_remove("SLURM_ARRAY_TASK_ID"));
        assert!(told.contains(said), "{shard}: {told}");
    }
    for other in [&["--dry-run"][..], &["--max-error", "1"], &["--overwrite"]] {
        let told = fails(build(folder.path(), &[]).args(["--shard", "0/2"]).args(other));
        assert!(told.contains("cannot be used with"), "{told}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
