//! Values that are made at the first request and kept.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::atomic::{AtomicUsize, Ordering};
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
        match self.find(&key) {
            Some(found) => Ok(found),
            None => Ok(self.keep(key, Arc::new(make()?))),
        }
    }

    fn find(&self, key: &K) -> Option<Arc<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(key).map(Arc::clone)
    }

    /// Keeps a value unless the key has one, and returns the key's value.
    fn keep(&self, key: K, made: Arc<T>) -> Arc<T> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(kept.entry(key).or_insert(made))
    }
}

/// Values by key, each made at its first request, and kept while there is room for it.
pub(crate) struct KeptWithin<K, T> {
    kept: MadeOnce<K, T>,
    /// Bytes that are left.
    room: AtomicUsize,
}

impl<K: Eq + Hash, T> KeptWithin<K, T> {
    pub fn new(room_bytes: usize) -> Self {
        KeptWithin { kept: MadeOnce::default(), room: AtomicUsize::new(room_bytes) }
    }

    /// The value of a key, of `bytes`, from `make` if it is not kept.
    pub fn get(&self, key: K, bytes: usize, make: impl FnOnce() -> T) -> Arc<T> {
        if let Some(found) = self.kept.find(&key) {
            return found;
        }
        let made = Arc::new(make());
        let smaller = |room: usize| room.checked_sub(bytes);
        if self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, smaller).is_err() {
            return made;
        }
        self.kept.keep(key, made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_kept_while_there_is_room() {
        let kept = KeptWithin::<u8, u32>::new(10);
        assert_eq!((*kept.get(1, 6, || 1), *kept.get(2, 6, || 2)), (1, 2));
        assert_eq!((*kept.get(1, 6, || 3), *kept.get(2, 6, || 4)), (1, 4));
        assert_eq!((*kept.get(3, 4, || 5), *kept.get(3, 4, || 6)), (5, 5));
    }

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
