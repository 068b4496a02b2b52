//! Files from which the HDF5 library does not come back: a process of its own finds them out.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use super::hdf5_files::{reference, world};
use super::points::{Held, Point, can_trace};

/// A heap of texts whose first object has no size: libhdf5 1.10.8 looks for the next one for ever.
fn endless(path: &Path, make: fn(&Path) -> hdf5::File) {
    make(path).close().unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    let heap = bytes.windows(4).position(|w| w == b"GCOL").expect("texts of any length");
    bytes[heap + 16..heap + 32].fill(0);
    std::fs::write(path, bytes).unwrap();
}

fn stemgen(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stemgen"));
    command.current_dir(folder).env("STEMGEN_CACHE", folder.join("cache")).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Has the program read a file in four ways. Returns those that did not end in order, with what they said; with words in order:
/// what was said of the others.
pub fn read_by_the_program(file: &Path) -> Result<Vec<String>, String> {
    let here = tempfile::tempdir().unwrap();
    std::fs::copy(file, here.path().join("f.h5")).unwrap();
    let si = concat!(env!("CARGO_MANIFEST_DIR"), "/../structures/si.cif");
    let commands: [&[&str]; 4] = [
        &["view", "f.h5", "-o", "f.png"],
        &["verify", "f.h5"],
        &["import", "f.h5", "-o", "i.h5", "--pixel-size", "0.1"],
        &["validate", "--reference", "f.h5", "--structure", si],
    ];
    let ended = commands.map(|arguments| {
        let ended = stemgen(here.path(), arguments).output().unwrap();
        let words = printed(&ended);
        // `verify` tells of faults where others would read them.
        let silent = words.is_empty() && ended.stdout.is_empty();
        let in_order = ended.status.success() || ended.status.code().is_some() && !silent;
        match in_order {
            true => Ok(words),
            false => Err(format!("{arguments:?} ended with {}: {words}", ended.status)),
        }
    });
    ended.into_iter().collect()
}

/// A library that reads beyond its own memory may or may not die of it, as chance has it, in the process that is there for it.
#[test]
fn files_that_kill_the_library_are_named_by_the_program() {
    for name in ["header.h5", "heap.h5", "compact.h5"] {
        let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
            .join("tests/fuzz/deadly")
            .join(name);
        let words = read_by_the_program(&file).unwrap_or_else(|fault| panic!("{name}: {fault}"));
        // Other versions may notice it themselves.
        if hdf5::library_version() == (1, 10, 8) && name == "header.h5" {
            let named = |w: &&String| w.contains("f.h5: is damaged: the HDF5 library");
            assert_eq!(words.iter().filter(named).count(), 4, "{words:?}");
        }
    }
}

#[test]
fn a_file_that_hangs_the_library_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    world(&here.join("w.h5")).close().unwrap();
    endless(&here.join("bad.h5"), world);
    endless(&here.join("r.h5"), reference);
    let whole = stemgen(here, &["view", "w.h5", "-o", "w.png"]).output().unwrap();
    assert!(whole.status.success(), "{}", printed(&whole));
    std::fs::remove_file(here.join("w.png")).unwrap();
    let si = concat!(env!("CARGO_MANIFEST_DIR"), "/../structures/si.cif");
    let commands: [&[&str]; 6] = [
        &["view", "bad.h5"],
        &["compare", "w.h5", "bad.h5"],
        &["tiles", "bad.h5", "-n", "1", "-o", "t.npz"],
        &["audit", "bad.h5"],
        &["acquire", "bad.h5", "-o", "a.h5"],
        &["validate", "--reference", "r.h5", "--structure", si],
    ];
    let children: Vec<_> =
        commands.iter().map(|arguments| stemgen(here, arguments).spawn().unwrap()).collect();
    for (arguments, child) in commands.iter().zip(children) {
        let ended = child.wait_with_output().unwrap();
        let printed = printed(&ended);
        assert_eq!(ended.status.code(), Some(1), "{arguments:?}: {printed}");
        assert!(printed.contains("is damaged: the HDF5 library"), "{arguments:?}: {printed}");
    }
    let mut left: Vec<_> =
        std::fs::read_dir(here).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["bad.h5", "r.h5", "w.h5"]);
}

/// Locks are switched off for other tests (.cargo/config.toml).
#[test]
fn a_file_that_another_program_writes_is_refused_for_that_reason() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    world(&here.join("w.h5")).close().unwrap();
    reference(&here.join("r.h5")).close().unwrap();
    let files = ["w.h5", "r.h5"].map(|name| std::fs::File::open(here.join(name)).unwrap());
    files.iter().for_each(|file| file.lock().unwrap());
    let commands: [&[&str]; 3] = [
        &["view", "w.h5"],
        &["import", "r.h5", "-o", "i.h5", "--pixel-size", "0.1"],
        &["integrate", "r.h5", "--annulus", "68-200"],
    ];
    let children = commands.map(|arguments| {
        let mut command = stemgen(here, arguments);
        command.env_remove("HDF5_USE_FILE_LOCKING").spawn().unwrap()
    });
    for (arguments, child) in commands.iter().zip(children) {
        let ended = child.wait_with_output().unwrap();
        let printed = printed(&ended);
        assert_eq!(ended.status.code(), Some(1), "{arguments:?}: {printed}");
        assert!(printed.contains("is locked by another program"), "{arguments:?}: {printed}");
    }
}

#[test]
fn a_signal_ends_the_look_at_a_file() {
    if !can_trace() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    world(&here.join("late.h5")).close().unwrap();
    // The process that reads the file for the program opens it first, and stands still there for ever.
    let point = Point::on("the file is opened", "openat", "late.h5");
    let reader = Held::at(&stemgen(here, &["view", "late.h5"]), point);
    let id = reader.id();
    let program = reader.parent();
    // SAFETY: strace has not seen the program end, so its number is no other's.
    assert_eq!(unsafe { libc::kill(program, libc::SIGTERM) }, 0);
    let ended = reader.wait();
    assert_eq!(ended.status.code(), Some(143), "{}", printed(&ended));
    // The other process has ended with it.
    let state = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    assert!(state.is_empty() || state.contains(") Z "), "a process reads on: {state}");
}
