//! One signal ends anything; one that was ignored at the start stays ignored.

use super::points::{Point, can_trace, meets};
use super::skipped::skipped;
use super::{FIRST_IMAGE, Method, assert_done, build, files, stderr, stemgen, subtile};
use std::process::{Command, Stdio};

/// A program begins to listen to signals before it reads its recipe.
const READS_RECIPE: Point = Point::on("it reads its recipe", "openat", "own.toml");

/// Whether this test was started with a signal ignored, which the programs that it starts inherit.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let set = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    set.is_some_and(|set| set >> (signal - 1) & 1 == 1)
}

#[test]
fn every_signal_ends_a_program_that_plans() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut show = stemgen(here);
    show.args(["show-recipe", "srtio3", "--difficulty", "easy"]).stdout(Stdio::piped());
    std::fs::write(here.join("own.toml"), show.output().unwrap().stdout).unwrap();
    for (signal, number) in [("SIGINT", 2), ("SIGTERM", 15), ("SIGHUP", 1)] {
        if is_ignored(number) {
            skipped(&format!("this test was started with {signal} ignored"));
            continue;
        }
        let mut plan = stemgen(here);
        plan.args(["build", "own.toml", "-o", "w.h5", "--dry-run"]);
        let ended = meets(&plan, READS_RECIPE, &format!("signal={signal}"));
        let printed = stderr(&ended);
        assert_eq!(ended.status.code(), Some(128 + number), "{signal}: {printed}");
        assert!(printed.contains("error: interrupted"), "{printed}");
    }
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 1, "the recipe alone");
}

#[test]
fn a_hang_up_that_is_ignored_stays_ignored() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plain = build(here, Method::Subtiles);
    let mut command = Command::new("sh");
    // as nohup does
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(plain.get_program());
    command.args(plain.get_args()).current_dir(here).env("STEMGEN_CACHE", here.join("cache"));
    let ended = meets(&command, subtile(0), "signal=SIGHUP");
    assert!(ended.status.success(), "{}", stderr(&ended));
    assert_done(here, Method::Subtiles, "hang-up");
}

#[test]
fn the_hint_names_what_is_there() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let ended = meets(&build(here, Method::NoCache), FIRST_IMAGE, "signal=SIGTERM");
    let printed = stderr(&ended);
    assert_eq!(ended.status.code(), Some(143), "{printed}");
    assert!(printed.contains("finished work"), "{printed}");
    assert_eq!(files(&here.join("w.h5.work/library")).len(), 1, "the library is kept");
}
