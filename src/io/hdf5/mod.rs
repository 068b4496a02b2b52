//! HDF5: access to files that may be damaged or locked, and the files of [`images`], [`patterns`] and [`worlds`].

mod hdf5_create;
mod hdf5_errors;
mod hdf5_filters;
pub(crate) mod hdf5_guard;
mod hdf5_look;
pub(crate) mod hdf5_open;
pub(crate) mod hdf5_values;
pub(crate) mod images;
pub(crate) mod patterns;
pub(crate) mod worlds;

pub(crate) use hdf5_errors::At;
pub use hdf5_look::read_through;
