//! What is checked before any work begins.

use super::points::{Held, Point, can_trace};
use super::skipped::skipped;
use super::{fails, file, stemgen};

/// A field of so many sites that no usual disk has room for them.
const ENDLESS: [&str; 7] = [
    "srtio3",
    "--difficulty",
    "easy",
    "--set",
    "field.fov_nm=[1000, 1000]",
    "--set",
    "field.thickness_nm=1500",
];

#[test]
fn a_disk_that_is_too_small_is_found() {
    let folder = tempfile::tempdir().unwrap();
    match stemgen::files::free_bytes(folder.path()) {
        Some(free) if free < 1_000_000_000_000 => {}
        Some(_) => return skipped("the disk has more room than the test asks for"),
        None => return skipped("the free space of the disk is unknown"),
    }
    for (subcommand, name) in [("specimen", "a.xyz"), ("build", "a.h5")] {
        let mut command = stemgen(folder.path());
        let printed = fails(command.arg(subcommand).args(ENDLESS).args(["-o", name]));
        for part in ["needed", "free", "GB"] {
            assert!(printed.contains(part), "{subcommand}: no `{part}` in\n{printed}");
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
}

#[cfg(unix)]
#[test]
fn the_second_build_names_the_first() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["build", "--recipe", &file("tests/cli/tiny.toml"), "-o", "w.h5", "--quiet"];
    let seed = ["--seed", "500"];
    let point = Point::on("the work folder is made", "mkdir", "w.h5.work");
    let first = Held::at(stemgen(folder.path()).args(arguments).args(seed), point);
    let printed = fails(stemgen(folder.path()).args(arguments));
    assert!(
        printed.contains("w.h5") && printed.contains(&format!("process {}", first.id())),
        "{printed}"
    );
    assert!(printed.contains("--seed 500"), "the command is shown: {printed}");
    first.kill();
    assert!(!folder.path().join("w.h5").exists());
    // A lock dies with its holder.
    let run = stemgen(folder.path()).args(arguments).status().unwrap();
    assert!(run.success() && !folder.path().join("w.h5.lock").exists());
}

#[test]
fn a_place_that_cannot_be_written_is_found() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    for subcommand in ["specimen", "build"] {
        let mut command = stemgen(folder.path());
        command.args([subcommand, "test", "-o", "file/a.xyz"]);
        let printed = fails(&mut command);
        assert!(printed.contains("file/a.xyz: would lie in file, which is a file"), "{printed}");
    }
}
