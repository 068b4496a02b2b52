//! The benchmark: what agents found in a world, scored against the truth and against the dose that it took.
//!
//! Four tasks have a score from 0 to 1 ([`task_scores`]); [`dose_efficiency`] makes one number of the scores of an episode. All are pure
//! functions of lists and maps. The tasks are those of the STEMGym paper; where it leaves something open, the function says what was chosen.

pub mod dose_efficiency;
pub mod findings;
pub mod matching;
pub mod task_scores;

pub use dose_efficiency::{DoseCurve, DoseMetrics};
pub use findings::{FoundColumn, FoundParticle, PlacedDefect};
