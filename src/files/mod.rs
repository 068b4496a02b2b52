//! Files and folders: complete or not at all, one writer at a time, checked when read.

pub mod array_store;
