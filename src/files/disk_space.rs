//! Checks, before hours of work, whether the disk has room for a result.

use super::outputs::folder;
use crate::error::{Error, Result};
use std::path::Path;

/// Returns the number of bytes that may still be written on the disk of an existing folder; `None` if the system does not report it.
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

/// Fails if the disk of `output` has less than `needed_bytes` free. The folder must exist.
///
/// # Errors
/// [`Error::DiskSpace`] with the folder and the needed and free bytes.
pub(crate) fn check_space(output: &Path, needed_bytes: u64) -> Result<()> {
    let path = folder(output);
    match free_bytes(path) {
        Some(free_bytes) if free_bytes < needed_bytes => {
            Err(Error::DiskSpace { path: path.to_owned(), needed_bytes, free_bytes })
        }
        _ => Ok(()),
    }
}

/// Fails if the disk of some places has less free space than these places need together: `needed` is a list of files or folders, of which
/// some may not exist yet, and bytes.
///
/// # Errors
/// [`Error::DiskSpace`] as [`check_space`].
pub(crate) fn check_places(needed: &[(&Path, u64)]) -> Result<()> {
    let mut disks: Vec<(Disk, &Path, u64)> = Vec::new();
    for (path, bytes) in needed {
        let there = existing(path);
        let disk = Disk::of(there);
        match disks.iter_mut().find(|(known, ..)| *known == disk) {
            Some((.., sum)) => *sum += bytes,
            None => disks.push((disk, there, *bytes)),
        }
    }
    for (_, there, needed_bytes) in disks {
        match free_bytes(there) {
            Some(free_bytes) if free_bytes < needed_bytes => {
                return Err(Error::DiskSpace { path: there.to_owned(), needed_bytes, free_bytes });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns the number of bytes that may still be written below a folder that may not exist yet; `None` if the system does not report it.
pub(crate) fn free_bytes_below(folder: &Path) -> Option<u64> {
    free_bytes(existing(folder))
}

/// Returns the nearest existing folder on the way to a path.
fn existing(path: &Path) -> &Path {
    let above = path.ancestors().filter(|p| !p.as_os_str().is_empty());
    above.into_iter().find(|p| p.is_dir()).unwrap_or(Path::new("."))
}

/// The file system of a folder.
#[derive(PartialEq)]
struct Disk(Option<u64>);

impl Disk {
    fn of(folder: &Path) -> Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            Disk(std::fs::metadata(folder).ok().map(|m| m.dev()))
        }
        #[cfg(not(unix))]
        {
            let _ = folder;
            Disk(None)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skipped() {
        let line = "SKIPPED: the free space of the disk is unknown\n";
        // `eprintln!` is not used, since the test harness captures it.
        std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes()).unwrap();
    }

    #[test]
    fn a_full_disk_is_found_before_writing() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("w.h5");
        check_space(&output, 1).unwrap();
        if free_bytes(folder.path()).is_none() {
            return skipped();
        }
        let message = check_space(&output, 1 << 62).unwrap_err().to_string();
        assert!(message.contains(&folder.path().display().to_string()), "{message}");
        assert!(message.contains("needed") && message.contains("free"), "{message}");
    }

    #[test]
    fn places_on_one_disk_are_counted_together() {
        let folder = tempfile::tempdir().unwrap();
        let Some(free) = free_bytes(folder.path()) else { return skipped() };
        let (a, b) = (folder.path().join("a.h5"), folder.path().join("new/er/cache"));
        let most = free / 3 * 2;
        check_places(&[(&a, most)]).unwrap();
        check_places(&[(&b, most)]).unwrap();
        assert!(check_places(&[(&a, most), (&b, most)]).is_err());
    }
}
