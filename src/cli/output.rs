//! Where results go.

use super::hints::hinted;
use anyhow::anyhow;
use std::path::{Path, PathBuf};
use stemgen::Error;

/// Refuses what could not be written at the end: folders, existing files, unwritable places. Makes
/// the folder if there is none.
pub fn check(path: &Path, overwrite: bool) -> anyhow::Result<()> {
    let refuse = |why| Err(Error::invalid(stemgen::Setting::Output, path.display(), why).into());
    if path.is_dir() {
        return refuse("is a folder; name a file in it");
    }
    if path.exists() && !overwrite {
        let fault = anyhow!("{} exists", path.display());
        return Err(hinted(fault, "--overwrite replaces it, --output names another file"));
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
    tempfile::tempfile_in(folder).map_err(|e| Error::io(folder, "create a file in", e))?;
    Ok(())
}

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
