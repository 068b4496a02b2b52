//! Files of images and worlds (HDF5; their schemas are defined only here) and of their atoms.
//!
//! All that needs HDF5 is in `hdf5`; readers and writers of other programs' files are in `foreign` (feature `report`).

pub mod atom_type;
mod atoms_file;
#[cfg(feature = "report")]
mod foreign;
#[cfg(feature = "hdf5")]
mod hdf5;

pub use atoms_file::writable;
pub(crate) use atoms_file::{AtomRow, AtomsHeader, AtomsWriter, RowFormat};
#[cfg(feature = "report")]
pub(crate) use foreign::npz_file::write_npz;
#[cfg(feature = "report")]
pub use foreign::{
    arrays, recorded,
    tiff_file::{TiffDepth, write_tiff},
};
// `self`, because a crate is called `hdf5` too.
#[cfg(feature = "hdf5")]
pub(crate) use self::hdf5::worlds::{
    recording_file::{RecordingFile, SeriesPart, write_recording},
    truth_writer::{LineKind, TruthBatch, TruthWriter},
    world_writer::{Header, WorldWriter},
};
#[cfg(feature = "hdf5")]
pub use self::hdf5::{
    images::hspy_file::HspyFacts, images::hspy_file::create_hspy, images::hspy_file::write_hspy,
    images::image_file::ExitWaves, images::image_file::ImageCounts, images::image_file::ImageStack,
    images::image_file::Origin, images::image_file::write_images,
    images::image_series::ImageSeries, images::stored_images::ImageKind,
    images::stored_images::StoredImage, images::stored_images::StoredImages,
    patterns::pattern_file::PatternFile, patterns::pattern_file::PatternHeader,
    patterns::pattern_file::data_bytes, patterns::pattern_format::PatternFormat,
    patterns::pattern_run::PatternRun, patterns::pattern_run::WrittenPatterns, read_through,
    worlds::schema, worlds::stack_truth::DislocationRow, worlds::stack_truth::LayerRow,
    worlds::truth_writer::ParticleBatch, worlds::world_file::GroundTruth,
    worlds::world_file::WorldFile, worlds::world_making::RecordedSource,
    worlds::world_making::WorldMaking, worlds::world_metadata::WorldMetadata,
    worlds::world_truth::BoundaryLine, worlds::world_truth::WorldColumn,
};
