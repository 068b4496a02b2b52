//! Files of strangers: whatever they hold, they are accepted or refused, without a panic, in time, and within memory.
//! Nothing outside of them is read.

mod allocation;
mod hdf5_files;

#[global_allocator]
static ALLOCATOR: allocation::Counting = allocation::Counting;
