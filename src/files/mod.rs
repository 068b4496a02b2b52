//! Writes results to disk: completely or not at all, by one process at a time, with a check of free space, and with digests that are
//! checked on reading.

pub mod array_store;
pub mod atomic_write;
pub(crate) mod disk_space;
pub(crate) mod file_digest;
mod output_lock;
mod output_set;
pub mod outputs;
mod shard;
pub mod unfinished;
pub(crate) mod whole_file;

pub use disk_space::free_bytes;
pub use file_digest::sha256_of_file;
pub use output_lock::OutputLock;
pub use output_set::OutputSet;
pub use shard::Shard;
pub use whole_file::read_text;
