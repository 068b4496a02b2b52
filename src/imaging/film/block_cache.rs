//! A cache of the most recent blocks of a field, for rectangles that share blocks.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::error::Result;

/// Number of a block along y and x, and the number of phonon configurations.
pub type BlockKey = ([i64; 2], usize);

/// Keeps the last `most` blocks.
pub struct BlockCache<T> {
    most: usize,
    kept: Mutex<KeptBlocks<T>>,
}

struct KeptBlocks<T> {
    /// Blocks, each with a mark: `true` if its atoms may have changed.
    blocks: BTreeMap<BlockKey, (T, bool)>,
    order: VecDeque<BlockKey>,
}

impl<T: Clone> BlockCache<T> {
    pub fn new(most: usize) -> Self {
        let kept = KeptBlocks { blocks: BTreeMap::new(), order: VecDeque::new() };
        BlockCache { most, kept: Mutex::new(kept) }
    }

    /// The block of a key. `make` makes it if it is not in the cache, or if its atoms may have changed.
    ///
    /// # Errors
    /// Errors of `make`.
    pub fn get(&self, key: BlockKey, make: impl FnOnce() -> Result<T>) -> Result<T> {
        self.get_unless_changed(key, |_| false, make)
    }

    /// As [`BlockCache::get`], but a block whose atoms may have changed stays if `holds` finds that they have not.
    ///
    /// # Errors
    /// Errors of `make`.
    pub fn get_unless_changed(
        &self,
        key: BlockKey,
        holds: impl FnOnce(&T) -> bool,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let found = self.kept().blocks.get(&key).cloned();
        // The lock is not held here. Two threads may make a block at once; they get equal ones.
        let made = match found {
            Some((found, false)) => return Ok(found),
            Some((found, true)) if holds(&found) => found,
            _ => make()?,
        };
        let mut kept = self.kept();
        if kept.blocks.insert(key, (made.clone(), false)).is_none() {
            kept.order.push_back(key);
        }
        if kept.order.len() > self.most
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.blocks.remove(&oldest);
        }
        Ok(made)
    }

    /// Marks the blocks for whose number `concerned` is true as stale: their atoms may have changed.
    pub fn mark_stale(&self, concerned: impl Fn([i64; 2]) -> bool) {
        for ((index, _), (_, stale)) in &mut self.kept().blocks {
            *stale |= concerned(*index);
        }
    }

    fn kept(&self) -> MutexGuard<'_, KeptBlocks<T>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stale_blocks_are_made_again_unless_they_hold() {
        let cache = BlockCache::new(2);
        let get = |n: i64, value: i64, holds: bool| {
            cache.get_unless_changed(([n, 0], 1), |_| holds, || Ok(value)).unwrap()
        };
        assert_eq!([get(0, 1, false), get(1, 2, false)], [1, 2]);
        cache.mark_stale(|index| index == [0, 0]);
        assert_eq!([get(0, 3, true), get(1, 4, false)], [1, 2]);
        cache.mark_stale(|index| index == [0, 0]);
        assert_eq!([get(0, 5, false), get(1, 6, false)], [5, 2]);
        assert_eq!([get(0, 7, false), cache.get(([1, 0], 1), || Ok(8)).unwrap()], [5, 2]);
        // a third one takes the place of the first
        assert_eq!([get(2, 9, false), get(0, 10, false)], [9, 10]);
    }
}
