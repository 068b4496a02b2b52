//! Files of strangers: whatever they hold, they are accepted or refused, without a panic, in time, and within memory.
//! Nothing outside of them is read.

mod allocation;
#[path = "../common/dm_bytes.rs"]
mod dm_bytes;
mod fuzz;
mod hdf5_files;
mod hdf5_process;
mod large_files;
mod mutation;
#[path = "../common/points.rs"]
mod points;
mod recorded_files;
#[path = "../common/skipped.rs"]
mod skipped;
mod targets;

#[global_allocator]
static ALLOCATOR: allocation::Counting = allocation::Counting;
