//! Files of other programs: readers of arrays and of recorded images, writers of TIFF and `.npz`.

pub mod arrays;
mod hdf5_axes;
mod length_units;
mod named_axes;
pub(crate) mod npz_file;
pub mod recorded;
pub(crate) mod tiff_file;
