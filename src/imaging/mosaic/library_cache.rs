//! Images of the library on disk, shared by all builds of a user. The supplied library is read first.
//!
//! Each image has a file, in a folder for each material. The file's name is the SHA-256 of everything that decides the image.

use std::fs;
use std::path::{Path, PathBuf};

use ndarray::Array2;

#[cfg(feature = "hdf5")]
use super::supplied_library::SuppliedLibrary;
use crate::error::{Error, Result};
#[cfg(feature = "hdf5")]
use crate::files::array_store::decoded;
use crate::files::array_store::{ArrayStore, Stored, array_of, note_of};
use crate::progress::Progress;

/// Extension of the images' files. It dates from before library cells had their name.
const EXTENSION: &str = "sheet";
/// Environment variable that names another folder for the cache.
pub(crate) const CACHE_VARIABLE: &str = "STEMGEN_CACHE";

/// Bytes of a file besides its values, rounded up to blocks of the disk.
const FILE_BYTES: u64 = 8192;

/// A folder of images. Images are looked up in the supplied library first. Without a folder nothing is written.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cache {
    #[cfg(feature = "hdf5")]
    supplied: Option<SuppliedLibrary>,
    folder: Option<PathBuf>,
    /// Folder for images that cannot be written to the first one.
    fallback: Option<PathBuf>,
}

/// Images of one material in a cache.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct Holding {
    /// Material.
    pub material: String,
    /// Number of images.
    pub images: usize,
    /// Size of the images in bytes.
    pub bytes: u64,
}

/// A damaged image of a cache.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct CacheFault {
    /// File of the image.
    pub path: PathBuf,
    /// The fault, in words.
    pub fault: &'static str,
}

impl Cache {
    /// Caches images in a folder, which is made at the first write.
    pub fn at(folder: PathBuf) -> Self {
        Cache { folder: Some(folder), ..Cache::default() }
    }

    /// A cache without images that writes nothing: every image is simulated.
    pub fn none() -> Self {
        Cache::default()
    }

    /// The supplied library without a folder: nothing is written.
    pub fn supplied() -> Self {
        Cache {
            #[cfg(feature = "hdf5")]
            supplied: SuppliedLibrary::of_program(),
            ..Cache::default()
        }
    }

    /// The supplied library, and the user's cache: `$STEMGEN_CACHE`, or `stemgen` in `$XDG_CACHE_HOME` or `~/.cache`; no folder where none
    /// of them is known.
    pub fn of_user() -> Self {
        let variable =
            |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
        let home = || Some(variable("HOME")?.join(".cache"));
        let shared = || Some(variable("XDG_CACHE_HOME").or_else(home)?.join("stemgen"));
        Cache { folder: variable(CACHE_VARIABLE).or_else(shared), ..Cache::supplied() }
    }

    /// Replaces the folder.
    #[must_use]
    pub fn in_folder(self, folder: PathBuf) -> Self {
        Cache { folder: Some(folder), ..self }
    }

    /// Leaves out the supplied library.
    #[must_use]
    pub fn without_supplied(self) -> Self {
        Cache { folder: self.folder, fallback: self.fallback, ..Cache::default() }
    }

    /// Replaces the supplied library, which is only read.
    #[cfg(feature = "hdf5")]
    #[must_use]
    pub fn with_supplied(self, supplied: SuppliedLibrary) -> Self {
        Cache { supplied: Some(supplied), ..self }
    }

    /// The supplied library, if there is one.
    #[cfg(feature = "hdf5")]
    pub fn supplied_library(&self) -> Option<&SuppliedLibrary> {
        self.supplied.as_ref()
    }

    /// The folder of the cache.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// Sets another folder for images that cannot be written to the cache's folder, or for a cache without a folder.
    #[must_use]
    pub(crate) fn with_fallback(self, folder: PathBuf) -> Self {
        Cache { fallback: Some(folder), ..self }
    }

    /// Size on disk of an image of this shape (rows, columns) in bytes, rounded up.
    pub(crate) fn file_bytes([rows, columns]: [usize; 2]) -> u64 {
        4 * (rows * columns) as u64 + FILE_BYTES
    }

    fn of(&self, material: &str) -> Option<ArrayStore> {
        Some(store(self.folder.as_ref()?, material))
    }

