//! Makes files, groups and attributes without times: the same input gives the same bytes whenever it is written.
//!
//! HDF5 records by default when a group was made and last changed; data sets of this crate's library have no times.

use std::path::Path;

use hdf5::types::VarLenUnicode;
use hdf5::{File, Group, H5Type};

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
