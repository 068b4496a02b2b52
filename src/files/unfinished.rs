//! Registers files that are useless once their writer ends; they are removed when the program is stopped in the middle of its work.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // The set is consistent even if another thread panicked while it held the lock.
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that is being written; [`remove_all`] removes it until this value is dropped.
#[derive(Debug)]
pub(crate) struct Unfinished(PathBuf);

impl Unfinished {
    /// Lets `make` make a file, and registers its path.
    ///
    /// # Errors
    /// Errors of `make`.
    pub(crate) fn of<T, E>(
        make: impl FnOnce() -> Result<T, E>,
        path: impl FnOnce(&T) -> &Path,
    ) -> Result<(T, Unfinished), E> {
        // `make` runs under the lock, so that no file exists that `remove_all` does not know.
        let mut all = unfinished();
        let made = make()?;
        let path = path(&made).to_owned();
        all.insert(path.clone());
        Ok((made, Unfinished(path)))
    }

    /// Registers a file that will be made at `path`.
    pub(crate) fn at(path: &Path) -> Self {
        unfinished().insert(path.to_owned());
        Unfinished(path.to_owned())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// Removes all unfinished files of this process, which must end right after: threads that register or release a file wait for ever.
pub fn remove_all() {
    let all = unfinished();
    for path in all.iter() {
        // The process ends, so a failure cannot be reported.
        let _ = fs::remove_file(path);
    }
    std::mem::forget(all);
}
