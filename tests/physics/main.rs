//! Images, against other programs, published numbers and each other, and what they are made of: atoms, optics, detectors, recordings.

mod accuracy;
mod acquisition;
mod carbon;
#[cfg(feature = "hdf5")]
#[path = "../common/mod.rs"]
mod common;
#[cfg(feature = "hdf5")]
mod contamination;
mod crystals;
#[cfg(feature = "hdf5")]
mod detector_response;
mod engines;
#[cfg(feature = "report")]
mod golden;
#[cfg(feature = "hdf5")]
mod numerics;
mod optics;
mod particles;
mod read_right;
mod settings;
mod structure_files;
mod surface;
#[cfg(feature = "report")]
mod validate;
