//! The `stemgen` program.

fn main() {}
