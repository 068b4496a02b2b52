//! Whether there is room on the disk for a result, asked before hours of work.

use crate::error::{Error, Result};
use std::path::Path;

/// The folder of a file.
fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Bytes that may still be written on the disk of an existing folder; unknown where the system does
/// not say.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let found = rustix::fs::statvfs(folder).ok()?;
        found.f_bavail.checked_mul(found.f_frsize)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

/// Fails if the disk of `output` has less than `needed_bytes` free. The folder has to exist.
///
/// # Errors
/// [`Error::DiskSpace`] naming the folder, what is needed and what is free.
pub fn check_space(output: &Path, needed_bytes: u64) -> Result<()> {
    let path = folder(output);
    match free_bytes(path) {
        Some(free_bytes) if free_bytes < needed_bytes => {
            Err(Error::DiskSpace { path: path.to_owned(), needed_bytes, free_bytes })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_found_before_writing() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("w.h5");
        check_space(&output, 1).unwrap();
        if free_bytes(folder.path()).is_none() {
            let line = "SKIPPED: the free space of the disk is unknown\n";
            // Not with `eprintln!`, which the test harness keeps to itself.
            return std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes()).unwrap();
        }
        let message = check_space(&output, 1 << 62).unwrap_err().to_string();
        assert!(message.contains(&folder.path().display().to_string()), "{message}");
        assert!(message.contains("needed") && message.contains("free"), "{message}");
    }
}
