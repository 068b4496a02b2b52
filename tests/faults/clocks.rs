//! A clock that is set while the program runs. Durations come from the monotonic clock, which nobody can set; `tests/sources.rs`
//! finds every other use.

use super::points::{Held, can_trace};
use super::skipped::skipped;
use super::{Method, assert_done, build, fails, stderr, subtile};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The library that gives a program another clock of the day.
fn faketime() -> Option<PathBuf> {
    let folders =
        ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib", "/usr/lib64"];
    let library = |folder: &&str| Path::new(folder).join("faketime/libfaketimeMT.so.1");
    folders.iter().map(library).find(|path| path.exists())
}

/// Has a command read the time of the day from `clock`, again and again.
fn with_clock(command: &mut Command, library: &Path, clock: &Path) {
    command.env("LD_PRELOAD", library).env("FAKETIME_TIMESTAMP_FILE", clock);
    command.env("FAKETIME_NO_CACHE", "1").env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
}

#[test]
fn builds_and_their_locks_outlive_a_clock_that_jumps() {
    let Some(library) = faketime() else {
        return skipped("libfaketime is not installed (apt-get install libfaketime)");
    };
    if !can_trace() {
        return;
    }
    let beside = tempfile::tempdir().unwrap();
    let clock = beside.path().join("clock");
    std::fs::write(&clock, "+0d").unwrap();
    // The clock is the one that was asked for.
    let mut date = Command::new("date");
    with_clock(date.arg("+%Y"), &library, &clock);
    std::fs::write(&clock, "@1999-05-05 12:00:00").unwrap();
    let year = String::from_utf8(date.output().unwrap().stdout).unwrap();
    assert_eq!(year.trim(), "1999");

    // Each jump meets the build at a place of its own, the first one a second build too.
    let jumps = ["@1971-01-01 00:00:00", "+4000d", "-9000d", "-1y", "@2037-12-31 23:59:59"];
    for (number, jump) in jumps.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        std::fs::write(&clock, "+0d").unwrap();
        let [mut first, mut second] = [(); 2].map(|()| build(here, Method::Subtiles));
        with_clock(&mut first, &library, &clock);
        with_clock(&mut second, &library, &clock);
        let held = Held::at(&first, subtile(2 * number));
        std::fs::write(&clock, jump).unwrap();
        if number == 0 {
            let printed = fails(&mut second);
            assert!(printed.contains("is being written by process"), "{printed}");
        }
        let ended = held.go_on();
        assert!(ended.status.success(), "{jump}: {}", stderr(&ended));
        assert_done(here, Method::Subtiles, jump);
    }
}
