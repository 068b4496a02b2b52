//! Makes files and groups without times: the same input gives the same bytes whenever it is written.
//!
//! HDF5 records by default when a group was made and last changed; data sets of this crate's library have no times.

use std::path::Path;

use hdf5::{File, Group};

/// Makes an empty file, which replaces an existing one.
pub(super) fn file(path: &Path) -> hdf5::Result<File> {
    File::with_options().with_create_plist(|list| list.obj_track_times(false)).create(path)
}

/// Makes a group in a file or in another group.
pub(super) fn group(parent: &Group, name: &str) -> hdf5::Result<Group> {
    parent.create_group_builder().with_create_plist(|list| list.obj_track_times(false)).create(name)
}
