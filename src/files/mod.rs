//! How results get to the disk: complete or not at all, by one process at a time, and with room for them.

pub mod atomic_write;
pub mod disk_space;
mod output_lock;

pub use output_lock::OutputLock;
