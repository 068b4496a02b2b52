//! Opens HDF5 files for reading, also while another program finishes writing them.

use std::path::Path;
use std::time::{Duration, Instant};

use hdf5::File;

use super::hdf5_guard::first_line;
use crate::error::{Error, Result};

/// Longest wait for a lock. HDF5 locks the files that it writes, and a process that another thread starts at that moment inherits the lock.
const LOCK_PATIENCE: Duration = Duration::from_secs(5);

/// Opens a file for reading, and waits for a lock that another program holds on it.
pub(crate) fn open(path: &Path) -> hdf5::Result<File> {
    let start = Instant::now();
    loop {
        match File::open(path) {
            Err(e) if is_locked(&e) && start.elapsed() < LOCK_PATIENCE => {
                std::thread::sleep(Duration::from_millis(20));
            }
            result => return result,
        }
    }
}

/// Opens a file that may be no HDF5; `None` if it is none. The reader of another kind of file reports what is wrong with it.
///
/// # Errors
/// [`Error::Parse`] for a file that another program writes.
pub(crate) fn open_if_hdf5(path: &Path) -> Result<Option<File>> {
    match open(path) {
        Ok(file) => Ok(Some(file)),
        Err(e) if is_locked(&e) => Err(Error::parse(path, 0, reason(&e, ""))),
        Err(_) => Ok(None),
    }
}

/// Whether a file did not open because another program writes it.
fn is_locked(error: &hdf5::Error) -> bool {
    error.to_string().contains("unable to lock file")
}

/// Returns the reason why a file did not open: that it is locked, or `otherwise`; and the library's message.
pub(crate) fn reason(error: &hdf5::Error, otherwise: &str) -> String {
    let reason = if is_locked(error) {
        "is locked by another program that writes it; try again when that has ended"
    } else {
        otherwise
    };
    format!("{reason} ({})", first_line(error))
}

/// Returns the size of a file that is neither a folder nor a device: reading a pipe would wait for its writer.
pub(crate) fn regular_file(path: &Path) -> Result<u64> {
    let about = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if about.is_file() {
        std::fs::File::open(path).map_err(|e| Error::io(path, "read", e))?;
        return Ok(about.len());
    }
    let kind = if about.is_dir() { "a folder" } else { "no regular file" };
    Err(Error::parse(path, 0, format!("is {kind}; expected an HDF5 file")))
}
