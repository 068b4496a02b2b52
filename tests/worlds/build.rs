//! Worlds as files: schema, resume, overwriting, faults. The engine is a stand-in.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering::Relaxed;

use crate::common::{Spots, build};
use stemgen::io::WorldFile;
use stemgen::progress::{Progress, Silent};
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::world::{BuildOptions, footprint};
use stemgen::{Error, Result};

fn recipe(rows: usize, columns: usize) -> Recipe {
    Recipe::load("srtio3", Difficulty::Easy).unwrap().with_grid(rows, columns).unwrap()
}

fn options() -> BuildOptions {
    BuildOptions { subtile_nm: Some(2.0), subtile_overlap_nm: Some(0.3), ..BuildOptions::default() }
}

fn work_folder(output: &Path) -> PathBuf {
    PathBuf::from(format!("{}.work", output.display()))
}

fn assert_schema(path: &Path) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/schema/check_world.py");
    let run = std::process::Command::new(crate::python::with_h5py())
        .arg(script)
        .arg(path)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{text}");
}

fn assert_equal_data(a: &Path, b: &Path) {
    let (a, b) = (WorldFile::open(a).unwrap(), WorldFile::open(b).unwrap());
    assert_eq!(a.metadata().scaling, b.metadata().scaling);
    let [rows, columns] = a.metadata().grid_shape;
    for r in 0..rows {
        for c in 0..columns {
            assert_eq!(a.tile(r, c).unwrap(), b.tile(r, c).unwrap());
            assert_eq!(a.has_clean(), b.has_clean());
            if a.has_clean() {
                assert_eq!(a.clean_tile(r, c).unwrap(), b.clean_tile(r, c).unwrap());
            }
        }
    }
    assert_eq!(a.overview().unwrap(), b.overview().unwrap());
    let n = a.site_count().unwrap();
    assert_eq!(n, b.site_count().unwrap());
    assert_eq!(a.truth(0..n).unwrap(), b.truth(0..n).unwrap());
    assert_eq!(a.boundaries().unwrap(), b.boundaries().unwrap());
}

#[test]
fn h5py_finds_the_published_schema() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("srtio3", true, true),
        ("batio3", false, false),
        ("sige", true, true),
        ("gan", true, false),
    ];
    for (material, noise, keep_clean) in cases {
        let path = folder.path().join(format!("{material}.h5"));
        let options = BuildOptions { noise, keep_clean, ..options() };
        let recipe = Recipe::load(material, Difficulty::Easy).unwrap().with_grid(2, 3).unwrap();
        let summary = build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
        assert_eq!(summary.grid, [2, 3]);
        assert!(summary.subtiles > 6 && summary.subtiles_resumed == 0, "{summary:?}");
        assert_schema(&path);
        let most = footprint::world_bytes(
            &recipe.field,
            summary.counts.sites,
            1 + usize::from(keep_clean),
        );
        let size = std::fs::metadata(&path).unwrap().len();
        assert!(size <= most, "{material}: {size} bytes, {most} expected");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4, "nothing else is left");
}

#[test]
fn the_reader_gives_back_image_truth_and_recipe() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let recipe = recipe(2, 2);
    build(&recipe, &Spots::new(), &path, &options(), &Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    let text = world.metadata().recipe.clone().unwrap();
    assert_eq!(Recipe::from_toml_str("w.h5", &text, None).unwrap(), recipe);
    assert_eq!(world.shape(), [252, 252]);
    let whole = world.stitched(0..252, 0..252).unwrap();
    let part = world.stitched(100..180, 5..252).unwrap();
    assert_eq!(whole.slice(ndarray::s![100..180, 5..252]), part);
    let [low, high] = whole.iter().fold([1.0f32, 0.0], |[l, h], &v| [l.min(v), h.max(v)]);
    assert_eq!([low, high], [0.0, 1.0]);
    assert!(world.tile(2, 0).is_err() && world.stitched(0..253, 0..2).is_err());
    let boundaries = world.boundaries().unwrap();
    assert_eq!(boundaries.len(), 1);
    assert!((boundaries[0][0][0] - 2.5).abs() < 0.1, "{boundaries:?}");
}

#[test]
fn an_interrupted_build_goes_on_and_ends_in_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, resumed) = (folder.path().join("whole.h5"), folder.path().join("resumed.h5"));
    let options = BuildOptions { keep_clean: true, ..options() };
    let full = build(&recipe(2, 2), &Spots::new(), &whole, &options, &Silent).unwrap();
    let stopped = build(&recipe(2, 2), &Spots::until(4), &resumed, &options, &Silent);
    assert!(matches!(stopped, Err(Error::Interrupted)));
    assert!(!resumed.exists());
    // As a power failure would leave it.
    let file = work_folder(&resumed).join("subtile_000001.bin");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    let engine = Spots::new();
    let summary = build(&recipe(2, 2), &engine, &resumed, &options, &Silent).unwrap();
    assert_eq!(summary.subtiles_resumed, 3);
    assert_eq!(engine.done.load(Relaxed), full.subtiles - 3);
    assert_equal_data(&whole, &resumed);
    assert!(!work_folder(&resumed).exists());
}

