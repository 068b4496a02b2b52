//! Where results go.

use std::path::{Path, PathBuf};

/// The path with `suffix` in place of its ending.
pub fn sibling(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(suffix);
    path.with_file_name(name)
}

/// Size of a file in bytes; 0 if it is gone.
pub fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}
