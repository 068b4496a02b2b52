//! Worlds: one file with the image of a specimen and the truth about it.
//!
//! imaging -> sub-tiles -> blended image -> noise -> tiles -> file. A sub-tile is saved as soon as it is computed, so an interrupted build
//! continues where it stopped.

mod atoms_export;
#[cfg(feature = "hdf5")]
mod audit_job;
#[cfg(feature = "hdf5")]
pub(crate) mod blended_image;
mod build_options;
#[cfg(feature = "hdf5")]
mod build_plan;
#[cfg(feature = "hdf5")]
mod build_summary;
pub(crate) mod column_labels;
mod contamination;
mod field_recording;
#[cfg(feature = "hdf5")]
mod field_scan;
mod field_tile;
pub mod footprint;
mod image_plan;
#[cfg(feature = "hdf5")]
mod made_world;
pub(crate) mod noise_free;
#[cfg(feature = "hdf5")]
mod options_of_world;
#[cfg(feature = "hdf5")]
mod publish;
#[cfg(feature = "hdf5")]
mod recording_job;
#[cfg(feature = "hdf5")]
mod recording_writer;
pub(crate) mod region_truth;
#[cfg(feature = "render")]
mod specimen_drawing;
#[cfg(feature = "hdf5")]
mod subtile_store;
#[cfg(feature = "hdf5")]
mod subtiles;
#[cfg(feature = "report")]
mod training_file;
mod training_sample;
pub(crate) mod training_set;
#[cfg(feature = "hdf5")]
mod truth;
#[cfg(feature = "hdf5")]
mod work_folder;
#[cfg(feature = "hdf5")]
mod world_build;
#[cfg(feature = "hdf5")]
mod world_facts;
#[cfg(feature = "hdf5")]
mod world_job;
#[cfg(feature = "hdf5")]
mod world_shard;
#[cfg(feature = "hdf5")]
mod world_source;

pub use atoms_export::{ExportOptions, ExportSummary, estimated_rows, export};
#[cfg(feature = "hdf5")]
pub use audit_job::AuditJob;
pub use build_options::{BuildMethod, BuildOptions, BuildPolicy, BuildProfile};
#[cfg(feature = "hdf5")]
pub use build_plan::WorldPlan;
#[cfg(feature = "hdf5")]
pub use build_summary::BuildSummary;
pub(crate) use contamination::{CarbonBefore, expose_frame, grown};
pub use field_recording::{
    Electrons, FieldRecording, RecordedPart, RecordingOptions, RecordingStages, record,
};
pub(crate) use field_recording::{record_over, scan_of};
pub(crate) use field_tile::tile_of_image;
pub use field_tile::{FieldTile, field_tile};
pub use image_plan::ImagePlan;
#[cfg(feature = "hdf5")]
pub use made_world::{WorldEngine, imaging_of};
pub use noise_free::{ImagerSource, NoiseFree, refined, refinement};
#[cfg(feature = "hdf5")]
pub use publish::Companion;
#[cfg(feature = "hdf5")]
pub use recording_job::{RecordedFrom, RecordingJob, RecordingRequest};
pub use region_truth::{ColumnTruth, SiteTruth};
#[cfg(feature = "render")]
pub use specimen_drawing::{Drawing, draw_specimen};
#[cfg(feature = "hdf5")]
pub use subtile_store::work_folder;
#[cfg(feature = "report")]
pub use training_file::write_training_set;
pub use training_sample::{DetectorImage, SampleOptions, TrainingSample, training_sample};
pub use training_set::{COLUMN_CLASSES, TrainingOptions, TrainingSet, training_set};
#[cfg(feature = "hdf5")]
pub use truth::Counts;
#[cfg(feature = "hdf5")]
pub use work_folder::remove_leftovers;
#[cfg(feature = "hdf5")]
pub use world_build::{WorldBuild, build};
#[cfg(feature = "hdf5")]
pub use world_facts::{RecordingFacts, WorldFacts};
#[cfg(feature = "hdf5")]
pub use world_shard::ShardSummary;
#[cfg(feature = "hdf5")]
pub(crate) use world_source::WorldSource;
