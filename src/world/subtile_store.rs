//! The work folder of a build: its finished sub-tiles, and the key that describes the build.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::files::array_store::{ArrayStore, Stored};
use crate::files::atomic_write;
use crate::files::outputs::{set_aside, work_folder};
use crate::progress::Progress;
use crate::setting::Setting;

const KEY_FILE: &str = "key.json";

/// Finished sub-tiles on disk.
#[derive(Debug, Clone)]
pub struct SubtileStore {
    arrays: ArrayStore,
    /// Digest of the build, part of the key of each sub-tile.
    build: String,
}

impl SubtileStore {
    /// Opens the work folder of `output` for a build that `key` (JSON) describes. Sub-tiles of another build in the folder are kept and
    /// refused; with `replace` they are removed, with a warning. Where the file of the key is damaged, each sub-tile's own key decides
    /// whether it is used ([`Self::load`]).
    ///
    /// # Errors
    /// [`Error::Invalid`] for sub-tiles of another build, [`Error::Io`] when the folder cannot be made, read or written.
    pub fn open(output: &Path, key: &str, replace: bool, progress: &dyn Progress) -> Result<Self> {
        let folder = &work_folder(output);
        let build = format!("{:x?}", Sha256::digest(key).as_slice());
        let store = SubtileStore { arrays: arrays(folder), build };
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        let key_path = folder.join(KEY_FILE);
        if fs::read(&key_path).is_ok_and(|found| found == key.as_bytes()) {
            return Ok(store);
        }
        if is_damaged(&key_path) {
            say_damaged(&key_path, progress);
            set_aside(&key_path)?;
            atomic_write::write(&key_path, key.as_bytes())?;
            return Ok(store);
        }
        let left = store.arrays.files()?;
        if !left.arrays.is_empty() {
            if !replace {
                let other = fs::read_to_string(&key_path).unwrap_or_default();
                return Err(kept(output, left.arrays.len(), &difference(&other, key)));
            }
            let text = "holds sub-tiles of another recipe, engine or version; starting again";
            progress.warn(&format!("{}: {text}", folder.display()));
        }
        for path in left.arrays.iter().chain(&left.leftovers) {
            fs::remove_file(path).map_err(|e| Error::io(path, "remove", e))?;
        }
        atomic_write::write(&key_path, key.as_bytes())?;
        Ok(store)
    }

    /// Opens the work folder while other processes make sub-tiles of the same build in it. Nothing is removed.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a folder of another build, [`Error::Io`] when the folder cannot be made, read or written.
    pub fn join(output: &Path, key: &str, progress: &dyn Progress) -> Result<Self> {
        let folder = &work_folder(output);
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        let build = format!("{:x?}", Sha256::digest(key).as_slice());
        let store = SubtileStore { arrays: arrays(folder), build };
        let key_path = folder.join(KEY_FILE);
        if is_damaged(&key_path) {
            say_damaged(&key_path, progress);
            set_aside(&key_path)?;
            atomic_write::write(&key_path, key.as_bytes())?;
            return Ok(store);
        }
        match fs::read_to_string(&key_path) {
            Ok(found) if found == key => Ok(store),
            Ok(found) => {
                let number = store.arrays.files()?.arrays.len();
                Err(kept(output, number, &difference(&found, key)))
            }
            Err(e) if e.kind() == ErrorKind::NotFound => {
                // All processes that write this file at the same time write the same bytes.
                atomic_write::write(&key_path, key.as_bytes())?;
                Ok(store)
            }
            Err(e) => Err(Error::io(&key_path, "read", e)),
        }
    }

    /// Refuses the sub-tiles of another recipe that lie in the work folder of `output`, before any work.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::Io`].
    pub fn check_recipe(output: &Path, recipe: &str) -> Result<()> {
        let folder = work_folder(output);
        let key_path = folder.join(KEY_FILE);
        if is_damaged(&key_path) {
            return Ok(());
        }
        let Ok(found) = fs::read_to_string(key_path) else { return Ok(()) };
        let number = arrays(&folder).files()?.arrays.len();
        let other = value(&found, "recipe");
        match other == recipe || number == 0 {
            true => Ok(()),
            false => Err(kept(output, number, &changed_lines(&other, recipe))),
        }
    }

