//! What has been done to a live world.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::specimen::DoseMap;

/// One recording of a live world. Places are (x, y) in nm from the centre of the first built pixel of the field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveAcquisition {
    /// Its number, from 0 on.
    pub number: usize,
    /// Time on the beam when it began, in s.
    pub begun_s: f64,
    /// How long it took, in s.
    pub duration_s: f64,
    /// The middle of the part.
    pub centre_nm: [f64; 2],
    /// Width and height of the part.
    pub size_nm: [f64; 2],
    /// Rows and columns.
    pub shape: [usize; 2],
    /// Electrons per square Angstrom, all frames together.
    pub dose: f64,
    /// Current of the beam in pA.
    pub current_pa: f64,
    /// Electrons on the specimen, all frames together.
    pub electrons: f64,
    /// Mean thickness in nm of the carbon on the part when it began.
    #[serde(default)]
    pub carbon_nm: f64,
    /// Atoms that the specimen has lost, by element.
    pub lost: BTreeMap<String, u64>,
}

/// A live world at one moment. It holds what has been done, not the specimen, which follows from the recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveSnapshot {
    /// Version of this format.
    pub version: u32,
    /// The recipe, with the seed, as TOML.
    pub recipe: String,
    /// The dose that the world was made for, in electrons per square Angstrom.
    pub most_dose: f64,
    /// The doses of all places.
    pub dose: DoseMap,
    /// Thickness in Angstrom of the carbon on all places, in the place of doses; none in snapshots of before there was any.
    #[serde(default)]
    pub carbon_angstrom: DoseMap,
    /// All recordings.
    pub history: Vec<LiveAcquisition>,
}
