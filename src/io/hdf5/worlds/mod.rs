//! Files of worlds and of recordings, with their ground truth.

pub(crate) mod recording_file;
pub mod schema;
pub(crate) mod stack_truth;
pub(crate) mod truth_writer;
mod world_contents;
mod world_detectors;
pub(crate) mod world_file;
pub(crate) mod world_making;
pub(crate) mod world_metadata;
pub(crate) mod world_truth;
mod world_types;
pub(crate) mod world_writer;
