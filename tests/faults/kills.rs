//! SIGKILL and SIGTERM at every stage of a build and of a simulation: at named calls of the system, whatever the speed of the machine.
//! Random moments stand in the long suite, where they count nothing.

use super::points::{Point, can_trace, meets};
use super::{Method, assert_done, build, fails, files, names, stderr, stemgen, succeeds};
use rand::{Rng, RngExt, SeedableRng, rngs::StdRng};
use std::collections::BTreeSet;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// Stages of a build in sub-tiles, in their order.
const SUBTILES: [Point; 14] = [
    Point::on("the work folder is made", "mkdir", "w.h5.work"),
    Point::on("the place of the world was tried", "unlink", "w.h5.partial"),
    Point::on("the key is written", "renameat", "w.h5.work/key.json"),
    Point::on("the first sub-tile is written", "renameat", "w.h5.work/subtile_000000.bin"),
    Point::on("the last sub-tile is written", "renameat", "w.h5.work/subtile_000008.bin"),
    Point::on("the world is synced", "fsync", "w.h5.partial"),
    Point::on("the world is known to be whole", "renameat", "w.h5.work/complete.json"),
    Point::on("the world gets its name", "rename", "w.h5.partial"),
    Point::on("the picture is synced", "fsync", "w.png.partial"),
    Point::on("the picture gets its name", "rename", "w.png.partial"),
    Point::on("a sub-tile is removed", "unlink", "w.h5.work/subtile_000004.bin"),
    Point::on("the last note is removed", "unlink", "w.h5.work/complete.json"),
    Point { name: "the work folder is removed", call: "rmdir", path: "w.h5.work", count: 2 },
    Point::on("the lock is removed", "unlink", "w.h5.lock"),
];

/// Stages of a build from an empty library: images of columns have names that no test knows, but each is one rename.
const LIBRARY: [Point; 4] = [
    Point { name: "the first image is kept", call: "renameat", path: "", count: 1 },
    Point { name: "an image is kept", call: "renameat", path: "", count: 9 },
    // Ten or so of 18 are there by then.
    Point { name: "a later image is kept", call: "renameat", path: "", count: 5 },
    Point::on("the first sub-tile is written", "renameat", "w.h5.work/subtile_000000.bin"),
];

/// Stages of a simulation with a picture and other files, in their order.
const SIMULATION: [Point; 10] = [
    Point::on("the note of its files gets its name", "renameat", "s.h5.unfinished"),
    Point::on("the images get their name", "renameat2", "s.h5"),
    Point { name: "the images are in their folder", call: "fsync", path: "", count: 4 },
    Point { name: "the picture is synced", call: "fsync", path: "", count: 5 },
    Point::on("the picture gets its name", "renameat", "s_HAADF.png"),
    Point { name: "the TIFF is synced", call: "fsync", path: "", count: 7 },
    Point::on("the TIFF gets its name", "renameat2", "s_HAADF.tif"),
    Point { name: "the .hspy is synced", call: "fsync", path: "", count: 9 },
    Point::on("the .hspy gets its name", "renameat2", "s.hspy"),
    Point::on("the note is removed", "unlink", "s.h5.unfinished"),
];

/// A copy of all that lies in a folder.
fn copy(from: &Path) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy_into(from, folder.path());
    folder
}

fn copy_into(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let copied = to.join(path.file_name().unwrap());
        if path.is_dir() {
            std::fs::create_dir(&copied).unwrap();
            copy_into(&path, &copied);
        } else {
            std::fs::copy(&path, copied).unwrap();
        }
    }
}

/// What a run was that met a signal: killed, or asked to end, which a program may hear when nothing is left to do.
fn assert_ended(ended: &Output, signal: &str, what: &str) {
    let printed = stderr(ended);
    assert!(!printed.contains("panicked"), "{what}: {printed}");
    match signal {
        "SIGKILL" => assert_eq!(ended.status.signal(), Some(9), "{what}: {printed}"),
        _ if ended.status.success() => {}
        _ => {
            assert_eq!(ended.status.code(), Some(143), "{what}: {printed}");
            assert!(printed.contains("interrupted"), "{what}: {printed}");
        }
    }
}

