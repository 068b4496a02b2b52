//! Files of images and worlds (HDF5; their schemas are defined only here) and of their atoms.

#[cfg(feature = "report")]
pub mod arrays;
pub mod atom_type;
mod atoms_file;
#[cfg(feature = "report")]
mod hdf5_axes;
#[cfg(feature = "hdf5")]
mod hdf5_create;
#[cfg(feature = "hdf5")]
mod hdf5_errors;
#[cfg(feature = "hdf5")]
mod hdf5_filters;
#[cfg(feature = "hdf5")]
mod hdf5_guard;
#[cfg(feature = "hdf5")]
mod hdf5_look;
#[cfg(feature = "hdf5")]
mod hdf5_open;
#[cfg(feature = "hdf5")]
mod hdf5_values;
#[cfg(feature = "hdf5")]
pub mod hspy_file;
#[cfg(feature = "hdf5")]
mod hspy_patterns;
#[cfg(feature = "hdf5")]
pub mod image_file;
#[cfg(feature = "hdf5")]
pub mod image_series;
#[cfg(feature = "report")]
mod length_units;
#[cfg(feature = "report")]
mod named_axes;
#[cfg(feature = "report")]
pub mod npz_file;
#[cfg(feature = "hdf5")]
pub mod pattern_file;
#[cfg(feature = "hdf5")]
pub mod pattern_format;
#[cfg(feature = "hdf5")]
pub mod pattern_run;
#[cfg(feature = "hdf5")]
mod raw_patterns;
#[cfg(feature = "report")]
pub mod recorded;
#[cfg(feature = "hdf5")]
pub mod recording_file;
#[cfg(feature = "hdf5")]
pub mod schema;
#[cfg(feature = "hdf5")]
mod stack_truth;
#[cfg(feature = "hdf5")]
mod stored_images;
#[cfg(feature = "report")]
pub mod tiff_file;
#[cfg(feature = "hdf5")]
mod truth_writer;
#[cfg(feature = "hdf5")]
mod world_contents;
#[cfg(feature = "hdf5")]
mod world_detectors;
#[cfg(feature = "hdf5")]
mod world_file;
#[cfg(feature = "hdf5")]
mod world_making;
#[cfg(feature = "hdf5")]
mod world_metadata;
#[cfg(feature = "hdf5")]
mod world_truth;
#[cfg(feature = "hdf5")]
mod world_types;
#[cfg(feature = "hdf5")]
mod world_writer;

pub use atoms_file::{AtomRow, AtomsHeader, AtomsWriter, RowFormat, writable};
#[cfg(feature = "hdf5")]
use hdf5_errors::At;
#[cfg(feature = "hdf5")]
pub use hdf5_look::read_through;
#[cfg(feature = "hdf5")]
pub use stack_truth::{DislocationRow, LayerRow};
#[cfg(feature = "hdf5")]
pub use stored_images::{ImageKind, StoredImage, StoredImages};
#[cfg(feature = "hdf5")]
pub use truth_writer::{LineKind, ParticleBatch, TruthBatch, TruthWriter};
#[cfg(feature = "report")]
use world_file::regular_file;
#[cfg(feature = "hdf5")]
pub use world_file::{GroundTruth, WorldFile};
#[cfg(feature = "hdf5")]
pub use world_making::{RecordedSource, WorldMaking};
#[cfg(feature = "hdf5")]
pub use world_metadata::WorldMetadata;
#[cfg(feature = "hdf5")]
pub use world_truth::{BoundaryLine, WorldColumn};
#[cfg(feature = "hdf5")]
pub use world_writer::{Header, WorldWriter};
