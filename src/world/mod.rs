//! Worlds: one file with the image of a specimen and the truth about it.
//!
//! imaging -> sub-tiles -> blended image -> noise -> tiles -> file. A sub-tile is saved as soon as it is computed, so an interrupted build
//! continues where it stopped.

mod atoms_export;
mod build_options;
pub(crate) mod column_labels;
mod contamination;
mod detector_recorder;
mod field_recording;
mod field_tile;
pub mod footprint;
mod image_plan;
mod kept_frames;
pub(crate) mod noise_free;
pub(crate) mod recorded_detectors;
pub(crate) mod region_truth;
#[cfg(feature = "render")]
mod specimen_drawing;
#[cfg(feature = "report")]
mod training_file;
mod training_sample;
pub(crate) mod training_set;

pub use atoms_export::{ExportOptions, ExportSummary, estimated_rows, export};
pub use build_options::{BuildMethod, BuildOptions, BuildPolicy, BuildProfile};
pub(crate) use contamination::{CarbonBefore, expose_frame, grown};
pub use field_recording::{
    DetectorRecording, Electrons, FieldRecording, RecordedPart, RecordingOptions, RecordingStages,
    record,
};
pub(crate) use field_recording::{RecordedField, record_over, scan_of};
pub(crate) use field_tile::tile_of_image;
pub use field_tile::{FieldTile, field_tile};
pub use image_plan::ImagePlan;
pub use noise_free::{ImagerSource, NoiseFree, refined, refinement};
pub use region_truth::{ColumnTruth, SiteTruth};
#[cfg(feature = "render")]
pub use specimen_drawing::{Drawing, draw_specimen};
#[cfg(feature = "report")]
pub use training_file::write_training_set;
pub use training_sample::{DetectorImage, SampleOptions, TrainingSample, training_sample};
pub use training_set::{COLUMN_CLASSES, TrainingOptions, TrainingSet, training_set};
#[cfg(feature = "hdf5")]
pub use with_hdf5::*;

/// The files of this folder that need HDF5.
#[cfg(feature = "hdf5")]
#[path = "."]
mod with_hdf5 {
    use super::*;

    mod audit_job;
    pub(crate) mod blended_image;
    mod build_plan;
    mod build_summary;
    mod field_scan;
    mod made_world;
    mod options_of_world;
    mod publish;
    mod recording_job;
    mod recording_writer;
    mod subtile_store;
    mod subtiles;
    mod truth;
    mod work_folder;
    mod world_build;
    mod world_facts;
    mod world_job;
    mod world_shard;
    mod world_source;

    pub use audit_job::AuditJob;
    pub use build_plan::{BuildNeeds, WorldPlan};
    pub use build_summary::BuildSummary;
    pub use made_world::{WorldEngine, imaging_of};
    pub use publish::Companion;
    pub use recording_job::{RecordedFrom, RecordingJob, RecordingRequest};
    pub use truth::Counts;
    pub use work_folder::remove_leftovers;
    pub use world_build::{WorldBuild, build};
    pub use world_facts::{RecordingFacts, WorldFacts};
    pub use world_shard::ShardSummary;
    pub(crate) use world_source::WorldSource;
}
