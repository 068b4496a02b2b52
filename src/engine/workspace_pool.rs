//! A pool of work spaces that threads share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The work spaces that no thread uses at the moment. There are never more than threads, however finely the work is divided.
pub(super) struct WorkspacePool<T>(Mutex<Vec<T>>);

impl<T> WorkspacePool<T> {
    pub fn new() -> Self {
        WorkspacePool(Mutex::new(Vec::new()))
    }

    /// Calls `f` with a work space for this thread alone; `make` makes one if none is free.
    pub fn with<R>(&self, make: impl FnOnce() -> T, f: impl FnOnce(&mut T) -> R) -> R {
        let mut workspace = self.take(make);
        let result = f(&mut workspace);
        self.give([workspace]);
        result
    }

    /// Takes a work space out; `make` makes one if none is free.
    pub fn take(&self, make: impl FnOnce() -> T) -> T {
        let free = self.free().pop();
        free.unwrap_or_else(make)
    }

    /// Returns work spaces to the pool.
    pub fn give(&self, workspaces: impl IntoIterator<Item = T>) {
        self.free().extend(workspaces);
    }

    fn free(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
