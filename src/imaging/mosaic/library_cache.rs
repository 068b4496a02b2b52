//! Images of sheets on disk, shared by all builds of a user.
//!
//! One file for each image, named by the SHA-256 of all that decides it, in a folder for each material. Files are
//! written under another name and moved into place, so two builds at once do no harm; damaged files count as
//! missing.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use ndarray::Array2;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::progress::Progress;

const MAGIC: &[u8; 8] = b"STEMLIB1";
const EXTENSION: &str = "sheet";
/// Names another folder for the cache.
pub const VARIABLE: &str = "STEMGEN_CACHE";

/// A folder of images; none keeps nothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cache {
    folder: Option<PathBuf>,
}

/// What a cache holds of one material.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Holding {
    /// Material.
    pub material: String,
    /// Number of images.
    pub images: usize,
    /// Their size.
    pub bytes: u64,
}

impl Cache {
    /// The cache in a folder, which is made when first written to.
    pub fn at(folder: PathBuf) -> Self {
        Cache { folder: Some(folder) }
    }

    /// A cache that keeps nothing.
    pub fn none() -> Self {
        Cache { folder: None }
    }

    /// The user's cache: `$STEMGEN_CACHE`, or `stemgen` in `$XDG_CACHE_HOME` or `~/.cache`; none where neither
    /// is known.
    pub fn of_user() -> Self {
        let variable =
            |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
        let home = || Some(variable("HOME")?.join(".cache"));
        let shared = || Some(variable("XDG_CACHE_HOME").or_else(home)?.join("stemgen"));
        Cache { folder: variable(VARIABLE).or_else(shared) }
    }

    /// Its folder.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    fn path(&self, material: &str, key: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(material).join(key).with_extension(EXTENSION))
    }

    /// The image named `key`, if it is there, whole, and of this shape (rows, columns).
    pub fn load(&self, material: &str, key: &str, shape: [usize; 2]) -> Option<Array2<f32>> {
        let bytes = fs::read(self.path(material, key)?).ok()?;
        let body = bytes.len().checked_sub(32)?;
        let (head, digest) = bytes.split_at(body);
        if head.get(..8)? != MAGIC || Sha256::digest(head).as_slice() != digest {
            return None;
        }
        let number = |at: usize| {
            let four: [u8; 4] = head.get(at..at + 4)?.try_into().ok()?;
            Some(u32::from_le_bytes(four) as usize)
        };
        let (rows, columns, about) = (number(8)?, number(12)?, number(16)?);
        let values = head.get(20 + about..)?;
        if [rows, columns] != shape || values.len() != 4 * rows * columns {
            return None;
        }
        let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        Array2::from_shape_vec(shape, values.chunks_exact(4).map(value).collect()).ok()
    }

    /// Keeps an image. `about` is for people who look into the file. A failure is a warning: the world can
    /// be built without.
    pub fn save(
        &self,
        material: &str,
        key: &str,
        about: &str,
        image: &Array2<f32>,
        progress: &dyn Progress,
    ) {
        let Some(path) = self.path(material, key) else { return };
        let mut bytes = MAGIC.to_vec();
        let (rows, columns) = image.dim();
        for number in [rows, columns, about.len()] {
            bytes.extend((number as u32).to_le_bytes());
        }
        bytes.extend(about.as_bytes());
        bytes.extend(image.iter().flat_map(|v| v.to_le_bytes()));
        let digest = Sha256::digest(&bytes);
        bytes.extend(digest);
        if let Err(e) = write(&path, &bytes) {
            progress.warn(&format!("{}: not kept for later builds: {e}", path.display()));
        }
    }

    /// What it holds, by material.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn holdings(&self) -> Result<Vec<Holding>> {
        let mut found = Vec::new();
        let Some(folder) = self.folder.as_ref().filter(|f| f.is_dir()) else { return Ok(found) };
        for entry in entries(folder)?.into_iter().filter(|p| p.is_dir()) {
            let files: Vec<PathBuf> =
                entries(&entry)?.into_iter().filter(|p| is_sheet(p)).collect();
            let bytes = files.iter().filter_map(|p| fs::metadata(p).ok()).map(|m| m.len()).sum();
            let material = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
            found.push(Holding { material, images: files.len(), bytes });
        }
        found.sort_by(|a, b| a.material.cmp(&b.material));
        Ok(found)
    }

    /// Removes the images of a material, or all; returns what was removed.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn clear(&self, material: Option<&str>) -> Result<Vec<Holding>> {
        let all = self.holdings()?;
        let chosen: Vec<Holding> =
            all.into_iter().filter(|h| material.is_none_or(|m| m == h.material)).collect();
        let Some(folder) = &self.folder else { return Ok(chosen) };
        for holding in &chosen {
            let folder = folder.join(&holding.material);
            for path in entries(&folder)?.into_iter().filter(|p| is_sheet(p) || is_partial(p)) {
                fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
            }
            // A folder that holds somebody else's files stays.
            let _ = fs::remove_dir(&folder);
        }
        Ok(chosen)
    }
}

fn is_sheet(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == EXTENSION) && magic(path)
}

fn magic(path: &Path) -> bool {
    let mut first = [0; 8];
    File::open(path).and_then(|mut f| f.read_exact(&mut first)).is_ok() && first == *MAGIC
}

fn is_partial(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.to_string_lossy().starts_with("partial"))
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io(folder, "read", e);
    fs::read_dir(folder).map_err(fail)?.map(|e| e.map(|e| e.path()).map_err(fail)).collect()
}

fn write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let partial = path.with_extension(format!("partial{}", std::process::id()));
    let done = File::create(&partial).and_then(|mut f| f.write_all(bytes));
    done.and_then(|()| fs::rename(&partial, path)).inspect_err(|_| {
        // What is there is of no use.
        let _ = fs::remove_file(&partial);
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn images_come_back_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::at(folder.path().join("cache"));
        assert!(cache.holdings().unwrap().is_empty());
        let image = Array2::from_shape_fn((3, 4), |(i, j)| (i * 4 + j) as f32 * 0.1);
        cache.save("a", "k", "about", &image, &Silent);
        cache.save("b", "k", "", &image, &Silent);
        assert_eq!(cache.load("a", "k", [3, 4]), Some(image.clone()));
        assert_eq!(cache.load("a", "k", [4, 3]), None);
        assert_eq!(cache.load("a", "other", [3, 4]), None);
        let path = cache.path("a", "k").unwrap();
        let whole = fs::read(&path).unwrap();
        for at in [9, 25, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[at] ^= 4;
            fs::write(&path, &bytes).unwrap();
            assert_eq!(cache.load("a", "k", [3, 4]), None, "{at}");
        }
        fs::write(&path, &whole[..30]).unwrap();
        assert_eq!(cache.load("a", "k", [3, 4]), None);
        let holdings = cache.holdings().unwrap();
        assert_eq!(holdings.iter().map(|h| h.images).sum::<usize>(), 2);
        assert_eq!(cache.clear(Some("b")).unwrap().len(), 1);
        assert_eq!(cache.holdings().unwrap().len(), 1);
        assert!(Cache::none().load("a", "k", [3, 4]).is_none());
    }
}
