//! Makes files, groups and attributes without times: the same input gives the same bytes whenever it is written.
//!
//! HDF5 records by default when a group was made and last changed; data sets of this crate's library have no times.

use std::path::Path;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, H5Type};
use hdf5_sys::h5d::H5Dwrite_chunk;
use hdf5_sys::h5p::H5P_DEFAULT;

/// Makes an empty file, which replaces an existing one.
pub(crate) fn file(path: &Path) -> hdf5::Result<File> {
    File::with_options().with_create_plist(|list| list.obj_track_times(false)).create(path)
}

/// Makes a group in a file or in another group.
pub(crate) fn group(parent: &Group, name: &str) -> hdf5::Result<Group> {
    parent.create_group_builder().with_create_plist(|list| list.obj_track_times(false)).create(name)
}

/// Makes an attribute that holds one value.
pub(crate) fn number<T: H5Type>(at: &hdf5::Location, name: &str, value: T) -> hdf5::Result<()> {
    at.new_attr::<T>().create(name)?.write_scalar(&value)
}

/// Makes an attribute that holds a text.
pub(crate) fn text(at: &hdf5::Location, name: &str, value: &str) -> hdf5::Result<()> {
    let value: VarLenUnicode =
        value.parse().map_err(|_| hdf5::Error::Internal(format!("`{name}` holds a NUL")))?;
    number(at, name, value)
}

/// Writes the bytes of the only chunk of a dataset, which are packed with all its filters.
pub(crate) fn packed_chunk(dataset: &Dataset, bytes: &[u8]) -> hdf5::Result<()> {
    let origin: Vec<u64> = vec![0; dataset.ndim()];
    // SAFETY: `origin` has a number for each axis of the dataset, and the library reads as many bytes as there are.
    let write = || unsafe {
        let from = bytes.as_ptr().cast();
        H5Dwrite_chunk(dataset.id(), H5P_DEFAULT, 0, origin.as_ptr(), bytes.len(), from)
    };
    // The library keeps the reason of an error until its next call.
    hdf5::sync::sync(|| match write() < 0 {
        true => Err(hdf5::Error::query().unwrap_or_else(|other| other)),
        false => Ok(()),
    })
}
