//! One signal ends anything; one that was ignored at the start stays ignored.

use super::kills::send;
use super::points::{can_trace, meets};
use super::skipped::skipped;
use super::{FIRST_IMAGE, Method, assert_done, build, files, stderr, stemgen, subtile};
use std::process::{Child, Command};
use std::time::Duration;

/// A field whose columns take many minutes to be looked at, which planning does.
const ENDLESS: [&str; 9] = [
    "build",
    "srtio3",
    "--difficulty",
    "easy",
    "--set",
    "field.fov_nm=[600, 600]",
    "--set",
    "field.thickness_nm=50",
    "--dry-run",
];

/// Signals of a process that a field of its status lists, as bits; `None` where there is no `/proc`.
fn signals(process: &str, field: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let mask = status.lines().find_map(|l| l.strip_prefix(field))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

/// Whether a signal is one of a set.
fn holds(set: Option<u64>, signal: i32) -> bool {
    set.is_some_and(|set| set >> (signal - 1) & 1 == 1)
}

/// Waits until a program listens to a signal.
fn until_it_listens(child: &mut Child, signal: i32) {
    while !holds(signals(&child.id().to_string(), "SigCgt:"), signal) {
        assert!(child.try_wait().unwrap().is_none(), "the program ended before it listened");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn every_signal_ends_a_program_that_plans() {
    let folder = tempfile::tempdir().unwrap();
    for (signal, number) in [("-INT", 2), ("-TERM", 15), ("-HUP", 1)] {
        if holds(signals("self", "SigIgn:"), number) {
            skipped(&format!("this test was started with kill {signal} ignored"));
            continue;
        }
        let code = 128 + number;
        let mut child = stemgen(folder.path()).args(ENDLESS).spawn().unwrap();
        until_it_listens(&mut child, number);
        send(&child, signal);
        let ended = child.wait_with_output().unwrap();
        let told = stderr(&ended);
        assert_eq!(ended.status.code(), Some(code), "{signal}: {told}");
        assert!(told.contains("error: interrupted"), "{told}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
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
    let told = stderr(&ended);
    assert_eq!(ended.status.code(), Some(143), "{told}");
    assert!(told.contains("finished work"), "{told}");
    assert_eq!(files(&here.join("w.h5.work/library")).len(), 1, "the library is kept");
}
