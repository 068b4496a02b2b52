//! Files and groups that hold no time of day: the same input gives the same bytes whenever it is written.
//!
//! HDF5 notes by default when a group was made and last changed; data sets of this crate's library do not.

use std::path::Path;

use hdf5::{File, Group};

/// An empty file in the place of any other.
pub(super) fn file(path: &Path) -> hdf5::Result<File> {
    File::with_options().with_create_plist(|list| list.obj_track_times(false)).create(path)
}

/// A group in a file or in another group.
pub(super) fn group(parent: &Group, name: &str) -> hdf5::Result<Group> {
    parent.create_group_builder().with_create_plist(|list| list.obj_track_times(false)).create(name)
}