/// Builds that meet each signal at each of the points, the later ones from what was there at the one before. All end in the same bytes.
fn hit_builds(method: Method, points: &[Point]) {
    if !can_trace() {
        return;
    }
    let mut begun = tempfile::tempdir().unwrap();
    for point in points {
        for signal in ["SIGTERM", "SIGKILL"] {
            let what = format!("{signal} while {}, {method:?}", point.name);
            let folder = copy(begun.path());
            let here = folder.path();
            let met = meets(&build(here, method), *point, &format!("signal={signal}"));
            assert_ended(&met, signal, &what);
            if signal == "SIGTERM" {
                assert_nothing_half_written(begun.path(), here, &what);
            } else if !is_complete(here) {
                begun = copy(here);
            }
            finish(here, method, &what);
        }
    }
}

/// Runs the same command again, which makes what is missing, or finds all in place and puts it in order.
fn finish(folder: &Path, method: Method, what: &str) {
    let left = names(folder);
    if !is_complete(folder) {
        succeeds(&mut build(folder, method));
    } else if ["w.h5.work", "w.h5.lock"].iter().any(|name| left.contains(*name)) {
        // Ended while it removed them.
        let printed = fails(&mut build(folder, method));
        assert!(printed.contains("w.h5: exists"), "{what}: {printed}");
    }
    assert_done(folder, method, what);
}

/// Whether the world is there, and nothing is left to do for it but to remove an empty folder and a lock.
fn is_complete(folder: &Path) -> bool {
    names(folder).contains("w.h5") && names(&folder.join("w.h5.work")).is_empty()
}

/// A program that was asked to end has removed what it had begun; what one that was killed had left before may stay.
fn assert_nothing_half_written(before: &Path, folder: &Path, what: &str) {
    let half = |folder: &Path| -> BTreeSet<PathBuf> {
        let unfinished = |path: &PathBuf| {
            let name = path.file_name().unwrap().to_string_lossy();
            name.ends_with(".partial") || name.ends_with(".lock")
        };
        let relative = |path: PathBuf| path.strip_prefix(folder).unwrap().to_owned();
        files(folder).into_iter().filter(unfinished).map(relative).collect()
    };
    let (before, after) = (half(before), half(folder));
    assert!(after.is_subset(&before), "{what}: {after:?}, before {before:?}");
}

#[test]
fn builds_that_are_ended_anywhere_end_in_the_same_bytes() {
    hit_builds(Method::Subtiles, &SUBTILES);
}

#[test]
fn builds_that_are_ended_while_their_library_grows_end_in_the_same_bytes() {
    hit_builds(Method::Library, &LIBRARY);
    hit_builds(Method::NoCache, &LIBRARY[..1]);
}

/// Tells that a simulation was ended between its files.
const NOTE: &str = "s.h5.unfinished";
/// Files that a simulation writes.
const IMAGES: [&str; 4] = ["s.h5", "s_HAADF.png", "s_HAADF.tif", "s.hspy"];

/// Simulates small images of silicon.
fn simulate(folder: &Path) -> Command {
    let silicon = concat!(env!("CARGO_MANIFEST_DIR"), "/../structures/si.cif");
    let mut command = stemgen(folder);
    command.args(["simulate", silicon, "--repeat", "2,2,2", "--scan-end", "5.431,5.431"]);
    command.args(["--scan-points", "4,4"]);
    command.args(["--png", "--tiff", "32", "--hspy", "-o", "s.h5"]);
    command
}

/// What a file of images says; of the HDF5 file, which tells the time that it took, the image.
fn content(folder: &Path, name: &str) -> Vec<u8> {
    let path = folder.join(name);
    match name {
        "s.h5" => {
            let image = stemgen::io::arrays::read(&path, None).unwrap();
            image.data.iter().flat_map(|v| v.to_le_bytes()).collect()
        }
        _ => std::fs::read(path).unwrap(),
    }
}

/// Files of images that an undisturbed simulation writes.
fn expected_images() -> [Vec<u8>; 4] {
    let folder = tempfile::tempdir().unwrap();
    succeeds(&mut simulate(folder.path()));
    assert_eq!(names(folder.path()).len(), IMAGES.len());
    IMAGES.map(|name| content(folder.path(), name))
}

