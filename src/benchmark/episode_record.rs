//! What is kept of an episode.

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
    /// Its middle (x, y) in nm from the centre of the field's first pixel.
    pub centre_nm: [f64; 2],
    /// Its edge in nm.
    pub size_nm: f64,
    /// Zoom.
    pub zoom: f64,
    /// Times the reference dose.
    pub multiplier: f64,
    /// What it took of the budget, in electrons per square Angstrom.
    pub cost: f64,
    /// Electrons on a pixel.
    pub electrons_per_pixel: f64,
}

/// An episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeRecord {
    /// Name of the world.
    pub world: String,
    /// What was asked for.
    pub task: Task,
    /// The rules.
    pub settings: EpisodeSettings,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of the episode under this seed.
    pub episode: u32,
    /// How it ended, if it did.
    pub ended: Option<Ending>,
    /// Steps that were made.
    pub steps: u32,
    /// Declarations.
    pub declared: u32,
    /// Declarations that could not be read.
    pub unreadable: u32,
    /// Electrons per square Angstrom.
    pub spent: f64,
    /// (share of the budget, score).
    pub curve: Vec<[f64; 2]>,
    /// Numbers made of the curve.
    pub metrics: DoseMetrics,
    /// Scores of the last declaration in all forms.
    pub scores: Option<TaskScore>,
    /// All acquisitions.
    pub acquisitions: Vec<RecordedAcquisition>,
}
