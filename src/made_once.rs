//! Values that are made at the first request and kept.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, PoisonError};

/// Values by key, each made at its first request. No value is ever dropped, so this is for few keys.
pub(crate) struct MadeOnce<K, T>(Mutex<HashMap<K, Arc<T>>>);

impl<K, T> Default for MadeOnce<K, T> {
    fn default() -> Self {
        MadeOnce(Mutex::default())
    }
}

impl<K: Eq + Hash, T> MadeOnce<K, T> {
    /// The value of a key, from `make` if there is none. Two simultaneous requests may both make it; both get the value that was there
    /// first. No lock is held meanwhile, because a lock held during work in threads would wait for itself.
    ///
    /// # Errors
    /// Errors of `make`. The next request calls `make` again.
    pub fn get<E>(&self, key: K, make: impl FnOnce() -> Result<T, E>) -> Result<Arc<T>, E> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = lock().get(&key).map(Arc::clone);
        if let Some(found) = found {
            return Ok(found);
        }
        let made = Arc::new(make()?);
        Ok(Arc::clone(lock().entry(key).or_insert(made)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_made_once_and_failures_again() {
        let kept = MadeOnce::<u8, u32>::default();
        assert_eq!(kept.get(1, || Err("not now")), Err("not now"));
        assert_eq!(kept.get(1, || Ok::<_, ()>(10)), Ok(Arc::new(10)));
        assert_eq!(kept.get(1, || Err(())), Ok(Arc::new(10)));
        assert_eq!(kept.get(2, || Ok::<_, ()>(20)), Ok(Arc::new(20)));
    }

    #[test]
    fn making_one_may_ask_for_another() {
        let kept = MadeOnce::<u8, u32>::default();
        let sum = kept.get(2, || kept.get(1, || Ok::<_, ()>(1)).map(|one| *one + 1));
        assert_eq!(sum, Ok(Arc::new(2)));
    }
}
