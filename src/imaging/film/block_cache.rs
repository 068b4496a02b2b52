//! What was made of the blocks of a field last, for rectangles that share them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};

use crate::error::Result;

/// Number of a block along y and x, and of phonon configurations.
pub type BlockKey = ([i64; 2], usize);

/// Keeps the last `most` blocks.
pub struct BlockCache<T> {
    most: usize,
    kept: Mutex<KeptBlocks<T>>,
}

struct KeptBlocks<T> {
    blocks: BTreeMap<BlockKey, T>,
    order: VecDeque<BlockKey>,
}

impl<T: Clone> BlockCache<T> {
    pub fn new(most: usize) -> Self {
        let kept = KeptBlocks { blocks: BTreeMap::new(), order: VecDeque::new() };
        BlockCache { most, kept: Mutex::new(kept) }
    }

    /// The block of this key; `make` makes it where it was not kept.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn get(&self, key: BlockKey, make: impl FnOnce() -> Result<T>) -> Result<T> {
        let kept = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = kept().blocks.get(&key) {
            return Ok(found.clone());
        }
        // Not under the lock: two threads may make the same block, and get the same.
        let made = make()?;
        let mut kept = kept();
        if kept.blocks.insert(key, made.clone()).is_none() {
            kept.order.push_back(key);
        }
        if kept.order.len() > self.most
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.blocks.remove(&oldest);
        }
        Ok(made)
    }
}