/// What an ended simulation left is whole, but for unfinished files of one that was killed, and the same command makes the rest.
fn assert_images(folder: &Path, expected: &[Vec<u8>; 4], killed: bool, what: &str) {
    for name in names(folder) {
        match IMAGES.iter().position(|known| *known == name) {
            Some(i) => assert!(content(folder, &name) == expected[i], "{what}: {name}"),
            None if name == NOTE => {}
            None => assert!(killed && name.ends_with(".partial"), "{what}: {name}"),
        }
    }
    let left = names(folder);
    if left.contains(NOTE) || !IMAGES.iter().any(|name| left.contains(*name)) {
        succeeds(&mut simulate(folder));
        assert!(!names(folder).contains(NOTE), "{what}");
    }
    // All are there, and no other run replaces them.
    assert!(fails(&mut simulate(folder)).contains("exists"), "{what}");
    for (name, expected) in IMAGES.iter().zip(expected) {
        assert!(content(folder, name) == *expected, "{what}: {name}");
    }
}

#[test]
fn simulations_that_are_ended_leave_whole_files_only() {
    if !can_trace() {
        return;
    }
    let expected = expected_images();
    for point in SIMULATION {
        for signal in ["SIGTERM", "SIGKILL"] {
            let what = format!("{signal} while {}", point.name);
            let folder = tempfile::tempdir().unwrap();
            let met = meets(&simulate(folder.path()), point, &format!("signal={signal}"));
            assert_ended(&met, signal, &what);
            assert_images(folder.path(), &expected, signal == "SIGKILL", &what);
        }
    }
}

/// Ends a program at a random moment of its first 1.5 seconds; returns how it ended.
fn hit(mut command: Command, signal: &str, random: &mut impl Rng) -> Output {
    let child = command.stdout(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_micros(random.random_range(0..1_500_000)));
    send(&child, signal);
    child.wait_with_output().unwrap()
}

/// Sends a signal to a process that may have ended, but was not waited for.
fn send(child: &Child, signal: &str) {
    let id = child.id().to_string();
    let _ = Command::new("kill").args([signal, &id]).stderr(Stdio::null()).status().unwrap();
}

/// How a program ended that a signal may have met before it listened, at work, or not at all.
fn assert_ended_somehow(ended: &Output, signal: i32, what: &str) {
    let printed = stderr(ended);
    let status = ended.status;
    let in_order =
        status.success() || status.signal() == Some(signal) || status.code() == Some(143);
    assert!(in_order && !printed.contains("panicked"), "{what}: {status:?} {printed}");
}

/// `cargo test --release -p stemgen-cli --test faults kills::many -- --ignored --nocapture`
#[test]
#[ignore = "long: a quarter of an hour"]
fn many_builds_at_random_moments() {
    for (signal, number, seed) in [("-KILL", 9, 3), ("-TERM", 15, 4)] {
        let mut random = StdRng::seed_from_u64(seed);
        for (round, method) in
            (0..60).zip([Method::Library, Method::NoCache, Method::Subtiles].iter().cycle())
        {
            let what = format!("{signal} {method:?} {round}, seed {seed}");
            let folder = tempfile::tempdir().unwrap();
            for _ in 0..2 {
                if !is_complete(folder.path()) {
                    let ended = hit(build(folder.path(), *method), signal, &mut random);
                    assert_ended_somehow(&ended, number, &what);
                }
            }
            finish(folder.path(), *method, &what);
        }
    }
}

#[test]
#[ignore = "long: minutes"]
fn many_simulations_at_random_moments() {
    let expected = expected_images();
    for (signal, number) in [("-KILL", 9), ("-TERM", 15)] {
        let mut random = StdRng::seed_from_u64(7);
        for round in 0..120 {
            let what = format!("{signal} {round}");
            let folder = tempfile::tempdir().unwrap();
            let ended = hit(simulate(folder.path()), signal, &mut random);
            assert_ended_somehow(&ended, number, &what);
            assert_images(folder.path(), &expected, number == 9, &what);
        }
    }
}
