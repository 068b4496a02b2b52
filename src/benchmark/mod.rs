//! The benchmark: agents act in a world under a dose budget, and their findings are scored against the truth and against the dose.
//!
//! In an [`Episode`] an agent looks, spends dose and declares its findings, in a [`BenchmarkWorld`]: a world file, or a specimen of a
//! recipe without a file. Each of four tasks has a score from 0 to 1 (`task_scores`); `dose_efficiency` combines the scores of an
//! episode. Tasks and rules follow the STEMGym paper; where the paper leaves something open, the item documents the choice.

mod benchmark_world;
#[cfg(feature = "hdf5")]
mod by_place;
mod changing_world;
mod dose_efficiency;
mod electron_counts;
mod episode;
mod episode_record;
mod episode_settings;
#[cfg(feature = "hdf5")]
mod file_world;
mod findings;
mod in_use;
mod matching;
mod overview_blocks;
mod recipe_world;
mod seen_truth;
mod task;
mod task_scores;
mod view;

pub use benchmark_world::{BenchmarkWorld, PhaseSamples, RecordedView, RegionTruth, TrueColumn};
pub use changing_world::ChangingWorld;
pub use dose_efficiency::{DoseCurve, DoseMetrics};
pub use episode::{AgentAction, Ending, Episode, StepOutcome};
pub use episode_record::{EpisodeRecord, RecordedAcquisition};
pub use episode_settings::{EpisodeSettings, OVERVIEW_PX, Reward, TileDose, TileNoise};
#[cfg(feature = "hdf5")]
pub use file_world::FileWorld;
pub use findings::{AgentFindings, FoundColumn, FoundParticle, PlacedDefect};
pub use in_use::InUse;
pub use matching::{most_pairs, nearest_pairs};
pub use recipe_world::{RecipeSource, RecipeWorld, Split};
pub use seen_truth::SeenTruth;
pub use task::{Task, TaskKind, TaskScore};
pub use task_scores::{
    ColumnScore, NO_PHASE, PAPER_RADIUS_NM, ParticleScore, STRICT_RADIUS_NM, column_score,
    count_f1, defect_census, macro_f1, particle_census, phase_iou, spatial_f1, targeted_f1,
};
pub use view::{FieldFacts, TileView};
