//! Files of strangers: whatever they hold, they are accepted or refused, without a panic, in time, and within memory.
//! Nothing outside of them is read.

mod allocation;
mod fuzz;
mod hdf5_files;
#[path = "../common/python.rs"]
mod interpreter;
mod large_files;
mod mutation;
#[path = "../common/skipped.rs"]
mod skipped;
mod targets;

#[global_allocator]
static ALLOCATOR: allocation::Counting = allocation::Counting;
