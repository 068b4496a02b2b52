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
    arrays,
    npz_file::write_complex_npy,
    recorded,
    tiff_file::{TiffDepth, write_tiff},
};
// `self`, because a crate is called `hdf5` too.
#[cfg(feature = "hdf5")]
pub(crate) use self::hdf5::worlds::{
    recording_file::{RecordedImages, RecordingFile, SeriesPart, write_recording},
    truth_writer::{LineKind, TruthBatch, TruthWriter},
    world_writer::{Header, WorldWriter},
};
#[cfg(feature = "hdf5")]
pub use self::hdf5::{
    images::{
        hspy_file::{HspyFacts, create_hspy, write_hspy},
        image_file::{ExitWaves, ImageCounts, ImageStack, Origin, write_images},
        image_series::ImageSeries,
        stored_images::{ImageKind, StoredImage, StoredImages},
    },
    patterns::{
        pattern_file::{PatternFile, PatternHeader, data_bytes},
        pattern_format::PatternFormat,
        pattern_parts::{MadePart, PatternParts},
        pattern_run::{PatternRun, WrittenPatterns},
    },
    read_through,
    worlds::{
        schema,
        stack_truth::{DislocationRow, LayerRow},
        truth_writer::ParticleBatch,
        world_file::{GroundTruth, WorldFile},
        world_making::{RecordedSource, WorldMaking},
        world_metadata::WorldMetadata,
        world_truth::{BoundaryLine, WorldColumn},
    },
};
