//! What is fuzzed: each target takes bytes, and says whether they were accepted.

use std::path::{Path, PathBuf};

use stemgen::io::recorded::ImageChoice;
use stemgen::io::{self, arrays};
use stemgen::recipe::{Difficulty, Override, Recipe};
use stemgen::replay::{ReplayOptions, ReplayWorld};
use stemgen::structure::{Format, parse};

use super::dm_bytes::{DM3, DM3_BIG, DM4};
use super::hdf5_files::{odd_world, read_world, reference, world};
use super::mutation::{Dice, binary, text};
use super::recorded_files::{dm_files, signal, unit_cells, velox};

/// Processor time and addresses that a process may take to read through a small file.
const SECONDS: u64 = 1;
const MEMORY_BYTES: u64 = 2 << 30;
/// Seconds by the clock, for a copy that waits and takes no processor time.
const WAIT_SECONDS: u32 = 60;

/// Whether a process that reads through a file ends in order. It is a copy of this one, which takes less time to make than a
/// new one of the program. Only for a process without other threads: a lock of the HDF5 library that another one holds at the
/// fork stays locked in the copy, which then waits for it for ever.
fn survives(path: &Path) -> bool {
    // SAFETY: the copy calls nothing of the threads that it lacks, and ends.
    unsafe {
        let child = libc::fork();
        assert!(child >= 0);
        if child == 0 {
            for (resource, most) in [
                (libc::RLIMIT_CORE, 0),
                (libc::RLIMIT_CPU, SECONDS),
                (libc::RLIMIT_AS, MEMORY_BYTES),
            ] {
                let limit = libc::rlimit { rlim_cur: most, rlim_max: most };
                libc::setrlimit(resource, &raw const limit);
            }
            libc::alarm(WAIT_SECONDS);
            let read = std::panic::catch_unwind(|| drop(stemgen::io::read_through(path)));
            libc::_exit(i32::from(read.is_err()));
        }
        let mut status = 0;
        assert_eq!(libc::waitpid(child, &raw mut status, 0), child);
        libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 0
    }
}

/// Names of all targets.
pub const TARGETS: [&str; 12] = [
    "cif",
    "xyz",
    "poscar",
    "recipe",
    "set",
    "npy",
    "npz",
    "zarr",
    "tif",
    "dm",
    "hdf5_bytes",
    "hdf5_shapes",
];

/// A target with its corpus, and a folder to write in.
pub struct Target {
    name: &'static str,
    corpus: Vec<Vec<u8>>,
    folder: tempfile::TempDir,
}

impl Target {
    pub fn new(name: &str) -> Self {
        let name = TARGETS.into_iter().find(|known| *known == name).expect("a known target");
        let memory = Path::new("/dev/shm");
        let folder = match memory.is_dir() {
            true => tempfile::tempdir_in(memory).unwrap(),
            false => tempfile::tempdir().unwrap(),
        };
        let corpus = corpus(name, folder.path());
        assert!(!corpus.is_empty());
        Target { name, corpus, folder }
    }

    /// The input of a number.
    pub fn input(&self, number: u64) -> Vec<u8> {
        let mut dice = Dice::new(self.name, number);
        match self.name {
            "npy" | "zarr" if dice.one_in(2) => text(&self.corpus, &mut dice),
            "npy" | "npz" | "zarr" | "tif" | "dm" | "hdf5_bytes" => binary(&self.corpus, &mut dice),
            // The counter itself: the file is made by the library.
            "hdf5_shapes" => dice.next().to_le_bytes().to_vec(),
            _ => text(&self.corpus, &mut dice),
        }
    }

    /// Whether the reader accepts the input.
    pub fn run(&self, input: &[u8]) -> bool {
        match self.name {
            "cif" => structure(Format::Cif, input),
            "xyz" => structure(Format::ExtXyz, input),
            "poscar" => structure(Format::Poscar, input),
            "recipe" => recipe(input),
            "set" => set(input),
            "zarr" => self.zarr(input),
            "hdf5_bytes" => {
                let path = self.file("f.h5", input);
                // As the program does: first in a process that may die.
                if !survives(&path) {
                    return false;
                }
                // Both, whatever the other makes of it.
                let accepted = read_world(&path).is_ok();
                accepted | arrays::read(&path, None).is_ok() | recorded(&path)
            }
            "dm" => recorded(&self.file("f.dm", input)),
            "hdf5_shapes" => {
                let path = self.folder.path().join("s.h5");
                let seed = u64::from_le_bytes(input.try_into().unwrap());
                odd_world(&path, &mut Dice::new(self.name, seed)).close().unwrap();
                let accepted = read_world(&path).is_ok();
                accepted | arrays::read(&path, Some("/tiles/0_0")).is_ok()
            }
            ending => arrays::read(&self.file(&format!("f.{ending}"), input), None).is_ok(),
        }
    }

