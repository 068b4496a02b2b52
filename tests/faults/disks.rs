//! Disks without room: found before any work, or where they fill up meanwhile an error that loses nothing.
//!
//! With a name space of its own (`unshare`) the test has small disks; elsewhere a limit on the size of files stands in for them.

use super::points::{Held, Point, can_trace, meets};
use super::{FIRST_IMAGE, Method, assert_done, build, fails, files, names};
use super::{skipped::skipped, stderr, subtile, succeeds};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Set where the test runs again with mounts of its own.
const INSIDE: &str = "STEMGEN_TEST_MOUNTS";

#[test]
fn full_disks() {
    if !can_trace() {
        return;
    }
    if std::env::var_os(INSIDE).is_some() {
        return small_disks();
    }
    let own = std::env::current_exe().unwrap();
    let mut again = Command::new("unshare");
    again.arg("-rm").arg(own).args(["--exact", "disks::full_disks", "--nocapture"]);
    let output = again.env(INSIDE, "1").output();
    match output {
        Ok(output) if output.status.success() && !stderr(&output).contains("SKIPPED") => {}
        Ok(output) if can_mount() => {
            panic!("{}{}", String::from_utf8_lossy(&output.stdout), stderr(&output))
        }
        _ => skipped("no disks can be mounted here; only the limit on files is tested"),
    }
}

/// Whether there may be mounts in a name space.
fn can_mount() -> bool {
    let script = "mount -t tmpfs -o size=1m tmpfs /tmp";
    Command::new("unshare")
        .args(["-rm", "sh", "-c", script])
        .output()
        .is_ok_and(|o| o.status.success())
}

/// A disk of so many kB in a folder that is made.
fn disk(folder: &Path, kilobytes: u64) {
    fs::create_dir_all(folder).unwrap();
    let size = format!("size={kilobytes}k");
    let mut mount = Command::new("mount");
    mount.args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder);
    assert!(mount.status().unwrap().success());
}

/// Fills the disk of a folder; what is left is less than a page.
fn fill(folder: &Path) -> PathBuf {
    let path = folder.join("filler");
    let mut file = fs::File::create(&path).unwrap();
    let zeros = [0; 4096];
    while std::io::Write::write_all(&mut file, &zeros).is_ok() {}
    path
}

fn small_disks() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    too_small(&here.join("small"));
    filled_meanwhile(&here.join("output"), "");
    filled_meanwhile(&here.join("work"), "w.h5.work");
    full_cache(&here.join("cache"));
}

/// What a build writes is no more than is asked for before it.
#[test]
fn what_is_written_was_counted() {
    if !can_trace() {
        return;
    }
    use stemgen::recipe::CheckedRecipe;
    use stemgen::world::footprint::{PICTURE, work_bytes, world_bytes};
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let whole = Point::on("the world gets its name", "rename", "w.h5.partial");
    meets(&build(here, Method::Subtiles), whole, "signal=SIGKILL");
    let size = |path: &PathBuf| fs::metadata(path).unwrap().len().next_multiple_of(4096);
    let work: u64 = files(&here.join("w.h5.work")).iter().map(size).sum();
    let [world, picture] = Method::Subtiles.expected().each_ref().map(|bytes| bytes.len() as u64);
    let tiny = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml"));
    let field = CheckedRecipe::from_file(tiny, None).unwrap().field.clone();
    assert!(world < world_bytes(&field, 65, 1), "{world}");
    assert!(0 < work && work < work_bytes(&field, 9, 1), "{work}");
    assert!(picture < PICTURE, "{picture}");
}

/// 150 kB hold a world of 70 kB, but not its picture and the sub-tiles.
fn too_small(place: &Path) {
    disk(place, 150);
    let printed = fails(&mut build(place, Method::Subtiles));
    assert!(printed.contains("are needed and") && printed.contains("are free"), "{printed}");
    assert_eq!(names(place).len(), 0, "{:?}", names(place));
}

/// The disk of a folder below `place` fills up while a build runs; with room again it goes on.
fn filled_meanwhile(place: &Path, below: &str) {
    fs::create_dir(place).unwrap();
    disk(&place.join(below), 4000);
    let held = Held::at(&build(place, Method::Subtiles), subtile(0));
    let filler = fill(&place.join(below));
    let ended = held.go_on();
    let printed = stderr(&ended);
    assert_eq!(ended.status.code(), Some(1), "{below}: {printed}");
    assert!(
        printed.contains("No space left") && printed.contains("w.h5.work keeps"),
        "{below}: {printed}"
    );
    assert!(!printed.contains("panicked") && !names(place).contains("w.h5"), "{below}: {printed}");
    fs::remove_file(filler).unwrap();
    let printed = succeeds(&mut build(place, Method::Subtiles));
    assert!(!printed.contains("simulated again"), "{below}: {printed}");
    let mount = Command::new("umount").arg("-l").arg(place.join(below)).status();
    if below.is_empty() {
        return;
    }
    assert!(mount.unwrap().success());
    fs::remove_dir(place.join(below)).unwrap();
    assert_done(place, Method::Subtiles, below);
}

/// A cache without room is told in one line and changes nothing else.
fn full_cache(place: &Path) {
    disk(&place.join("cache"), 200);
    let held = Held::at(&build(place, Method::Library), FIRST_IMAGE);
    fill(&place.join("cache"));
    let ended = held.go_on();
    let printed = stderr(&ended);
    assert!(ended.status.success(), "{printed}");
    assert_eq!(printed.matches("were not kept for later builds").count(), 1, "{printed}");
    assert_done(place, Method::Library, "full cache");
    assert!(!files(&place.join("cache")).is_empty());
}

/// Files that may not grow beyond a size fail to be written, wherever they lie.
#[test]
fn files_that_may_not_grow() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for blocks in [0, 2, 8, 40, 100, 200] {
        let plain = build(here, Method::Subtiles);
        let mut command = Command::new("sh");
        // Without the trap the system would end the program.
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$@\"");
        command.args(["-c", &script, "sh"]).arg(plain.get_program()).args(plain.get_args());
        command.current_dir(here).env("STEMGEN_CACHE", here.join("cache"));
        let printed = fails(command.stdout(std::process::Stdio::null()));
        assert!(
            printed.contains("File too large") || printed.contains("HDF5"),
            "{blocks}: {printed}"
        );
    }
    succeeds(&mut build(here, Method::Subtiles));
    assert_done(here, Method::Subtiles, "limits");
}