#[test]
fn threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (one, four) = (folder.path().join("one.h5"), folder.path().join("four.h5"));
    for (path, threads) in [(&one, 1), (&four, 4)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build(&recipe(1, 2), &Spots::new(), path, &options(), &Silent)).unwrap();
    }
    assert_equal_data(&one, &four);
}

/// Collects warnings.
#[derive(Default)]
struct Listener(Mutex<Vec<String>>);

impl Progress for Listener {
    fn start(&self, _: &str, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
    fn interrupted(&self) -> bool {
        false
    }
}

#[test]
fn subtiles_of_another_build_are_not_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let stopped = build(&recipe(1, 2), &Spots::until(2), &path, &options(), &Silent);
    assert!(matches!(stopped, Err(Error::Interrupted)));
    let listener = Listener::default();
    let engine = Spots { sigma: 0.5, ..Spots::new() };
    let first = folder.path().join("w.h5.work/subtile_000000.bin");
    let refused = build(&recipe(1, 2), &engine, &path, &options(), &listener).unwrap_err();
    assert!(refused.to_string().contains("sub-tiles of another build"), "{refused}");
    assert!(first.exists() && listener.0.lock().unwrap().is_empty());
    let options = BuildOptions { overwrite: true, ..options() };
    let summary = build(&recipe(1, 2), &engine, &path, &options, &listener).unwrap();
    assert_eq!(summary.subtiles_resumed, 0);
    let warnings = listener.0.lock().unwrap();
    assert!(warnings.len() == 1 && warnings[0].contains("starting again"), "{warnings:?}");
}

#[test]
fn a_world_is_replaced_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    std::fs::write(&path, "precious").unwrap();
    let refused = build(&recipe(1, 1), &Spots::new(), &path, &options(), &Silent).unwrap_err();
    assert!(refused.to_string().contains("allow overwriting"), "{refused}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    // What a run leaves that was ended in its very last steps goes, if it is empty.
    let [work, lock] = ["w.h5.work", "w.h5.lock"].map(|name| folder.path().join(name));
    for kept in [None, Some(work.join("notes.txt"))] {
        std::fs::create_dir(&work).unwrap();
        kept.iter().for_each(|notes| std::fs::write(notes, "precious").unwrap());
        std::fs::write(&lock, "process 1\n").unwrap();
        let again = build(&recipe(1, 1), &Spots::new(), &path, &options(), &Silent).unwrap_err();
        assert_eq!(again.to_string(), refused.to_string());
        assert!(!lock.exists() && work.exists() == kept.is_some());
    }
    std::fs::remove_dir_all(&work).unwrap();
    let options = BuildOptions { overwrite: true, ..options() };
    build(&recipe(1, 1), &Spots::new(), &path, &options, &Silent).unwrap();
    assert!(WorldFile::open(&path).is_ok());
}

#[test]
fn foreign_and_truncated_files_are_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    build(&recipe(1, 1), &Spots::new(), &path, &options(), &Silent).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let fails = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let message = WorldFile::open(&path).err().expect(name).to_string();
        assert!(message.contains(name), "{message}");
        message
    };
    let truncated = fails("truncated.h5", &bytes[..bytes.len() / 2]);
    assert!(truncated.contains("truncated"), "{truncated}");
    let foreign = fails("text.h5", b"not a world at all");
    assert!(foreign.contains("not HDF5"), "{foreign}");
    let other = folder.path().join("other.h5");
    hdf5::File::create(&other).unwrap().create_group("something").unwrap();
    let message = WorldFile::open(&other).err().unwrap().to_string();
    assert!(message.contains("no group /metadata"), "{message}");
    assert!(WorldFile::open(&folder.path().join("none.h5")).is_err());
    missing_tile(&path);
}

fn missing_tile(path: &Path) {
    let remove = || -> hdf5::Result<()> { hdf5::File::append(path)?.group("tiles")?.unlink("0_0") };
    remove().unwrap();
    let message = WorldFile::open(path).err().unwrap().to_string();
    assert!(message.contains("0 of 1 tiles"), "{message}");
}

#[test]
fn values_set_afterwards_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let mut recipe = recipe(1, 1);
    (recipe.field.overlap_px, recipe.optics.energy_kv) = (500, f64::NAN);
    let error = build(&recipe, &Spots::new(), &path, &options(), &Silent).unwrap_err();
    assert!(error.to_string().contains("field.overlap_px = 500"), "{error}");
    let wide = BuildOptions { subtile_nm: Some(1.0), subtile_overlap_nm: Some(0.9), ..options() };
    let recipe = self::recipe(1, 1);
    let error = build(&recipe, &Spots::new(), &path, &wide, &Silent).unwrap_err();
    assert!(error.to_string().contains("three times the overlap"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn an_unwritable_place_is_named() -> Result<()> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let path = file.join("w.h5");
    let error = build(&recipe(1, 1), &Spots::new(), &path, &options(), &Silent).unwrap_err();
    assert!(error.to_string().contains("file"), "{error}");
    Ok(())
}
