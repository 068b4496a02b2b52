//! The record of an episode.

use serde::Serialize;

use super::dose_efficiency::DoseMetrics;
use super::episode::Ending;
use super::episode_settings::EpisodeSettings;
use super::task::{Task, TaskScore};

/// One acquisition.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedAcquisition {
    /// Step of the episode.
    pub step: u32,
    /// The tile (row, column) whose middle is nearest.
    pub tile: [usize; 2],
    /// Middle (x, y) of the acquisition in nm from the centre of the field's first pixel.
    pub centre_nm: [f64; 2],
    /// Edge of the acquisition in nm.
    pub size_nm: f64,
    /// Zoom.
    pub zoom: f64,
    /// Multiple of the reference dose.
    pub multiplier: f64,
    /// Cost in the budget, in electrons per square Angstrom.
    pub cost: f64,
    /// Electrons on a pixel.
    pub electrons_per_pixel: f64,
}

/// The record of an episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeRecord {
    /// Name of the world.
    pub world: String,
    /// The task.
    pub task: Task,
    /// The rules.
    pub settings: EpisodeSettings,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of the episode under this seed.
    pub episode: u32,
    /// Reason for the end of the episode, if it ended.
    pub ended: Option<Ending>,
    /// Number of steps that were made.
    pub steps: u32,
    /// Number of declarations.
    pub declared: u32,
    /// Number of declarations that could not be read.
    pub unreadable: u32,
    /// Spent dose in electrons per square Angstrom.
    pub spent: f64,
    /// The curve: (share of the budget, score).
    pub curve: Vec<[f64; 2]>,
    /// Metrics of the curve.
    pub metrics: DoseMetrics,
    /// Scores of the last declaration in all forms.
    pub scores: Option<TaskScore>,
    /// All acquisitions.
    pub acquisitions: Vec<RecordedAcquisition>,
}