    /// The folders that may hold the images of a material.
    fn places(&self, material: &str) -> Vec<ArrayStore> {
        let folders = [self.folder.as_ref(), self.fallback.as_ref()].into_iter().flatten();
        folders.map(|folder| store(folder, material)).collect()
    }

    /// The image named `key`, [row, column], if it is there, whole, and of this shape (rows, columns). Warns of a file that cannot be used.
    pub(crate) fn load(
        &self,
        material: &str,
        key: &str,
        shape: [usize; 2],
        progress: &dyn Progress,
    ) -> Option<Array2<f32>> {
        #[cfg(feature = "hdf5")]
        if let Some(supplied) = &self.supplied
            && let Some(file) = supplied.file(material, key, progress)
        {
            match decoded(&file, key, shape).and_then(possible) {
                Ok(image) => return Some(image),
                Err(why) => {
                    progress.warn(&format!("{}: {key}: {why}", supplied.folder().display()))
                }
            }
        }
        for store in self.places(material) {
            let why = match store.load(key, key, shape) {
                Stored::Whole(image) => match possible(image) {
                    Ok(image) => return Some(image),
                    Err(why) => why,
                },
                Stored::Missing => continue,
                Stored::Unusable(why) => why,
            };
            progress.warn(&format!("{}: {why}; simulated again", store.path(key).display()));
        }
        None
    }

    /// Whether there is a file for the image named `key`. Only [`Cache::load`] finds out whether it can be used.
    pub(crate) fn has(&self, material: &str, key: &str) -> bool {
        #[cfg(feature = "hdf5")]
        if self.supplied.as_ref().is_some_and(|s| s.has(material, key)) {
            return true;
        }
        self.places(material).iter().any(|store| store.path(key).is_file())
    }

    /// The files of a material's images, sorted by name.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn files(&self, material: &str) -> Result<Vec<PathBuf>> {
        self.of(material).map_or(Ok(Vec::new()), |store| Ok(store.files()?.arrays))
    }

    /// Reads all images of a material, or of all. Returns their number, and the damaged ones.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Interrupted`].
    pub fn verify(
        &self,
        material: Option<&str>,
        progress: &dyn Progress,
    ) -> Result<(usize, Vec<CacheFault>)> {
        let mut paths = Vec::new();
        for holding in self.holdings()? {
            if material.is_none_or(|m| m == holding.material) {
                paths.extend(self.files(&holding.material)?);
            }
        }
        progress.start("reading", "image", paths.len() as u64);
        let mut faults = Vec::new();
        for path in &paths {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let key = path.file_stem().unwrap_or_default().to_string_lossy();
            progress.advance(1);
            if !path.is_file() {
                faults.push(CacheFault { path: path.clone(), fault: "is no regular file" });
                continue;
            }
            let bytes = fs::read(path).map_err(|e| Error::io(path, "read", e))?;
            if let Err(fault) = checked_image(&bytes, &key) {
                faults.push(CacheFault { path: path.clone(), fault });
            }
        }
        progress.finish();
        Ok((paths.len(), faults))
    }

    /// Writes a checked file of an image to its place, unless a whole one is there. Returns whether it was written.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] for a cache without a folder.
    pub(crate) fn add(&self, material: &str, key: &str, file: &[u8]) -> Result<bool> {
        let Some(store) = self.of(material) else {
            let expected =
                "the cache has no folder; name one in the environment variable STEMGEN_CACHE";
            return Err(Error::invalid(crate::Setting::Library, "cache", expected));
        };
        store.add(key, file)
    }

    /// The notes of all images of a material.
    pub(crate) fn notes(&self, material: &str) -> Vec<String> {
        #[allow(unused_mut)]
        let mut notes = self.of(material).map(|store| store.notes()).unwrap_or_default();
        #[cfg(feature = "hdf5")]
        notes.extend(self.supplied.iter().flat_map(|s| s.notes(material)));
        notes
    }

    /// Writes an image to the cache. `note` is for people who inspect the file.
    ///
    /// # Errors
    /// [`Error::Io`] of the folder. The world can be built without the cache.
    pub(crate) fn save(
        &self,
        material: &str,
        key: &str,
        note: &str,
        image: &Array2<f32>,
    ) -> Result<()> {
        let mut places = self.places(material).into_iter();
        let Some(first) = places.next() else { return Ok(()) };
        first.save(key, key, note, image).inspect_err(|_| {
            // Later builds do not look into the fallback folder; this build does, if it is interrupted and run again.
            let _ = places.next().map(|fallback| fallback.save(key, key, note, image));
        })
    }

    /// The images of the cache's folder, by material.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn holdings(&self) -> Result<Vec<Holding>> {
        let mut found = Vec::new();
        let Some(folder) = self.folder.as_ref().filter(|f| f.is_dir()) else { return Ok(found) };
        let fail = |e| Error::io(folder, "read", e);
        for entry in fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if !path.is_dir() {
                continue;
            }
            let material = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let files = ArrayStore::new(path, EXTENSION).files()?.arrays;
            let bytes = files.iter().filter_map(|p| fs::metadata(p).ok()).map(|m| m.len()).sum();
            found.push(Holding { material, images: files.len(), bytes });
        }
        found.sort_by(|a, b| a.material.cmp(&b.material));
        Ok(found)
    }

    /// Removes the images of a material, or all. Returns the removed images.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn clear(&self, material: Option<&str>) -> Result<Vec<Holding>> {
        let all = self.holdings()?;
        let chosen: Vec<Holding> =
            all.into_iter().filter(|h| material.is_none_or(|m| m == h.material)).collect();
        for holding in &chosen {
            self.of(&holding.material).map_or(Ok(()), |store| store.clear())?;
        }
        Ok(chosen)
    }
}

