//! The work folder of a build: its finished sub-tiles, and what the build is.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use ndarray::Array2;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::files::array_store::{ArrayStore, Stored};
use crate::files::atomic_write;
use crate::progress::Progress;

const KEY_FILE: &str = "key.json";

/// Finished sub-tiles on disk.
#[derive(Debug, Clone)]
pub struct SubtileStore {
    arrays: ArrayStore,
    /// Digest of the build, part of the key of each sub-tile.
    build: String,
}

impl SubtileStore {
    /// Opens a work folder for a build that `key` describes. Sub-tiles of another
    /// build that lie there are removed, with a warning.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be made, read or written.
    pub fn open(folder: &Path, key: &str, progress: &dyn Progress) -> Result<Self> {
        let build = format!("{:x?}", Sha256::digest(key).as_slice());
        let store = SubtileStore { arrays: arrays(folder), build };
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        let key_path = folder.join(KEY_FILE);
        if fs::read(&key_path).is_ok_and(|found| found == key.as_bytes()) {
            return Ok(store);
        }
        let left = store.arrays.files()?;
        if !left.arrays.is_empty() {
            let text = "holds sub-tiles of another recipe, engine or version; starting again";
            progress.warn(&format!("{}: {text}", folder.display()));
        }
        for path in left.arrays.iter().chain(&left.leftovers) {
            fs::remove_file(path).map_err(|e| Error::io(path, "remove", e))?;
        }
        atomic_write::write(&key_path, key.as_bytes())?;
        Ok(store)
    }

    /// The image of a sub-tile of `shape` (rows, columns), if a whole one of this build is there. A file that cannot be used is told
    /// in a warning.
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

    /// Saves the image of a sub-tile; it is there as a whole or not at all.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, index: usize, image: &Array2<f32>) -> Result<()> {
        self.arrays.save(&name(index), &self.key(index), "", image)
    }

    /// The path of the file of a sub-tile.
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

fn arrays(folder: &Path) -> ArrayStore {
    ArrayStore::new(folder.to_owned(), "bin")
}

fn name(index: usize) -> String {
    format!("subtile_{index:06}")
}

/// `path` with something after its name.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn subtiles_are_those_of_this_build_and_index() {
        let folder = tempfile::tempdir().unwrap();
        let work = folder.path().join("w.h5.work");
        let store = SubtileStore::open(&work, "key", &Silent).unwrap();
        let image = Array2::from_shape_fn((3, 5), |(i, j)| (i * 5 + j) as f32);
        store.save(4, &image).unwrap();
        assert_eq!(store.load(4, [3, 5], &Silent), Some(image.clone()));
        assert_eq!(store.load(5, [3, 5], &Silent), None);
        // of the same build under another index, and of another build under the same
        fs::copy(store.path(4), store.path(5)).unwrap();
        assert_eq!(store.load(5, [3, 5], &Silent), None);
        let other = SubtileStore::open(&folder.path().join("o.h5.work"), "other", &Silent).unwrap();
        other.save(4, &image).unwrap();
        fs::copy(other.path(4), store.path(4)).unwrap();
        assert_eq!(store.load(4, [3, 5], &Silent), None);
        SubtileStore::clear(&work).unwrap();
        assert!(!work.exists());
    }
}
