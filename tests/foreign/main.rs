//! Files of strangers: whatever they hold, they are accepted or refused, without a panic, in time, and within memory.
//! Nothing outside of them is read.

mod allocation;
mod fuzz;
mod hdf5_files;
mod hdf5_process;
mod large_files;
mod mutation;
mod targets;

#[global_allocator]
static ALLOCATOR: allocation::Counting = allocation::Counting;
