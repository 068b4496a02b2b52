//! Reads through a whole HDF5 file, for a process that the file may crash.

use std::path::Path;

use hdf5::Location;

use super::hdf5_guard::{
    MOST_TEXTS, any_text, any_texts, check_storage, damaged, first_line, number, pair, scale_paths,
    texts, walk,
};
use super::hdf5_open::{self, regular_file};
use super::hdf5_values;
use crate::error::{Error, Result};

/// Makes the library read everything of a file that it reads for this program, except the values of chunks: groups, datasets, attributes,
/// and the places of the values. For some damaged files the library does not return (1.10.8 hangs, crashes or takes all memory). A process
/// that calls this function before another opens the file finds such files.
///
/// # Errors
/// [`Error::Io`], or [`Error::Parse`] for a file that is refused.
pub fn read_through(path: &Path) -> Result<()> {
    let bytes = regular_file(path)?;
    let refused = |fault: String| Error::parse(path, 0, fault);
    let file = hdf5_open::open(path).map_err(|e| refused(first_line(&e)))?;
    let walk = walk(&file).map_err(refused)?;
    for name in std::iter::once("/").chain(walk.groups.iter().map(String::as_str)) {
        let group = file.group(name).map_err(|e| refused(damaged(e)))?;
        read_attributes(&group);
    }
    for name in &walk.datasets {
        // A dataset that cannot be read may be one that nobody needs.
        let Ok(dataset) = file.dataset(name) else { continue };
        read_attributes(&dataset);
        let stored = check_storage(&dataset, bytes);
        // Asking a virtual dataset for its shape opens other files.
        if stored.is_ok() {
            let _ = scale_paths(&dataset);
        }
        let _ = stored.and_then(|()| hdf5_values::look_through(&dataset, path));
    }
    Ok(())
}

/// Reads the attributes of an object in every way that the program uses. Their values are ignored here.
fn read_attributes(at: &Location) {
    for name in at.attr_names().unwrap_or_default() {
        let _ = (number::<f64>(at, &name), pair(at, &name), any_text(at, &name));
        let count = at.attr(&name).map_or(0, |a| a.size());
        if count <= MOST_TEXTS {
            let _ = (texts(at, &name, count), any_texts(at, &name, count));
        }
    }
}
