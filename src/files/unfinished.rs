//! Files that are of no use once their writer is gone, removed when a program is ended in the middle of its work.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // A set is whole even if another thread panicked while it held it.
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that is being written; known to [`remove_all`] until this is dropped.
#[derive(Debug)]
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// Has `make` make a file, and notes its path.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn of<T, E>(
        make: impl FnOnce() -> Result<T, E>,
        path: impl FnOnce(&T) -> &Path,
    ) -> Result<(T, Unfinished), E> {
        // Under the lock: no file is made that `remove_all` does not know.
        let mut all = unfinished();
        let made = make()?;
        let path = path(&made).to_owned();
        all.insert(path.clone());
        Ok((made, Unfinished(path)))
    }

    /// Notes a file that will be made at `path`.
    pub fn at(path: &Path) -> Self {
        unfinished().insert(path.to_owned());
        Unfinished(path.to_owned())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// Removes all unfinished files of this process, which has to end right after: threads that begin or end a file wait for ever.
pub fn remove_all() {
    let all = unfinished();
    for path in all.iter() {
        // Nobody is left to tell the failure to.
        let _ = fs::remove_file(path);
    }
    std::mem::forget(all);
}