    /// Loads the image of a sub-tile of `shape` (rows, columns), if a complete one of this build is stored. A file that cannot be used
    /// causes a warning.
    pub fn load(
        &self,
        index: usize,
        shape: [usize; 2],
        progress: &dyn Progress,
    ) -> Option<Array2<f32>> {
        match self.arrays.load(&name(index), &self.key(index), shape) {
            Stored::Whole(image) => Some(image),
            Stored::Missing => None,
            Stored::Unusable(why) => {
                let path = self.path(index);
                progress.warn(&format!("{}: {why}; simulated again", path.display()));
                None
            }
        }
    }

    /// Saves the image of a sub-tile, completely or not at all.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, index: usize, image: &Array2<f32>) -> Result<()> {
        self.arrays.save(&name(index), &self.key(index), "", image)
    }

    /// Returns the path of the file of a sub-tile.
    pub fn path(&self, index: usize) -> PathBuf {
        self.arrays.path(&name(index))
    }

    /// Removes the sub-tiles in a folder, and the folder if nothing else lies in it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn clear(folder: &Path) -> Result<()> {
        let key = folder.join(KEY_FILE);
        match fs::remove_file(&key) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::io(&key, "remove", e)),
            _ => arrays(folder).clear(),
        }
    }

    fn key(&self, index: usize) -> String {
        format!("{} {index}", self.build)
    }
}

/// Whether the file of the key exists but describes no build.
fn is_damaged(key_path: &Path) -> bool {
    if fs::symlink_metadata(key_path).is_err() {
        return false;
    }
    let text = fs::read_to_string(key_path).unwrap_or_default();
    serde_json::from_str::<serde_json::Value>(&text).ok().is_none_or(|key| key["recipe"].is_null())
}

fn say_damaged(key_path: &Path, progress: &dyn Progress) {
    progress.warn(&format!(
        "{}: is damaged; it is written again, and sub-tiles of this build beside it are used",
        key_path.display()
    ));
}

fn arrays(folder: &Path) -> ArrayStore {
    ArrayStore::new(folder.to_owned(), "bin")
}

fn kept(output: &Path, number: usize, difference: &str) -> Error {
    let expected = format!(
        "{} keeps {number} sub-tiles of another build ({difference}); finish that build first, name another file, or allow overwriting, \
         which removes them",
        work_folder(output).display()
    );
    Error::invalid(Setting::Output, output.display(), expected)
}

/// Returns a value of a key as text.
fn value(key: &str, name: &str) -> String {
    let parsed: serde_json::Value = serde_json::from_str(key).unwrap_or_default();
    parsed[name].as_str().map_or_else(|| parsed[name].to_string(), str::to_owned)
}

/// Names the first difference of two keys.
fn difference(old: &str, new: &str) -> String {
    let differs = |name: &&str| value(old, name) != value(new, name);
    match ["recipe", "engine", "parameters", "numerics", "partition"].iter().find(|n| differs(n)) {
        Some(&"recipe") => changed_lines(&value(old, "recipe"), &value(new, "recipe")),
        Some(&"parameters") => "with other settings of the engine".into(),
        Some(&"numerics") => "of another version of the program".into(),
        Some(&"partition") => "with sub-tiles of another size".into(),
        Some(name) => format!("{name} {}, now {}", value(old, name), value(new, name)),
        None => "of another version of the program".into(),
    }
}

/// Names the first value in which two recipes differ.
fn changed_lines(old: &str, new: &str) -> String {
    let pair = old.lines().zip(new.lines()).find(|(a, b)| a != b);
    pair.map_or("of another recipe".into(), |(a, b)| format!("{a}, now {b}"))
}

fn name(index: usize) -> String {
    format!("subtile_{index:06}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn subtiles_are_those_of_this_build_and_index() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("w.h5");
        let work = work_folder(&output);
        let store = SubtileStore::open(&output, "key", false, &Silent).unwrap();
        let image = Array2::from_shape_fn((3, 5), |(i, j)| (i * 5 + j) as f32);
        store.save(4, &image).unwrap();
        assert_eq!(store.load(4, [3, 5], &Silent), Some(image.clone()));
        assert_eq!(store.load(5, [3, 5], &Silent), None);
        // Copies of a sub-tile: of the same build under another index, and of another build under the same index.
        fs::copy(store.path(4), store.path(5)).unwrap();
        assert_eq!(store.load(5, [3, 5], &Silent), None);
        let other =
            SubtileStore::open(&folder.path().join("o.h5"), "other", false, &Silent).unwrap();
        other.save(4, &image).unwrap();
        fs::copy(other.path(4), store.path(4)).unwrap();
        assert_eq!(store.load(4, [3, 5], &Silent), None);
        SubtileStore::clear(&work).unwrap();
        assert!(!work.exists());
    }
}