/// Range of an image's values. They are fractions of the beam, except for rounding below 0, and above 1 where a bright-field image was
/// scaled so that vacuum reads 1.
const FRACTIONS: std::ops::RangeInclusive<f32> = -1e-4..=1.1;

/// Checks that all values of an image can be fractions of the beam. A whole file need not be an image of this program.
///
/// # Errors
/// The fault, in words.
pub(super) fn possible(image: Array2<f32>) -> std::result::Result<Array2<f32>, &'static str> {
    // NaN is in no range.
    match image.iter().all(|v| FRACTIONS.contains(v)) {
        true => Ok(image),
        false => Err("holds values below 0 or above 1, which no fraction of the beam has"),
    }
}

/// Checks an image's file and its key. Returns the note of the image.
///
/// # Errors
/// The fault of the file, in words.
pub(super) fn checked_image(bytes: &[u8], key: &str) -> std::result::Result<String, &'static str> {
    possible(array_of(bytes, key)?)?;
    note_of(bytes)
}

fn store(folder: &Path, material: &str) -> ArrayStore {
    ArrayStore::new(folder.join(material), EXTENSION)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn images_come_back_by_material_and_key() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::at(folder.path().join("cache"));
        assert!(cache.holdings().unwrap().is_empty());
        let image = Array2::from_shape_fn((3, 4), |(i, j)| (i * 4 + j) as f32 * 0.05);
        cache.save("a", "k", "note", &image).unwrap();
        cache.save("b", "k", "", &image).unwrap();
        assert_eq!(cache.load("a", "k", [3, 4], &Silent), Some(image.clone()));
        assert_eq!(cache.load("a", "k", [4, 3], &Silent), None);
        assert_eq!(cache.load("a", "other", [3, 4], &Silent), None);
        assert!(cache.has("a", "k") && !cache.has("a", "other"));
        let holdings = cache.holdings().unwrap();
        assert_eq!(holdings.iter().map(|h| h.images).sum::<usize>(), 2);
        assert_eq!(cache.clear(Some("b")).unwrap().len(), 1);
        assert_eq!(cache.holdings().unwrap().len(), 1);
        assert!(Cache::none().load("a", "k", [3, 4], &Silent).is_none());
        Cache::none().save("a", "k", "", &image).unwrap();
    }

    #[test]
    fn what_cannot_be_kept_in_the_cache_is_kept_in_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let image = Array2::from_elem((2, 2), 0.75);
        for (name, cache) in [("none", Cache::none()), ("broken", Cache::at(file))] {
            let cache = cache.with_fallback(folder.path().join(name));
            assert_eq!(cache.save("a", "k", "", &image).is_err(), name == "broken");
            assert_eq!(cache.load("a", "k", [2, 2], &Silent), Some(image.clone()), "{name}");
            assert!(cache.has("a", "k"));
        }
    }
}
