//! Moves a finished world, and the files that belong to it, to their final paths.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::files::atomic_write::sync_folder;
use crate::files::outputs::{PARTIAL, beside};
use crate::io::{WorldFile, WorldWriter};

/// A file that is made from a finished world and belongs to it, for example its picture. If a build ends before the file is complete, the
/// next run of the build makes it.
pub struct Companion<'a> {
    /// Final path of the file.
    pub path: &'a Path,
    /// Largest size on disk in bytes.
    pub most_bytes: u64,
    /// Writes the file to a temporary path beside its final path; it is moved when it is complete.
    pub write: &'a dyn Fn(&WorldFile, &Path) -> Result<()>,
}

/// Returns `path` with an ending that marks the file as unfinished.
pub fn partial(path: &Path) -> PathBuf {
    beside(path, PARTIAL)
}

/// Moves a complete file to its final path.
pub fn place(partial: &Path, path: &Path) -> Result<()> {
    fs::rename(partial, path).map_err(|e| Error::io(path, "write", e))?;
    sync_folder(path)
}

/// Writes a companion under another name and puts it in place when it is complete.
pub fn publish_companion(companion: &Companion, world: &Path) -> Result<()> {
    let partial = partial(companion.path);
    let write = || {
        (companion.write)(&WorldFile::open(world)?, &partial)?;
        let file = fs::File::open(&partial);
        file.and_then(|file| file.sync_all()).map_err(|e| Error::io(&partial, "write", e))
    };
    let placed = write().and_then(|()| place(&partial, companion.path));
    let _ = fs::remove_file(&partial);
    placed.map_err(|error| match error {
        // Users know the name that they gave, not the temporary one.
        Error::Io { path, action, source } if path == partial => {
            Error::io(companion.path, action, source)
        }
        error => error,
    })
}

/// Finds, before any work, errors that would keep a companion from being written at the end.
pub fn try_companion(companion: &Companion) -> Result<()> {
    let partial = partial(companion.path);
    let tried = fs::File::create(&partial).map_err(|e| Error::io(companion.path, "write", e));
    let _ = fs::remove_file(&partial);
    tried.map(drop)
}

/// Finds, before any work, errors that would keep the file from being written at the end: names that HDF5 does not take, names too long,
/// folders that may not be written.
pub fn try_partial(output: &Path) -> Result<()> {
    let partial = partial(output);
    let tried = WorldWriter::try_file(&partial);
    // If removing fails, the error of the trial matters more.
    let _ = fs::remove_file(&partial);
    tried
}