    /// Bytes of the file that an input of a few bytes was turned into.
    pub fn file_bytes(&self) -> usize {
        let made = self.folder.path().join("s.h5");
        std::fs::metadata(made).map_or(0, |file| file.len() as usize)
    }

    fn file(&self, name: &str, input: &[u8]) -> PathBuf {
        let path = self.folder.path().join(name);
        std::fs::write(&path, input).unwrap();
        path
    }

    /// An input is the description, a NUL, and the bytes of the first chunk.
    fn zarr(&self, input: &[u8]) -> bool {
        let folder = self.folder.path().join("z.zarr");
        let _ = std::fs::remove_dir_all(&folder);
        let end = input.iter().position(|b| *b == 0).unwrap_or(input.len());
        let (description, chunk) = (&input[..end], input.get(end + 1..).unwrap_or_default());
        for (name, bytes) in [
            ("0.0", chunk),
            ("0.0.0", chunk),
            ("0/0/0", chunk),
            ("c/0/0", chunk),
            (
                if description.windows(6).any(|w| w == b"codecs") {
                    "zarr.json"
                } else {
                    ".zarray"
                },
                description,
            ),
        ] {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        arrays::read(&folder, None).is_ok()
    }
}

/// Whether a recorded image is read, and taken for a world where it is.
fn recorded(path: &Path) -> bool {
    let choices = [(None, None), (Some("HAADF"), Some(0)), (None, Some(1))];
    let mut accepted = false;
    for (dataset, index) in choices {
        let choice = ImageChoice { dataset: dataset.map(str::to_owned), index };
        if let Ok(image) = io::recorded::read(path, &choice) {
            accepted = true;
            let _ = ReplayWorld::new(image, &ReplayOptions::default());
        }
    }
    accepted
}

fn structure(format: Format, input: &[u8]) -> bool {
    match parse(format, input, Path::new("f")) {
        Ok(structure) => structure.resolve_occupancy(1).is_ok(),
        Err(_) => false,
    }
}

fn recipe(input: &[u8]) -> bool {
    let text = String::from_utf8_lossy(input);
    let read = |tier| Recipe::from_toml_str("no/r.toml", &text, tier).and_then(|r| r.checked());
    read(Some(Difficulty::Easy)).is_ok() | read(None).is_ok()
}

fn set(input: &[u8]) -> bool {
    let text = String::from_utf8_lossy(input);
    let changes: Vec<Override> = text.lines().filter_map(|line| line.parse().ok()).collect();
    let base = Recipe::load("test", None).unwrap();
    base.with_overrides(&changes).and_then(|r| r.checked()).is_ok()
}

/// The files that are changed.
fn corpus(name: &str, folder: &Path) -> Vec<Vec<u8>> {
    let here = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let read = |folder: &str, fits: fn(&str) -> bool| {
        let entries = std::fs::read_dir(here.join(folder)).unwrap();
        let mut paths: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
        paths.retain(|p| p.is_file() && fits(&p.file_name().unwrap().to_string_lossy()));
        paths.sort();
        paths.iter().map(|p| std::fs::read(p).unwrap()).collect::<Vec<_>>()
    };
    let structures =
        |fits| [read("tests/structures/good", fits), read("tests/structures/bad", fits)].concat();
    let made = |name: &str, make: fn(&Path) -> hdf5::File| {
        let path = folder.join(name);
        make(&path).close().unwrap();
        std::fs::read(path).unwrap()
    };
    match name {
        "cif" => structures(|name| name.ends_with(".cif")),
        "xyz" => structures(|name| name.ends_with("xyz")),
        "poscar" => structures(|name| name.starts_with(['P', 'C']) || name.ends_with(".vasp")),
        "recipe" => read("generate", |name| name.ends_with(".toml")),
        "hdf5_bytes" => vec![
            made("w.h5", world),
            made("r.h5", reference),
            made("v.emd", velox),
            made("s.hspy", signal),
            made("c.h5", unit_cells),
        ],
        "dm" => [DM3, DM3_BIG, DM4].into_iter().flat_map(dm_files).collect(),
        "hdf5_shapes" => vec![Vec::new()],
        other => read(&format!("tests/fuzz/{other}"), |_| true),
    }
}
