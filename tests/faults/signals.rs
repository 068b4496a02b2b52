//! One signal ends anything; one that was ignored at the start stays ignored.

use super::kills::send;
use super::skipped::skipped;
use super::{Method, assert_done, build, has_subtile, stderr, stemgen, wait_for};
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

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

/// Waits for the end of a program that would go on for long.
fn end(mut child: Child) -> Output {
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(20) {
            child.kill().unwrap();
            panic!("the program went on");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

/// Whether this process, and so the programs that it starts, ignores a signal; told where there is `/proc` only.
fn is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:")).unwrap_or("0");
    let mask = u64::from_str_radix(mask.trim(), 16).unwrap();
    mask >> (number - 1) & 1 == 1
}

#[test]
fn every_signal_ends_a_program_that_plans() {
    let folder = tempfile::tempdir().unwrap();
    for (signal, number) in [("-INT", 2), ("-TERM", 15), ("-HUP", 1)] {
        if is_ignored(number) {
            skipped(&format!("this test was started with kill {signal} ignored"));
            continue;
        }
        let code = 128 + number;
        let child = stemgen(folder.path()).args(ENDLESS).spawn().unwrap();
        std::thread::sleep(Duration::from_secs(1));
        send(&child, signal);
        let ended = end(child);
        let told = stderr(&ended);
        assert_eq!(ended.status.code(), Some(code), "{signal}: {told}");
        assert!(told.contains("stopping") && told.contains("error: interrupted"), "{told}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_hang_up_that_is_ignored_stays_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plain = build(here, Method::Subtiles);
    let mut command = Command::new("sh");
    // as nohup does
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(plain.get_program());
    command.args(plain.get_args()).current_dir(here).env("STEMGEN_CACHE", here.join("cache"));
    let child = command.stderr(std::process::Stdio::piped()).spawn().unwrap();
    assert!(wait_for(|| has_subtile(here, 0)));
    send(&child, "-HUP");
    let ended = child.wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", stderr(&ended));
    assert_done(here, Method::Subtiles, "hang-up");
}

#[test]
fn the_hint_names_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut command = build(here, Method::NoCache);
    let child = command.args(["--set", "phonons.configurations=40"]).spawn().unwrap();
    let library = here.join("w.h5.work/library");
    assert!(wait_for(|| !super::files(&library).is_empty()));
    send(&child, "-TERM");
    let ended = child.wait_with_output().unwrap();
    let told = stderr(&ended);
    assert_eq!(ended.status.code(), Some(143), "{told}");
    assert!(told.contains("goes on from"), "{told}");
    assert!(!super::files(&library).is_empty(), "the library is kept");
}
