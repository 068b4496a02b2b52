//! Puts a finished world, and the file that belongs to it, in their places.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::files::atomic_write::sync_folder;
use crate::files::outputs::{PARTIAL, beside};
use crate::io::{WorldFile, WorldWriter};

/// A file that is made from a finished world and belongs to it, such as its picture. A build that is ended before it is there goes on
/// with it.
pub struct Companion<'a> {
    /// Where it goes.
    pub path: &'a Path,
    /// What it takes on disk, at most.
    pub most_bytes: u64,
    /// Writes it to a path, which is another one beside its place: it gets its place when it is complete.
    pub write: &'a dyn Fn(&WorldFile, &Path) -> Result<()>,
}

/// `path` with an ending that tells that the file is not finished.
pub fn partial(path: &Path) -> PathBuf {
    beside(path, PARTIAL)
}

/// Puts a file that is complete in its place.
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
        // Users know the name that they gave.
        Error::Io { path, action, source } if path == partial => {
            Error::io(companion.path, action, source)
        }
        error => error,
    })
}

/// Finds before any work what would keep a companion from being written at the end.
pub fn try_companion(companion: &Companion) -> Result<()> {
    let partial = partial(companion.path);
    let tried = fs::File::create(&partial).map_err(|e| Error::io(companion.path, "write", e));
    let _ = fs::remove_file(&partial);
    tried.map(drop)
}

/// Finds before any work what would keep the file from being written at the end: names that HDF5 does not take, names too long,
/// folders that may not be written.
pub fn try_partial(output: &Path) -> Result<()> {
    let partial = partial(output);
    let tried = WorldWriter::try_file(&partial);
    // Whatever became of it: the reason of a failure matters more.
    let _ = fs::remove_file(&partial);
    tried
}
