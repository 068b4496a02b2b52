//! The rules of an episode.

use serde::{Deserialize, Serialize};

use super::view::FieldFacts;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Dose of an acquisition without zoom and with the multiplier 1, as the budget counts it, in electrons per square Angstrom.
pub const REFERENCE_DOSE: f64 = 100.0;
/// The paper's budget in electrons per square Angstrom.
pub const BUDGET: f64 = 5000.0;
/// The paper's number of steps.
pub const HORIZON: u32 = 200;
/// The score is noted after every so many acquisitions.
pub const CADENCE: u32 = 5;
/// Limits of the zoom.
pub const ZOOM: [f64; 2] = [1.0, 8.0];
/// Limits of the dose multiplier.
pub const MULTIPLIER: [f64; 2] = [0.1, 10.0];
/// Edge of the part of the overview that is shown, in its pixels.
pub const OVERVIEW_PX: usize = 64;

/// How many electrons a pixel gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TileDose {
    /// The dose of the world's tier times the multiplier, whatever the zoom: the paper's tiles.
    #[default]
    Tier,
    /// The dose that the budget counts.
    Physical,
}

/// Where the noise of tiles comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TileNoise {
    /// Electrons are counted anew in each acquisition.
    Poisson,
    /// Tiles are shown as the world holds them, whatever the dose.
    Stored,
}

/// What a step pays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reward {
    /// Nothing.
    #[default]
    None,
    /// The change of the score by each acquisition and declaration: the final score in sum.
    ScoreGain,
    /// The final score at the end.
    Sparse,
}

/// The rules.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeSettings {
    /// Dose that may be spent, in electrons per square Angstrom.
    pub budget: f64,
    /// Number of steps.
    pub horizon: u32,
    /// Acquisitions from one record of the score to the next.
    pub cadence: u32,
    /// How many electrons a pixel gets.
    pub exposure: TileDose,
    /// Where the noise comes from.
    pub noise: TileNoise,
    /// What a step pays.
    pub reward: Reward,
    /// Pixels from one to the next at which phases are compared, along each axis: 1 compares all. With 8 (those of the overview) the
    /// score of a map in parts as large as tiles changes by less than 0.002.
    pub phase_stride_px: usize,
    /// Show the overview.
    pub overview: bool,
}

impl Default for EpisodeSettings {
    fn default() -> Self {
        EpisodeSettings {
            budget: BUDGET,
            horizon: HORIZON,
            cadence: CADENCE,
            exposure: TileDose::Tier,
            noise: TileNoise::Poisson,
            reward: Reward::None,
            phase_stride_px: 8,
            overview: true,
        }
    }
}

impl EpisodeSettings {
    /// Whether the rules make sense for a field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values out of limits, and noise that the world has not.
    pub fn check(&self, field: &FieldFacts) -> Result<()> {
        let refuse = |value: String, expected: &str| {
            Err(Error::invalid(Setting::Episode, value, expected.to_owned()))
        };
        if !(1.0..=1e9).contains(&self.budget) {
            let expected = "a budget has 1 to 1e9 electrons per square Angstrom";
            return refuse(self.budget.to_string(), expected);
        }
        if !(1..1 << 24).contains(&self.horizon) {
            return refuse(format!("{} steps", self.horizon), "expected 1 to 16777215 steps");
        }
        if self.cadence == 0 || !(1..=field.tile_px).contains(&self.phase_stride_px) {
            let value = format!("cadence {}, stride {}", self.cadence, self.phase_stride_px);
            return refuse(value, "expected whole numbers above 0, and a stride within a tile");
        }
        if self.noise == TileNoise::Poisson && field.recorded {
            let expected =
                "recorded data have noise of their own: take the tiles as they are stored";
            return refuse("counted noise".into(), expected);
        }
        if self.noise == TileNoise::Poisson && self.dose(field) <= 0.0 {
            let expected = "the world does not tell its dose: take the physical exposure";
            return refuse("exposure of the tier".into(), expected);
        }
        Ok(())
    }

    /// What an acquisition costs, in electrons per square Angstrom.
    pub fn cost(zoom: f64, multiplier: f64) -> f64 {
        REFERENCE_DOSE * multiplier * zoom * zoom
    }

    /// Dose of a pixel of a field without zoom, with the multiplier 1.
    pub fn dose(&self, field: &FieldFacts) -> f64 {
        match self.exposure {
            TileDose::Tier => field.dose,
            TileDose::Physical => REFERENCE_DOSE,
        }
    }

    /// The dose of a place that gets the whole budget, in electrons per square Angstrom.
    pub fn most_dose(&self, field: &FieldFacts) -> f64 {
        self.dose(field) * self.budget / REFERENCE_DOSE
    }

    /// Electrons on a pixel of an acquisition. With a zoom a pixel is smaller, and the dose greater by as much.
    pub fn electrons_per_pixel(&self, field: &FieldFacts, multiplier: f64) -> f64 {
        self.dose(field) * multiplier * (10.0 * field.pixel_nm).powi(2)
    }
}
