//! The work folder of a build: one small file per finished sub-tile, and the key of the build.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use ndarray::Array2;

use crate::error::{Error, Result};
use crate::progress::Progress;

const MAGIC: &[u8; 8] = b"STEMSUB1";
const KEY_FILE: &str = "key.json";
const HEADER: usize = 24;

/// Finished sub-tiles on disk.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens the work folder of `output` for a build that `key` describes. Sub-tiles of another
    /// build that lie there are removed, with a warning.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be made, read or written.
    pub fn open(output: &Path, key: &str, progress: &dyn Progress) -> Result<Self> {
        let store = Store { folder: beside(output, ".work") };
        let folder = &store.folder;
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        let key_path = folder.join(KEY_FILE);
        if fs::read(&key_path).is_ok_and(|found| found == key.as_bytes()) {
            return Ok(store);
        }
        let left = store.own_files()?;
        if !left.is_empty() {
            let text = "holds sub-tiles of another recipe, engine or version; starting again";
            progress.warn(&format!("{}: {text}", folder.display()));
        }
        for path in left {
            fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
        }
        write_atomic(&key_path, key.as_bytes())?;
        Ok(store)
    }

    /// The image of a sub-tile if a whole one of this shape is there.
    pub fn load(&self, index: usize, shape: [usize; 2]) -> Option<Array2<f32>> {
        let bytes = fs::read(self.path(index)).ok()?;
        let body = bytes.len().checked_sub(8)?;
        let whole = body == HEADER + 4 * shape[0] * shape[1]
            && bytes[..HEADER] == header(shape)
            && bytes[body..] == checksum(&bytes[..body]).to_le_bytes();
        let pixel = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let pixels = || bytes[HEADER..body].chunks_exact(4).map(pixel).collect();
        whole.then(|| Array2::from_shape_vec(shape, pixels()).ok()).flatten()
    }

    /// Saves the image of a sub-tile; it is there as a whole or not at all.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn save(&self, index: usize, image: &Array2<f32>) -> Result<()> {
        let (rows, columns) = image.dim();
        let mut bytes = header([rows, columns]).to_vec();
        bytes.extend(image.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(checksum(&bytes).to_le_bytes());
        write_atomic(&self.path(index), &bytes)
    }

    /// The work folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The path of the file of a sub-tile.
    pub fn path(&self, index: usize) -> PathBuf {
        self.folder.join(format!("subtile_{index:06}.bin"))
    }

    /// Removes the files, and the folder if nothing else lies in it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove(self) -> Result<()> {
        for path in self.own_files()? {
            fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
        }
        // A folder that holds somebody else's files stays.
        let _ = fs::remove_dir(&self.folder);
        Ok(())
    }

    fn own_files(&self) -> Result<Vec<PathBuf>> {
        let fail = |e| Error::io(&self.folder, "read", e);
        let mut own = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.starts_with(KEY_FILE) || name.starts_with("subtile_") {
                own.push(path);
            }
        }
        Ok(own)
    }
}

/// `path` with something after its name.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

fn header(shape: [usize; 2]) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    header[..8].copy_from_slice(MAGIC);
    header[8..16].copy_from_slice(&(shape[0] as u64).to_le_bytes());
    header[16..].copy_from_slice(&(shape[1] as u64).to_le_bytes());
    header
}

/// FNV-1a, 64 bits.
fn checksum(bytes: &[u8]) -> u64 {
    let step = |hash: u64, &byte: &u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, step)
}

fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    let temporary = beside(path, ".tmp");
    let write = || {
        let mut file = File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(|e| Error::io(&temporary, "write", e))?;
    fs::rename(&temporary, path).map_err(|e| Error::io(path, "write", e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn whole_images_come_back_and_damaged_ones_do_not() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("w.h5"), "key", &Silent).unwrap();
        let image = Array2::from_shape_fn((3, 5), |(i, j)| (i * 5 + j) as f32);
        store.save(4, &image).unwrap();
        assert_eq!(store.load(4, [3, 5]), Some(image));
        assert_eq!(store.load(4, [5, 3]), None);
        assert_eq!(store.load(5, [3, 5]), None);
        let mut bytes = fs::read(store.path(4)).unwrap();
        bytes[40] ^= 1;
        fs::write(store.path(4), &bytes).unwrap();
        assert_eq!(store.load(4, [3, 5]), None);
        fs::write(store.path(4), &bytes[..30]).unwrap();
        assert_eq!(store.load(4, [3, 5]), None);
        fs::write(store.path(4), b"").unwrap();
        assert_eq!(store.load(4, [3, 5]), None);
    }
}
