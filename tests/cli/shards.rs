//! Worlds in parts: `--shard`, whatever the number of parts, their order, and what becomes of them.

use super::points::{Point, can_trace, meets};
use super::{fails, file, json, python, stderr, stdout, stemgen};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A mosaic whose library takes most of the time, in many sub-tiles.
const MOSAIC: [&str; 10] = [
    "--engine",
    "mosaic",
    "--window",
    "5",
    "--audit",
    "0",
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
    command.args([
        "build",
        "--recipe",
        &file("tests/cli/tiny_library.toml"),
        "--no-png",
        "-o",
        "w.h5",
    ]);
    command.args(method);
    command
}

/// A command for a part of its work.
fn part_of(mut command: Command, shard: &str) -> Command {
    command.args(["--shard", shard, "--threads", "1", "--quiet"]);
    command
}

fn start(command: Command, shard: &str) -> Child {
    let mut command = part_of(command, shard);
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

/// With and without a cache, and in windows.
fn any_number_of_parts(counts: [&[usize]; 3]) {
    let outside = [&MOSAIC[..], &["--no-cache"]].concat();
    for (method, counts) in [&MOSAIC[..], &outside, &WINDOWS].into_iter().zip(counts) {
        let whole = alone(method);
        for &count in counts {
            let folder = tempfile::tempdir().unwrap();
            let printed = in_parts(folder.path(), method, count);
            assert!(printed["subtiles"].as_u64().unwrap() > 7, "{printed}");
            assert_eq!(printed["subtiles_resumed"], printed["subtiles"], "{printed}");
            assert_ne!(printed["library"][1].as_u64(), Some(18), "{printed}");
            let bytes = std::fs::read(folder.path().join("w.h5")).unwrap();
            assert!(bytes == whole, "{method:?} in {count}");
            assert!(!folder.path().join("w.h5.work").exists());
        }
    }
}

#[test]
fn any_number_of_parts_makes_the_same_bytes() {
    any_number_of_parts([&[1, 7], &[3], &[3]]);
}

#[test]
#[ignore = "takes minutes"]
fn any_number_of_parts_and_any_method_make_the_same_bytes() {
    any_number_of_parts([&[1, 2, 3, 7], &[1, 3, 7], &[1, 3, 7]]);
}

#[test]
fn killed_parts_and_missing_ones_do_no_harm() {
    if !can_trace() {
        return;
    }
    let whole = alone(&MOSAIC);
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for point in [
        Point { name: "an image is kept", call: "renameat", path: "", count: 2 },
        Point { name: "a later image is kept", call: "renameat", path: "", count: 3 },
        Point { name: "the lock is taken", call: "openat", path: "w.h5.lock", count: 1 },
    ] {
        let part = part_of(build(here, &MOSAIC), "1/3");
        let ended = meets(&part, point, "signal=SIGKILL");
        assert_eq!(ended.status.code(), None, "{}", stderr(&ended));
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
    let printed = part("0/2");
    assert!(printed.contains("0/2 of w.h5") && printed.contains("lack 9 images"), "{printed}");
    let printed = part("1/2");
    assert!(printed.contains("sub-tiles") && printed.contains("without --shard"), "{printed}");
    let mut task = build(here, &MOSAIC);
    task.args(["--shard", "slurm"]).env("SLURM_ARRAY_TASK_ID", "11");
    task.env("SLURM_ARRAY_TASK_MIN", "10").env("SLURM_ARRAY_TASK_COUNT", "2");
    let printed = json(&mut task);
    assert_eq!(
        (&printed["shard"], &printed["library_lacks"]),
        (&[1, 2].into(), &0.into()),
        "{printed}"
    );
    assert_eq!(printed["subtiles_resumed"], printed["subtiles"], "{printed}");
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
    let printed = fails(build(here, &WINDOWS).args(["--seed", "5", "--shard", "1/2"]));
    assert!(printed.contains("sub-tiles of another build (seed = 1, now seed = 5)"), "{printed}");
    let other = ["--engine", "window", "--subtile", "0.9", "--subtile-overlap", "0.1"];
    let printed = fails(build(here, &other).args(["--shard", "1/2"]));
    assert!(printed.contains("sub-tiles of another build"), "{printed}");
    assert_eq!(kept(), before);
    let run = build(here, &WINDOWS).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let printed = fails(build(here, &WINDOWS).args(["--shard", "1/2"]));
    assert!(printed.contains("w.h5") && printed.contains("exists"), "{printed}");
}

#[test]
fn bad_shards_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    for (shard, said) in
        [("2/2", "0/2 to 1/2"), ("1", "K/N"), ("0/0", "above 0"), ("slurm", "job array")]
    {
        let mut command = build(folder.path(), &WINDOWS);
        let printed = fails(command.args(["--shard", shard]).env_remove("SLURM_ARRAY_TASK_ID"));
        assert!(printed.contains(said), "{shard}: {printed}");
    }
    for other in [&["--dry-run"][..], &["--max-error", "1"], &["--overwrite"]] {
        let printed = fails(build(folder.path(), &[]).args(["--shard", "0/2"]).args(other));
        assert!(printed.contains("cannot be used with"), "{printed}");
    }
    for (other, said) in [
        (&["test", "--accuracy", "1%"][..], "--accuracy lets an audit choose the engine"),
        (&["test", "--max-error=1"], "--max-error lets an audit choose the engine"),
        (&["--all"], "a script builds one world"),
        (&["test", "--shard", "0/2"], "--shard has no place"),
    ] {
        let mut command = stemgen(folder.path());
        let printed = fails(command.args(["slurm", "--shards", "2", "build"]).args(other));
        assert!(printed.contains(said), "{printed}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// What the script for a cluster does, by a stand-in of `sbatch` that runs each job at once, or by a Slurm of one node.
fn by_script(folder: &Path, around: &mut Command) -> String {
    let mut slurm = stemgen(folder);
    slurm.env("STEMGEN_CACHE", folder.join("cache"));
    slurm.args(["slurm", "--shards", "3", "--cpus", "1", "build", "--recipe"]);
    slurm
        .args([&file("tests/cli/tiny_library.toml"), "--no-png", "-o", "w o r'ld.h5"])
        .args(MOSAIC);
    let script = slurm.output().unwrap();
    assert!(script.status.success(), "{}", stderr(&script));
    std::fs::write(folder.join("jobs.sh"), stdout(&script)).unwrap();
    around.current_dir(folder).env("STEMGEN_CACHE", folder.join("cache"));
    let ended = around.env("STEMGEN", env!("CARGO_BIN_EXE_stemgen")).output().unwrap();
    let printed = stdout(&ended) + &stderr(&ended);
    assert!(ended.status.success(), "{printed}");
    let world =
        std::fs::read(folder.join("w o r'ld.h5")).unwrap_or_else(|e| panic!("{e}: {printed}"));
    assert!(world == alone(&MOSAIC), "{printed}");
    printed
}

/// Runs the tasks of an array one after the other, and tells the number of the job.
const SBATCH: &str = r#"#!/bin/bash
set -eu
echo "$*" >> asked.txt
tasks=""
while [ "$1" != --wrap ]; do
    case "$1" in --array=0-*) tasks=$(seq 0 "${1#--array=0-}") ;; esac
    shift
done
if [ -n "$tasks" ]; then
    for task in $tasks; do
        export SLURM_ARRAY_TASK_ID=$task SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_COUNT=$(echo "$tasks" | wc -l)
        bash -c "$2" >&2
    done
else
    bash -c "$2" >&2
fi
wc -l < asked.txt
"#;

#[cfg(unix)]
#[test]
fn a_script_for_a_cluster_builds_the_world() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::create_dir(here.join("bin")).unwrap();
    let sbatch = here.join("bin/sbatch");
    std::fs::write(&sbatch, SBATCH).unwrap();
    std::fs::set_permissions(&sbatch, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", here.join("bin").display(), std::env::var("PATH").unwrap());
    let printed = by_script(here, Command::new("bash").arg("jobs.sh").env("PATH", path));
    assert!(printed.contains("job 3 writes w o r'ld.h5"), "{printed}");
    let asked = std::fs::read_to_string(here.join("asked.txt")).unwrap();
    let asked: Vec<&str> = asked.lines().collect();
    assert_eq!(asked.len(), 3, "{asked:?}");
    assert!(asked[0].contains("--array=0-2") && !asked[0].contains("--dependency"), "{asked:?}");
    assert!(asked[1].contains("--array=0-2 --dependency=afterok:1 "), "{asked:?}");
    assert!(
        asked[2].contains("--dependency=afterok:2 ") && !asked[2].contains("--array"),
        "{asked:?}"
    );
    assert!(
        asked.iter().all(|a| a.contains("--cpus-per-task=1") && a.contains("--mem=")),
        "{asked:?}"
    );
}

/// With a real Slurm (Debian: slurm-wlm and munge, as root).
#[test]
#[ignore = "starts Slurm on this machine"]
fn slurm_builds_the_world() {
    for program in ["sbatch", "slurmctld", "slurmd", "munged"] {
        if !Command::new("which").arg(program).output().is_ok_and(|o| o.status.success()) {
            return super::skipped::skipped(&format!("no {program}; install slurm-wlm and munge"));
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let wait = "last=$(bash jobs.sh); echo \"$last\"; number=${last#job }; number=${number%% *}; \
                srun --dependency=afterany:$number true; cat slurm-*.out";
    let mut around = Command::new("bash");
    around.arg(file("tests/slurm/one_node.sh")).arg(here.join("slurm")).args(["bash", "-c", wait]);
    let printed = by_script(here, &mut around);
    print!("{printed}");
    assert_eq!(printed.matches("/3 of w o r'ld.h5").count(), 6, "{printed}");
}

#[test]
fn bad_jobs_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    let printed =
        |words: &[&str]| fails(stemgen(folder.path()).args(["slurm", "--shards", "2"]).args(words));
    assert!(printed(&["biuld", "srtio3"]).contains("`biuld` is no build"));
    assert!(printed(&["build", "srtio3"]).contains("comes in tiers"));
    assert!(printed(&["build", "srtio3", "--difficulty", "easiest"]).contains("easiest"));
    assert!(printed(&["build", "test", "--shard=0/2"]).contains("--shard has no place"));
    assert!(fails(stemgen(folder.path()).args(["slurm", "build", "test"])).contains("--shards"));
}

/// A defocus series with a source and displaced atoms, in windows.
fn series(folder: &Path) -> Command {
    let mut command = stemgen(folder);
    command.args(["simulate", &file("structures/si.cif"), "--repeat", "4,4,1", "--window", "7"]);
    command.args(["--scan-end", "5.431,5.431", "--defocus", "0:40:40", "--source-size", "0.8"]);
    command.args(["--phonons", "2", "--sigma", "Si=0.08", "--dose", "1e4"]);
    command
}

#[test]
fn scans_are_simulated_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let images = || python("digest.py", &[&here.join("si.h5")]);
    let whole = series(here).output().unwrap();
    assert!(whole.status.success(), "{}", stderr(&whole));
    let expected = images();
    std::fs::remove_file(here.join("si.h5")).unwrap();
    for count in [3, 7] {
        let parts: Vec<Child> =
            (0..count).map(|k| start(series(here), &format!("{k}/{count}"))).collect();
        for part in parts {
            let ended = part.wait_with_output().unwrap();
            assert!(ended.status.success(), "{}", stderr(&ended));
        }
        assert!(!here.join("si.h5").exists() && !here.join("si.h5.lock").exists());
        // One is missing, one is damaged, one is there already.
        if count == 7 {
            std::fs::remove_file(here.join("si.h5.work/part_2_of_7.part")).unwrap();
            std::fs::write(here.join("si.h5.work/part_3_of_7.part"), b"STEMARR1 and no more")
                .unwrap();
            let again = json(series(here).args(["--shard", "4/7"]));
            assert_eq!(
                (&again["resumed"], &again["shard"]),
                (&true.into(), &serde_json::json!([4, 7]))
            );
        }
        let run = series(here).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        assert_eq!(
            stderr(&run).contains("part_3_of_7.part: is cut off"),
            count == 7,
            "{}",
            stderr(&run)
        );
        assert_eq!(images(), expected, "{count} parts");
        assert!(!here.join("si.h5.work").exists());
        std::fs::remove_file(here.join("si.h5")).unwrap();
    }
    // Parts of other images are refused, and stay.
    assert!(series(here).args(["--shard", "0/2"]).status().unwrap().success());
    for shard in [&["--shard", "1/2"][..], &[]] {
        let printed = fails(series(here).args(["--seed", "5"]).args(shard));
        assert!(printed.contains("part_0_of_2.part: is a part of other images"), "{printed}");
    }
    assert!(series(here).args(["--shard", "1/2"]).status().unwrap().success());
    let printed = fails(series(here).args(["--shard", "2/2"]));
    assert!(printed.contains("0/2 to 1/2"), "{printed}");
    let mut prism = stemgen(here);
    prism.args(["simulate", &file("structures/si.cif"), "--algorithm", "prism", "-o", "p.h5"]);
    let printed = fails(prism.args(["--repeat", "2,2,1", "--shard", "0/2"]));
    assert!(printed.contains("parts of a scan"), "{printed}");
    let printed = fails(series(here).args(["--plane-wave", "--shard", "0/2"]));
    assert!(printed.contains("cannot be used with"), "{printed}");
}
