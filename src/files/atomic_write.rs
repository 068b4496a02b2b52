//! Files that appear complete or not at all.

use super::unfinished::Unfinished;
use crate::error::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Prefix and suffix of the names of unfinished files.
const PREFIX: &str = ".stemgen-";
const SUFFIX: &str = ".partial";

/// Writes `bytes` to a temporary file beside `path`, syncs it and renames it to `path`, which it
/// replaces if it exists.
///
/// # Errors
/// [`Error::Io`] naming the directory or the file.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let (mut file, _unfinished) = beside(path)?;
    file.write_all(bytes).map_err(|e| Error::io(path, "write", e))?;
    file.as_file().sync_all().map_err(|e| Error::io(path, "write", e))?;
    file.persist(path).map_err(|e| Error::io(path, "create", e.error))?;
    sync_folder(path)
}

/// Lets `write` fill a temporary file beside `path`, whose path it receives, and then syncs and renames the file. An existing file is
/// replaced only if `overwrite` is set.
///
/// # Errors
/// [`Error::Io`], and errors of `write`.
pub(crate) fn write_with(
    path: &Path,
    overwrite: bool,
    write: impl FnOnce(&Path) -> Result<()>,
) -> Result<()> {
    let (file, _unfinished) = beside(path)?;
    write(file.path())?;
    file.as_file().sync_all().map_err(|e| Error::io(path, "write", e))?;
    let persisted = if overwrite { file.persist(path) } else { file.persist_noclobber(path) };
    persisted.map_err(|e| Error::io(path, "create", e.error))?;
    sync_folder(path)
}

/// Syncs the folder of a file that was moved into place, so that its name survives a power failure.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn sync_folder(path: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        let folder = super::outputs::folder(path);
        let sync = std::fs::File::open(folder).and_then(|f| f.sync_all());
        match sync {
            // Some file systems cannot sync folders.
            Err(e) if e.kind() != std::io::ErrorKind::InvalidInput => {
                return Err(Error::io(folder, "sync", e));
            }
            _ => {}
        }
    }
    #[cfg(not(unix))]
    let _ = path;
    Ok(())
}

/// Makes an empty temporary file in the directory of `path`.
fn beside(path: &Path) -> Result<(tempfile::NamedTempFile, Unfinished)> {
    let directory = super::outputs::folder(path);
    Unfinished::of(|| create(directory), tempfile::NamedTempFile::path)
        .map_err(|e| Error::io(directory, "create a file in", e))
}

/// Whether a path names an unfinished file that a killed writer has left.
pub(crate) fn is_leftover(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

fn create(directory: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // With this mode the umask applies; otherwise the file would stay private to its owner.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(directory)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_and_leaves_nothing_behind() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_target_that_is_a_directory_is_an_error_that_leaves_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("d");
        std::fs::create_dir(&path).unwrap();
        assert!(write(&path, b"one").is_err());
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
    }
}
