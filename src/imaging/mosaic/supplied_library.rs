//! The supplied library: simulations for the program's own recipes, installed with it and only read, so that no machine has to make them
//! again.
//!
//! There is one archive for each material, for example `srtio3.stemlib`. `library/make.sh` writes new ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::library_archive::Archive;
use super::library_cache::Holding;
use crate::error::{Error, Result};
use crate::files::array_store;
use crate::progress::Progress;

/// Environment variable that names another folder with libraries; empty for none.
pub(crate) const LIBRARY_VARIABLE: &str = "STEMGEN_LIBRARY";
const EXTENSION: &str = "stemlib";

/// A folder of archives that are only read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SuppliedLibrary {
    folder: PathBuf,
}

/// An opened archive, or its fault.
struct Opened {
    archive: std::result::Result<Archive, String>,
    /// Whether a warning of the fault was given.
    warned: AtomicBool,
}

/// Opened archives by path: a process reads each one once.
static OPENED: Mutex<BTreeMap<PathBuf, Arc<Opened>>> = Mutex::new(BTreeMap::new());

static OF_PROGRAM: OnceLock<PathBuf> = OnceLock::new();

impl SuppliedLibrary {
    /// Reads archives from a folder.
    pub fn at(folder: PathBuf) -> Self {
        SuppliedLibrary { folder }
    }

    /// The library of this program: the folder in `$STEMGEN_LIBRARY`, else the folder given to [`SuppliedLibrary::set_of_program`], else
    /// `library/` of the clone that the program was built in, or `../share/stemgen/library` relative to the program; `None` if there is
    /// none of these.
    pub fn of_program() -> Option<Self> {
        if let Some(named) = std::env::var_os(LIBRARY_VARIABLE) {
            return (!named.is_empty()).then(|| SuppliedLibrary::at(named.into()));
        }
        if let Some(folder) = OF_PROGRAM.get() {
            return Some(SuppliedLibrary::at(folder.clone()));
        }
        let clone = Path::new(env!("CARGO_MANIFEST_DIR")).join("library");
        let program = std::env::current_exe().ok();
        let prefix = program.as_deref().and_then(Path::parent).and_then(Path::parent);
        let installed = prefix.map(|p| p.join("share").join("stemgen").join("library"));
        let folders = [Some(clone), installed].into_iter().flatten();
        folders.map(SuppliedLibrary::at).find(|library| !library.archives().is_empty())
    }

    /// Sets the folder of this program's library for everything that is built afterwards. Only the first call has an effect.
    pub fn set_of_program(folder: PathBuf) {
        let _ = OF_PROGRAM.set(folder);
    }

    /// The folder of the archives.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The archives, sorted by name.
    fn archives(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut found: Vec<PathBuf> = entries
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|e| e == EXTENSION))
            .collect();
        found.sort();
        found
    }

    /// The names in a cache of the images of a material that the library holds.
    pub fn keys(&self, material: &str) -> Vec<String> {
        let Some(opened) = self.archive(material) else { return Vec::new() };
        let names = opened.usable().into_iter().flat_map(Archive::names);
        names.map(|(_, key)| key.to_owned()).collect()
    }

    /// The images of the library by material. Reads all archives and finds damaged ones.
    ///
    /// # Errors
    /// [`Error::Parse`] for an archive that is damaged or of another version of the numerics; [`Error::Io`];
    /// [`Error::Interrupted`].
    pub fn verified(&self, progress: &dyn Progress) -> Result<Vec<Holding>> {
        let mut held: BTreeMap<String, Holding> = BTreeMap::new();
        for path in self.archives() {
            let archive = Archive::open(&path)?;
            progress.start("reading", "image", archive.names().count() as u64);
            for (material, key) in archive.names() {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                if let Some(Err(message)) = archive.file(material, key) {
                    let message = format!("{key}: {message}");
                    return Err(Error::Parse { path, line: 0, message });
                }
                progress.advance(1);
            }
            progress.finish();
            for holding in archive.holdings() {
                held.insert(holding.material.clone(), holding);
            }
        }
        Ok(held.into_values().collect())
    }

    /// The images of the library by material, without archives that cannot be used.
    pub fn holdings(&self) -> Vec<Holding> {
        let material = |path: &PathBuf| Some(path.file_stem()?.to_str()?.to_owned());
        let materials = self.archives().iter().filter_map(material).collect::<Vec<_>>();
        let held = materials.iter().filter_map(|m| Some(self.archive(m)?.usable()?.holdings()));
        held.flatten().collect()
    }

    /// The archive of a material, if there is one.
    fn archive(&self, material: &str) -> Option<Arc<Opened>> {
        let path = self.folder.join(format!("{material}.{EXTENSION}"));
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = opened.get(&path) {
            return Some(Arc::clone(found));
        }
        let archive = match Archive::open(&path) {
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return None;
            }
            read => read.map_err(|e| e.to_string()),
        };
        let new = Arc::new(Opened { archive, warned: AtomicBool::new(false) });
        Some(Arc::clone(opened.entry(path).or_insert(new)))
    }

    /// The bytes of an image's file in a cache, as [`Archive::file`] returns them. Warns of an archive or image that cannot be used.
    pub(super) fn file(
        &self,
        material: &str,
        key: &str,
        progress: &dyn Progress,
    ) -> Option<Vec<u8>> {
        let Some(opened) = self.archive(material) else {
            self.tell_if_missing(progress);
            return None;
        };
        let found = match &opened.archive {
            Ok(archive) => archive.file(material, key)?,
            Err(why) => {
                if !opened.warned.swap(true, Ordering::Relaxed) {
                    progress.warn(&format!("{why}; the archive is not used"));
                }
                return None;
            }
        };
        let tell = |why: &String| {
            let folder = self.folder.display();
            progress
                .warn(&format!("{folder}/{material}.{EXTENSION}: {key}: {why}; simulated again"));
        };
        found.inspect_err(tell).ok()
    }

    /// Warns once in a process of a missing folder. A folder without an archive for a material is no fault.
    fn tell_if_missing(&self, progress: &dyn Progress) {
        static WARNED: AtomicBool = AtomicBool::new(false);
        if !self.folder.is_dir() && !WARNED.swap(true, Ordering::Relaxed) {
            let folder = self.folder.display();
            progress.warn(&format!(
                "{folder}: the folder does not exist, so no library is used; the environment variable {LIBRARY_VARIABLE} names this folder"
            ));
        }
    }

    /// Whether the library holds an image.
    pub(super) fn has(&self, material: &str, key: &str) -> bool {
        self.archive(material).is_some_and(|a| a.usable().is_some_and(|a| a.has(material, key)))
    }

    /// The notes of all images of a material.
    pub(super) fn notes(&self, material: &str) -> Vec<String> {
        let Some(opened) = self.archive(material) else { return Vec::new() };
        let Some(archive) = opened.usable() else { return Vec::new() };
        let note = |(material, key): (&str, &str)| {
            let file = archive.file(material, key)?.ok()?;
            array_store::note_of(&file).ok()
        };
        archive.names().filter_map(note).collect()
    }
}

impl Opened {
    fn usable(&self) -> Option<&Archive> {
        self.archive.as_ref().ok()
    }
}
