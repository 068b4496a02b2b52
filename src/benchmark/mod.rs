//! The benchmark: agents act in a world under a dose budget, and their findings are scored against the truth and against the dose.
//!
//! In an [`Episode`] an agent looks, spends dose and declares its findings, in a [`BenchmarkWorld`]: a world file, or a specimen of a
//! recipe without a file. Each of four tasks has a score from 0 to 1 ([`task_scores`]); [`dose_efficiency`] combines the scores of an
//! episode. Tasks and rules follow the STEMGym paper; where the paper leaves something open, the item documents the choice.

pub mod benchmark_world;
#[cfg(feature = "hdf5")]
mod by_place;
pub mod changing_world;
pub mod dose_efficiency;
pub mod electron_counts;
pub mod episode;
pub mod episode_record;
pub mod episode_settings;
#[cfg(feature = "hdf5")]
pub mod file_world;
pub mod findings;
pub mod in_use;
pub mod matching;
mod overview_blocks;
pub mod recipe_world;
pub mod seen_truth;
pub mod task;
pub mod task_scores;
pub mod view;

pub use benchmark_world::{BenchmarkWorld, PhaseSamples, RecordedView, RegionTruth, TrueColumn};
pub use changing_world::ChangingWorld;
pub use dose_efficiency::{DoseCurve, DoseMetrics};
pub use episode::{AgentAction, Ending, Episode, StepOutcome};
pub use episode_record::{EpisodeRecord, RecordedAcquisition};
pub use episode_settings::{EpisodeSettings, Reward, TileDose, TileNoise};
#[cfg(feature = "hdf5")]
pub use file_world::FileWorld;
pub use findings::{AgentFindings, FoundColumn, FoundParticle, PlacedDefect};
pub use in_use::InUse;
pub use recipe_world::{RecipeSource, RecipeWorld, Split};
pub use seen_truth::SeenTruth;
pub use task::{Task, TaskKind, TaskScore};
pub use view::{FieldFacts, TileView};
