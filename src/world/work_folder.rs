//! The work folder of a build, `<output>.work`: finished sub-tiles, library and audits, from which an interrupted build continues.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::build_summary::BuildSummary;
use super::footprint;
use super::subtile_store::SubtileStore;
use crate::error::{Error, Result};
use crate::files::outputs::work_folder;
use crate::files::outputs::{LOCK, beside};
use crate::files::{OutputLock, atomic_write};
use crate::imaging::{Cache, KeptAudits};
use crate::progress::Progress;

/// File that marks the world as complete.
const COMPLETE_FILE: &str = "complete.json";

/// The work folder of a build, `<output>.work`.
#[derive(Debug, Clone)]
pub struct WorkFolder {
    output: PathBuf,
    folder: PathBuf,
}

/// Contents of [`COMPLETE_FILE`].
#[derive(Serialize, Deserialize)]
struct Complete {
    /// Recipe, options and version that were built.
    request: String,
    /// SHA-256 of the world.
    sha256: String,
    summary: BuildSummary,
}

impl WorkFolder {
    /// Returns the work folder of an output; it need not exist.
    pub fn of(output: &Path) -> Self {
        WorkFolder { output: output.to_owned(), folder: work_folder(output) }
    }

    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Creates the folder.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(&self) -> Result<()> {
        fs::create_dir_all(&self.folder).map_err(|e| Error::io(&self.folder, "create", e))
    }

    /// Removes the folder if it is empty.
    pub fn remove_if_empty(&self) {
        let _ = fs::remove_dir(&self.folder);
    }

    /// Counts the bytes in the folder.
    pub fn bytes(&self) -> u64 {
        footprint::folder_bytes(&self.folder)
    }

    /// Returns the folder for simulations of the library that the cache cannot keep.
    pub fn library(&self) -> PathBuf {
        self.folder.join("library")
    }

    pub fn audits(&self) -> KeptAudits {
        KeptAudits::at(self.folder.join("audits"))
    }

    /// Opens the sub-tiles of the build that `key` describes; with `replace` sub-tiles of another build are removed.
    ///
    /// # Errors
    /// As [`SubtileStore::open`].
    pub fn subtiles(
        &self,
        key: &str,
        replace: bool,
        progress: &dyn Progress,
    ) -> Result<SubtileStore> {
        SubtileStore::open(&self.output, key, replace, progress)
    }

    /// Records that `world`, not yet at its final path, is the complete result of `request`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn complete(&self, world: &Path, request: &str, summary: &BuildSummary) -> Result<()> {
        let sha256 = digest(world).map_err(|e| Error::io(world, "read", e))?;
        let complete = Complete { request: request.to_owned(), sha256, summary: summary.clone() };
        let path = self.folder.join(COMPLETE_FILE);
        let text = serde_json::to_string(&complete)
            .map_err(|e| Error::io(&path, "write", io::Error::other(e)))?;
        atomic_write::write(&path, text.as_bytes())
    }

    /// Returns the summary of an earlier run if `output` is the world of this request; only the steps after the world may then be missing.
    pub fn completed(&self, request: &str) -> Option<BuildSummary> {
        let text = fs::read_to_string(self.folder.join(COMPLETE_FILE)).ok()?;
        let complete: Complete = serde_json::from_str(&text).ok()?;
        let same = complete.request == request && digest(&self.output).ok()? == complete.sha256;
        same.then(|| BuildSummary { path: self.output.clone(), ..complete.summary })
    }

    /// Refuses a file at the path of an unfinished file of this build, unless an interrupted run has left it.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check_partial(&self, partial: &Path) -> Result<()> {
        let there = fs::symlink_metadata(partial);
        // An unfinished file written through a link would land elsewhere, and no run leaves a link.
        let link = there.as_ref().is_ok_and(|there| !there.is_file());
        if there.is_err() || (self.folder.is_dir() && !link) {
            return Ok(());
        }
        let expected = "the unfinished file needs this place, but it holds something else; move that, or name another file";
        Err(Error::invalid(crate::Setting::Output, partial.display(), expected))
    }

    /// Removes the contents of a build, and the folder if nothing else lies there.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove(&self) -> Result<()> {
        Cache::at(self.library()).clear(None)?;
        // A folder that holds other files stays.
        let _ = fs::remove_dir(self.library());
        self.audits().clear()?;
        SubtileStore::clear(&self.folder)?;
        // This file is removed last: while it is there, the world counts as finished and is not refused.
        let complete = self.folder.join(COMPLETE_FILE);
        match fs::remove_file(&complete) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => {
                return Err(Error::io(&complete, "remove", e));
            }
            _ => {}
        }
        self.remove_if_empty();
        Ok(())
    }
}

/// Removes the empty work folder and the lock that a run leaves beside a complete world if it ends in its last steps. Both stay where
/// another process holds the lock.
pub fn remove_leftovers(output: &Path) {
    let work = WorkFolder::of(output);
    if !work.path().exists() && !beside(output, LOCK).exists() {
        return;
    }
    if let Ok(_lock) = OutputLock::hold(output) {
        work.remove_if_empty();
    }
}

fn digest(path: &Path) -> io::Result<String> {
    let (mut file, mut hasher) = (File::open(path)?, Sha256::new());
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(hasher.finalize().iter().map(|b| format!("{b:02x}")).collect()),
            n => hasher.update(&buffer[..n]),
        }
    }
}
