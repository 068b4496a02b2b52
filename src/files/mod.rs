//! How results get to the disk: complete or not at all, by one process at a time, with room for them, and checked when they
//! are read again.

pub mod array_store;
pub mod atomic_write;
pub mod disk_space;
pub mod file_digest;
mod output_lock;
mod output_set;
pub mod outputs;
mod shard;
pub mod unfinished;
pub mod whole_file;

pub use output_lock::OutputLock;
pub use output_set::OutputSet;
pub use shard::Shard;
