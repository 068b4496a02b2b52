//! The rules of an episode.

use serde::{Deserialize, Serialize};

use super::view::FieldFacts;
use crate::error::{Error, Result};
use crate::lengths;
use crate::setting::Setting;

/// Dose of an acquisition without zoom and with the multiplier 1 in the budget, in electrons per square Angstrom.
pub(crate) const REFERENCE_DOSE: f64 = 100.0;
/// The paper's budget in electrons per square Angstrom.
pub(crate) const BUDGET: f64 = 5000.0;
/// The paper's number of steps.
pub(crate) const HORIZON: u32 = 200;
/// The score is recorded after each group of this many acquisitions.
pub(crate) const CADENCE: u32 = 5;
/// Limits of the zoom.
pub(crate) const ZOOM: [f64; 2] = [1.0, 8.0];
/// Limits of the dose multiplier.
pub(crate) const MULTIPLIER: [f64; 2] = [0.1, 10.0];
/// Edge of the part of the overview that is shown, in pixels of the overview.
pub const OVERVIEW_PX: usize = 64;

/// Dose of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TileDose {
    /// The dose of the world's tier times the multiplier, at any zoom, as in the paper's tiles.
    #[default]
    Tier,
    /// The dose that is charged to the budget.
    Physical,
}

/// Origin of the noise of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TileNoise {
    /// Electrons are drawn anew in each acquisition.
    Poisson,
    /// Tiles are shown as the world holds them, at any dose.
    Stored,
}

/// Reward of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reward {
    /// No reward.
    #[default]
    None,
    /// The change of the score by each acquisition and declaration; the sum is the final score.
    ScoreGain,
    /// The final score, at the end.
    Sparse,
}

/// The rules of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeSettings {
    /// Dose that may be spent, in electrons per square Angstrom.
    pub budget: f64,
    /// Number of steps.
    pub horizon: u32,
    /// Number of acquisitions between two records of the score.
    pub cadence: u32,
    /// Dose of a pixel.
    pub exposure: TileDose,
    /// Origin of the noise.
    pub noise: TileNoise,
    /// Reward of a step.
    pub reward: Reward,
    /// Distance in pixels, along each axis, of the samples at which phases are compared; 1 compares all pixels. With 8 (as in the overview)
    /// the score of a map in parts as large as tiles changes by less than 0.002.
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
    /// Checks the rules for a field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values out of limits, and for noise that the world does not have.
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
            let expected = "recorded data contain noise already; use the stored tiles";
            return refuse("counted noise".into(), expected);
        }
        if self.noise == TileNoise::Poisson && self.dose(field) <= 0.0 {
            let expected = "the world file contains no dose; use the physical exposure";
            return refuse("exposure of the tier".into(), expected);
        }
        Ok(())
    }

    /// Returns the cost of an acquisition, in electrons per square Angstrom.
    pub(crate) fn cost(zoom: f64, multiplier: f64) -> f64 {
        REFERENCE_DOSE * multiplier * zoom * zoom
    }

    /// Returns the dose of a pixel of a field without zoom, with the multiplier 1.
    pub(crate) fn dose(&self, field: &FieldFacts) -> f64 {
        match self.exposure {
            TileDose::Tier => field.dose,
            TileDose::Physical => REFERENCE_DOSE,
        }
    }

    /// Returns the dose of a place that receives the whole budget, in electrons per square Angstrom.
    pub(crate) fn most_dose(&self, field: &FieldFacts) -> f64 {
        self.dose(field) * self.budget / REFERENCE_DOSE
    }

    /// Returns the electrons on a pixel of an acquisition. With a zoom the pixel is smaller and the dose greater by the same factor.
    pub(crate) fn electrons_per_pixel(&self, field: &FieldFacts, multiplier: f64) -> f64 {
        self.dose(field) * multiplier * lengths::square_angstrom2(field.pixel_nm)
    }
}
