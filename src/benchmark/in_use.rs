//! Shared values, kept alive only while somebody uses them (weak references).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// A list of shared values by key. A value that nobody uses any more is made anew.
#[derive(Debug)]
pub struct InUse<K, T>(Mutex<Vec<(K, Weak<T>)>>);

impl<K, T> Default for InUse<K, T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<K, T> InUse<K, T> {
    /// Makes an empty list.
    pub const fn new() -> Self {
        InUse(Mutex::new(Vec::new()))
    }

    fn all(&self) -> MutexGuard<'_, Vec<(K, Weak<T>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: PartialEq, T> InUse<K, T> {
    /// Returns the value of a key that is in use, or else the value that `make` makes. Two simultaneous calls with one key may each make
    /// one.
    ///
    /// # Errors
    /// Errors of `make`.
    pub fn get<E>(&self, key: K, make: impl FnOnce() -> Result<T, E>) -> Result<Arc<T>, E> {
        let alive = |(other, it): &(K, Weak<T>)| (*other == key).then(|| it.upgrade()).flatten();
        let found = self.all().iter().find_map(alive);
        if let Some(found) = found {
            return Ok(found);
        }
        let made = Arc::new(make()?);
        let mut all = self.all();
        all.retain(|(_, it)| it.strong_count() > 0);
        all.push((key, Arc::downgrade(&made)));
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_somebody_has_is_not_made_again() {
        let list = InUse::<u64, u64>::new();
        let get = |key, value| list.get(key, || Ok::<_, ()>(value)).unwrap();
        let first = get(1, 10);
        assert_eq!(*get(1, 11), 10);
        assert_eq!(*get(2, 20), 20);
        drop(first);
        assert_eq!(*get(1, 12), 12);
        assert_eq!(list.get(3, || Err("no")), Err("no"));
        assert_eq!(list.all().len(), 1, "dropped ones leave");
    }
}
