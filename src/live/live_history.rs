//! The history of a live world.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::specimen::DoseMap;
use crate::structure::elements;

/// One recording of a live world. Places are (x, y) in nm from the centre of the first built pixel of the field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LiveAcquisition {
    /// Number of the recording, from 0.
    pub number: usize,
    /// Time on the beam at its start, in s.
    pub begun_s: f64,
    /// Duration in s.
    pub duration_s: f64,
    /// Centre (x, y) of the recorded part.
    pub centre_nm: [f64; 2],
    /// Width and height of the recorded part.
    pub size_nm: [f64; 2],
    /// Rows and columns.
    pub shape: [usize; 2],
    /// Electrons per square Angstrom of all frames together.
    pub dose: f64,
    /// Current of the beam in pA.
    pub current_pa: f64,
    /// Electrons on the specimen in all frames together.
    pub electrons: f64,
    /// Mean thickness in nm of the carbon on the part at the start.
    #[serde(default)]
    pub carbon_nm: f64,
    /// Number of atoms that the specimen has lost, by element.
    pub lost: BTreeMap<String, u64>,
}

/// A live world at one moment. It contains the recordings and doses, not the specimen, which follows from the recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveSnapshot {
    /// Version of this format.
    pub version: u32,
    /// The recipe, with the seed, as TOML.
    pub recipe: String,
    /// The dose for which the world was made, in electrons per square Angstrom.
    pub most_dose: f64,
    /// The doses at all places.
    pub dose: DoseMap,
    /// Thickness in Angstrom of the carbon at all places, stored like doses. It is empty in snapshots from before carbon was simulated.
    #[serde(default)]
    pub carbon_angstrom: DoseMap,
    /// All recordings.
    pub history: Vec<LiveAcquisition>,
    /// SHA-256 of all other fields; empty in snapshots of version 1.
    #[serde(default)]
    pub digest: String,
}

/// Largest number of recordings of a live world; each takes seconds on a microscope.
const MOST_RECORDINGS: usize = 1_000_000;
/// Largest number of pixels along an edge of a recording.
const LONGEST_EDGE_PX: usize = 1 << 16;

impl LiveSnapshot {
    /// Adds the digest to the snapshot.
    #[must_use]
    pub(super) fn sealed(mut self) -> Self {
        self.digest = self.computed_digest();
        self
    }

    /// SHA-256 of everything but the digest.
    fn computed_digest(&self) -> String {
        let plain = LiveSnapshot { digest: String::new(), ..self.clone() };
        let text = serde_json::to_string(&plain).unwrap_or_default();
        Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The fault of a snapshot that may have been damaged or edited, in words.
    pub(super) fn fault(&self) -> Option<String> {
        if self.version > 1 && self.digest != self.computed_digest() {
            return Some("it is damaged: its digest does not match its contents".into());
        }
        if !(self.most_dose.is_finite() && self.most_dose > 0.0) {
            return Some(format!(
                "its `most_dose` is {}, expected a positive dose",
                self.most_dose
            ));
        }
        if self.history.len() > MOST_RECORDINGS {
            let found = self.history.len();
            return Some(format!(
                "it lists {found} recordings; at most {MOST_RECORDINGS} are read"
            ));
        }
        let mut ended_s = 0.0;
        for (number, recording) in self.history.iter().enumerate() {
            if let Some(what) = recording.fault(number, ended_s) {
                return Some(format!("recording {number} of its history has {what}"));
            }
            ended_s = recording.begun_s + recording.duration_s;
        }
        None
    }
}

/// Times that differ by less than this share are equal except for rounding.
const SAME_TIME: f64 = 1e-9;

impl LiveAcquisition {
    /// The value that is impossible in recording `number`, which begins after the end of the one before it, in words.
    fn fault(&self, number: usize, ended_s: f64) -> Option<String> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let checks = [
            (self.number == number, format!("the number {}", self.number)),
            (
                self.begun_s.is_finite() && self.begun_s >= ended_s * (1.0 - SAME_TIME),
                format!("begun at {} s, before {ended_s} s", self.begun_s),
            ),
            (positive(self.duration_s), format!("lasted {} s", self.duration_s)),
            (
                self.centre_nm.iter().all(|v| v.is_finite()),
                format!("its centre at {:?} nm", self.centre_nm),
            ),
            (self.size_nm.into_iter().all(positive), format!("a size of {:?} nm", self.size_nm)),
            (
                self.shape.iter().all(|n| (1..=LONGEST_EDGE_PX).contains(n)),
                format!("{:?} pixels", self.shape),
            ),
            (positive(self.dose), format!("a dose of {} electrons/A^2", self.dose)),
            (positive(self.current_pa), format!("a current of {} pA", self.current_pa)),
            (positive(self.electrons), format!("{} electrons", self.electrons)),
            (
                self.carbon_nm.is_finite() && self.carbon_nm >= 0.0,
                format!("carbon of {} nm", self.carbon_nm),
            ),
        ];
        if let Some((_, what)) = checks.into_iter().find(|(right, _)| !right) {
            return Some(what);
        }
        let unknown = self.lost.keys().find(|symbol| elements::atomic_number(symbol).is_err());
        unknown.map(|symbol| format!("lost atoms of `{symbol}`, which is no element"))
    }
}
