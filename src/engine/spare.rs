//! Work spaces that threads take turns with.

use std::sync::{Mutex, PoisonError};

/// Work spaces that are not in use. There are never more than threads, however finely work is split.
pub(super) struct Spare<T>(Mutex<Vec<T>>);

impl<T> Spare<T> {
    pub fn new() -> Self {
        Spare(Mutex::new(Vec::new()))
    }

    /// Calls `f` with a work space that nobody else has; `make` makes one where none is left.
    pub fn with<R>(&self, make: impl FnOnce() -> T, f: impl FnOnce(&mut T) -> R) -> R {
        let held = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let spare = held().pop();
        let mut workspace = spare.unwrap_or_else(make);
        let result = f(&mut workspace);
        held().push(workspace);
        result
    }
}
