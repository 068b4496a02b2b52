//! Work spaces that threads take turns with.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Work spaces that are not in use. There are never more than threads, however finely work is split.
pub(super) struct Spare<T>(Mutex<Vec<T>>);

impl<T> Spare<T> {
    pub fn new() -> Self {
        Spare(Mutex::new(Vec::new()))
    }

    /// Calls `f` with a work space that nobody else has; `make` makes one where none is left.
    pub fn with<R>(&self, make: impl FnOnce() -> T, f: impl FnOnce(&mut T) -> R) -> R {
        let mut workspace = self.take(make);
        let result = f(&mut workspace);
        self.give([workspace]);
        result
    }

    /// Takes a work space out; `make` makes one where none is left.
    pub fn take(&self, make: impl FnOnce() -> T) -> T {
        let spare = self.held().pop();
        spare.unwrap_or_else(make)
    }

    /// Gives work spaces back.
    pub fn give(&self, workspaces: impl IntoIterator<Item = T>) {
        self.held().extend(workspaces);
    }

    fn held(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
