//! Files of images and worlds (HDF5; their schemas are defined only here) and of their atoms.
//!
//! All that needs HDF5 is in `hdf5`; readers and writers of other programs' files are in `foreign` (feature `report`).

pub mod atom_type;
mod atoms_file;
#[cfg(feature = "report")]
mod foreign;
#[cfg(feature = "hdf5")]
mod hdf5;

pub use atoms_file::{AtomRow, AtomsHeader, AtomsWriter, RowFormat, writable};
#[cfg(feature = "report")]
pub(crate) use foreign::npz_file::write_npz;
#[cfg(feature = "report")]
pub use foreign::{
    arrays, recorded,
    tiff_file::{TiffDepth, write_tiff},
};
// `self`, because a crate is called `hdf5` too.
#[cfg(feature = "hdf5")]
pub use self::hdf5::{
    images::{
        hspy_file::{HspyFacts, create_hspy, write_hspy},
        image_file::{ExitWaves, ImageCounts, ImageStack, Origin, write_images},
        image_series::{ImageSeries, SeriesAxis},
        stored_images::{ImageKind, StoredImage, StoredImages},
    },
    patterns::{
        pattern_file::{
            PatternFile, PatternHeader, PatternOrigin, PatternWriter, data_bytes, write_patterns,
        },
        pattern_format::PatternFormat,
        pattern_run::{PatternRun, WrittenPatterns},
    },
    read_through,
    worlds::{
        recording_file::{RecordingFile, SeriesPart, write_recording},
        schema,
        stack_truth::{DislocationRow, LayerRow},
        truth_writer::{LineKind, ParticleBatch, TruthBatch, TruthWriter},
        world_file::{GroundTruth, WorldFile},
        world_making::{RecordedSource, WorldMaking},
        world_metadata::WorldMetadata,
        world_truth::{BoundaryLine, WorldColumn},
        world_writer::{Header, WorldWriter},
    },
};
