//! Commands of several files that are killed between two of them: the same command makes the rest, as a build does, and another one
//! still replaces nothing.

use super::points::{Point, can_trace, meets};
use super::{fails, files, names, stderr, stemgen, succeeds};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

const TINY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml");

/// A command, its two files, and the call that gives the second its name.
struct Pair {
    arguments: &'static [&'static str],
    files: [&'static str; 2],
    second: Point,
}

const PAIRS: [Pair; 3] = [
    Pair {
        arguments: &["acquire", "--set", "phonons.configurations=1", "-o", "r.h5", "--png"],
        files: ["r.h5", "r.png"],
        second: Point::on("the picture gets its name", "renameat", "r.png"),
    },
    Pair {
        arguments: &["live", "--dose-series", "2", "--dose", "1e4", "-o", "l.h5", "--animation"],
        files: ["l.h5", "l.png"],
        second: Point::on("the animation gets its name", "renameat", "l.png"),
    },
    Pair {
        arguments: &["specimen", "-o", "a.extxyz", "--png"],
        files: ["a.extxyz", "a.png"],
        second: Point::on("the picture gets its name", "renameat", "a.png"),
    },
];

fn command(folder: &Path, pair: &Pair) -> Command {
    let mut command = stemgen(folder);
    let (name, rest) = pair.arguments.split_first().unwrap();
    command.args([name, "--recipe", TINY]).args(rest);
    command
}

/// A build has a folder of its work beside the world, which tells that the world is finished and its other files are not.
#[test]
fn a_build_that_is_killed_before_its_last_file_is_finished_by_the_same_command() {
    if !can_trace() {
        return;
    }
    let tiny = ["build", "--recipe", TINY, "--set", "field.thickness_nm=0.4", "--audit", "0"];
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let build = |more: &[&str]| {
        let mut command = stemgen(here);
        command.args(tiny).args(["-o", "w.h5", "--hspy"]).args(more);
        command
    };
    let second = Point::on("the signals get their name", "rename", "w.hspy.partial");
    let killed = meets(&build(&[]), second, "signal=SIGKILL");
    assert_eq!(killed.status.code(), None, "{}", stderr(&killed));
    let left = names(here);
    assert!(
        left.contains("w.h5") && left.contains("w.png") && !left.contains("w.hspy"),
        "{left:?}"
    );
    let world = std::fs::read(here.join("w.h5")).unwrap();
    let printed = fails(&mut build(&["--seed", "2"]));
    assert!(printed.contains("exists"), "{printed}");
    succeeds(&mut build(&[]));
    assert!(std::fs::read(here.join("w.h5")).unwrap() == world, "the world was made again");
    let signals = hdf5::File::open(here.join("w.hspy")).unwrap();
    let experiments = signals.group("Experiments").unwrap().member_names().unwrap();
    assert_eq!(experiments.len(), 1, "{experiments:?}");
    let left: Vec<String> = names(here).into_iter().filter(|n| n.starts_with("w.")).collect();
    assert_eq!(left, ["w.h5", "w.hspy", "w.png"]);
    assert!(fails(&mut build(&[])).contains("exists"));
}

/// The bytes of a picture; of files that tell the time that they took, that they can be read.
fn is_whole(path: &Path) -> bool {
    let bytes = std::fs::read(path).unwrap();
    match path.extension().unwrap().to_str().unwrap() {
        "png" => bytes.starts_with(b"\x89PNG") && bytes.ends_with(b"IEND\xaeB`\x82"),
        "h5" => hdf5::File::open(path).is_ok(),
        _ => stemgen::structure::read(path).is_ok(),
    }
}

#[test]
fn a_kill_between_two_files_is_made_good_by_the_same_command() {
    if !can_trace() {
        return;
    }
    for pair in PAIRS {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let [first, second] = pair.files;
        let killed = meets(&command(here, &pair), pair.second, "signal=SIGKILL");
        assert_eq!(killed.status.code(), None, "{}", stderr(&killed));
        let left = names(here);
        assert!(left.contains(first) && !left.contains(second), "{left:?}");
        // Another command replaces nothing.
        let before = std::fs::read(here.join(first)).unwrap();
        let printed = fails(command(here, &pair).args(["--seed", "2"]));
        assert!(printed.contains("exists"), "{printed}");
        assert!(std::fs::read(here.join(first)).unwrap() == before);
        let printed = succeeds(&mut command(here, &pair));
        assert!(printed.contains("ended before all its files were written"), "{printed}");
        assert!(pair.files.iter().all(|name| is_whole(&here.join(name))), "{first}");
        assert!(names(here).iter().all(|name| !name.ends_with(".unfinished")), "{first}");
        // And now it is done.
        assert!(fails(&mut command(here, &pair)).contains("exists"));
    }
}

/// All files below a folder by their paths in it.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let relative = |path: &PathBuf| path.strip_prefix(folder).unwrap().to_owned();
    files(folder).iter().map(|path| (relative(path), std::fs::read(path).unwrap())).collect()
}

#[test]
fn a_card_that_is_killed_half_way_is_finished_by_the_same_command() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let tiny = ["build", "--recipe", TINY, "--set", "field.thickness_nm=0.4", "--audit", "0"];
    succeeds(stemgen(here).args(tiny).args(["--no-png", "-o", "w.h5"]));
    let card = |out: &str| {
        let mut command = stemgen(here);
        command.args(["card", "w.h5", "-o", out, "--title", "One small world", "--quiet"]);
        command
    };
    succeeds(&mut card("whole"));
    let whole = contents(&here.join("whole"));
    assert!(whole.len() > 5, "{:?}", whole.keys());
    // Each file is put in its place by one rename: after some of them, and before the last, which is README.md.
    for count in [1, 3, whole.len()] {
        let out = format!("card{count}");
        let point = Point { name: "a file gets its name", call: "rename", path: "", count };
        let killed = meets(&card(&out), point, "signal=SIGKILL");
        assert_eq!(killed.status.code(), None, "{}", stderr(&killed));
        assert!(!names(&here.join(&out)).contains("README.md"), "{count}");
        succeeds(&mut card(&out));
        assert!(contents(&here.join(&out)) == whole, "{count}: {:?}", names(&here.join(&out)));
    }
}
