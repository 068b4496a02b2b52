//! Less memory than a run would take: refused before it is taken.

use super::{names, stderr, stemgen};
use std::path::Path;
use std::process::{Command, Output};

/// The program with a limit of its addresses in kB.
fn limited(folder: &Path, kilobytes: u64, arguments: &[&str]) -> Output {
    let plain = stemgen(folder);
    let mut command = Command::new("sh");
    let script = format!("ulimit -v {kilobytes} && exec \"$@\"");
    command.args(["-c", &script, "sh"]).arg(plain.get_program()).args(arguments);
    command.current_dir(folder).output().unwrap()
}

const SILICON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../structures/si.cif");

#[test]
fn dry_runs_of_wide_cells_take_little() {
    let folder = tempfile::tempdir().unwrap();
    // 2000 A wide: waves of 19 GB
    let arguments = ["simulate", SILICON, "--repeat", "368,368,1", "--dry-run", "--threads", "2"];
    let ended = limited(folder.path(), 2_000_000, &arguments);
    let printed = String::from_utf8_lossy(&ended.stdout).into_owned();
    assert!(ended.status.success(), "{:?} {}", ended.status, stderr(&ended));
    assert!(printed.contains("of memory are needed"), "{printed}");
}

#[test]
fn what_does_not_fit_is_refused_unless_forced() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let wide = ["simulate", SILICON, "--repeat", "100,100,1", "--scan-points", "2,2"];
    let ended = limited(here, 2_000_000, &[&wide[..], &["--threads", "2"]].concat());
    let printed = stderr(&ended);
    assert_eq!(ended.status.code(), Some(1), "{printed}");
    for part in ["of memory are needed", "are free", "windows", "--force"] {
        assert!(printed.contains(part), "no `{part}` in {printed}");
    }
    let world = ["build", "srtio3", "--difficulty", "easy", "--grid", "1x1", "-o", "w.h5"];
    let exact = ["--engine", "multislice", "--subtile", "8", "--threads", "2"];
    let ended = limited(here, 500_000, &[&world[..], &exact].concat());
    let printed = stderr(&ended);
    assert_eq!(ended.status.code(), Some(1), "{printed}");
    assert!(printed.contains("of memory are needed") && printed.contains("--force"), "{printed}");
    let audit = ["audit", "srtio3", "--difficulty", "easy", "--size", "12", "--threads", "2"];
    let ended = limited(here, 500_000, &audit);
    let printed = stderr(&ended);
    assert_eq!(ended.status.code(), Some(1), "{printed}");
    assert!(
        printed.contains("that the audit compares with") && printed.contains("--force"),
        "{printed}"
    );
    assert!(names(here).is_empty(), "{:?}", names(here));
    // What is estimated to take more than there is goes on, and may well fit.
    let small =
        ["simulate", SILICON, "--repeat", "4,4,1", "--scan-points", "2,2", "--threads", "1"];
    let ended = limited(here, 150_000, &[&small[..], &["--force"]].concat());
    assert!(ended.status.success() || ended.status.code() != Some(1), "{}", stderr(&ended));
}
