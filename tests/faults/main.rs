//! What happens to a build that is killed, asked to end, robbed of its disk, its folder or its memory, or lied to by what lies on
//! the disk: in the end the same bytes are there, and nothing half-written.
#![cfg(unix)]

#[path = "../common/cases.rs"]
mod cases;
mod clocks;
mod damage;
mod disks;
mod kills;
mod memory;
mod paths;
#[path = "../common/points.rs"]
mod points;
mod several_outputs;
mod signals;
#[path = "../common/skipped.rs"]
mod skipped;

use points::Point;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

/// How the tiny world is built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    /// From a library, which the cache keeps.
    Library,
    /// From a library that only the work folder keeps.
    NoCache,
    /// In sub-tiles, without a library.
    Subtiles,
}

impl Method {
    fn arguments(self) -> &'static [&'static str] {
        match self {
            Method::Library => &["--engine", "mosaic"],
            Method::NoCache => &["--engine", "mosaic", "--no-cache"],
            Method::Subtiles => &["--engine", "window"],
        }
    }

    /// The world and its picture as they have to be, built once.
    fn expected(self) -> &'static [Vec<u8>; 2] {
        static LIBRARY: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
        static SUBTILES: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
        let make = || {
            let folder = tempfile::tempdir().unwrap();
            succeeds(&mut build(folder.path(), self));
            results(folder.path())
        };
        match self {
            Method::Subtiles => SUBTILES.get_or_init(make),
            Method::Library | Method::NoCache => LIBRARY.get_or_init(make),
        }
    }
}

/// Nine small sub-tiles, and a library of 18 images that takes a second.
const SMALL: [&str; 10] = [
    "--subtile",
    "0.6",
    "--subtile-overlap",
    "0.1",
    "--window",
    "5",
    "--set",
    "field.thickness_nm=0.4",
    "--set",
    "optics.convergence_mrad=10",
];

/// Builds `w.h5` and `w.png` in a folder, with a cache there.
fn build(folder: &Path, method: Method) -> Command {
    let mut command = stemgen(folder);
    let recipe = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cli/tiny.toml");
    command.args(["build", "--recipe", recipe, "-o", "w.h5"]);
    command.args(SMALL).args(method.arguments());
    command
}

/// The program, run in `folder`, with a cache there.
fn stemgen(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stemgen"));
    command.current_dir(folder).env("STEMGEN_CACHE", folder.join("cache"));
    command.env("RAYON_NUM_THREADS", "2");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs a command that has to succeed; returns what it says on standard error.
fn succeeds(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let printed = stderr(&output);
    assert!(output.status.success(), "{command:?}: {:?} {printed}", output.status);
    printed
}

/// Runs a command that has to fail with an error, without a panic; returns what it says.
fn fails(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let printed = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{command:?}: {printed}");
    assert!(printed.contains("error: ") && !printed.contains("panicked"), "{printed}");
    printed
}

fn results(folder: &Path) -> [Vec<u8>; 2] {
    ["w.h5", "w.png"].map(|name| std::fs::read(folder.join(name)).unwrap())
}

/// The world is as it has to be, and nothing else is left but the cache.
fn assert_done(folder: &Path, method: Method, what: &str) {
    assert!(results(folder) == *method.expected(), "{what}: other bytes");
    let left: BTreeSet<String> = names(folder);
    let allowed = ["cache", "w.h5", "w.png"].map(str::to_owned);
    assert!(left.iter().all(|name| allowed.contains(name)), "{what}: {left:?}");
}

fn names(folder: &Path) -> BTreeSet<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return BTreeSet::new() };
    entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect()
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut found = Vec::new();
    for path in entries.map(|e| e.unwrap().path()) {
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

/// The call that puts the sub-tile of this number in place.
const fn subtile(number: usize) -> Point {
    const PATHS: [&str; 9] = [
        "w.h5.work/subtile_000000.bin",
        "w.h5.work/subtile_000001.bin",
        "w.h5.work/subtile_000002.bin",
        "w.h5.work/subtile_000003.bin",
        "w.h5.work/subtile_000004.bin",
        "w.h5.work/subtile_000005.bin",
        "w.h5.work/subtile_000006.bin",
        "w.h5.work/subtile_000007.bin",
        "w.h5.work/subtile_000008.bin",
    ];
    Point::on("a sub-tile is written", "renameat", PATHS[number])
}

/// The call that puts the first image of an empty library in place.
const FIRST_IMAGE: Point =
    Point { name: "the first image is kept", call: "renameat", path: "", count: 1 };
