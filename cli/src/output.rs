//! Paths and sizes of result files.

use std::path::{Path, PathBuf};

/// Replaces the ending of a path by `suffix`.
pub fn sibling(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(suffix);
    path.with_file_name(name)
}

/// Returns the size of a file in bytes; 0 if it is gone.
pub fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}
