//! Recipes: descriptions of worlds, as TOML with one table per difficulty.
//!
//! A [`Recipe`] holds the values as they are written. A [`CheckedRecipe`] has been checked against all limits, with its crystals read;
//! specimens are only made from checked recipes.

mod atoms_recipe;
pub(crate) mod atoms_table;
mod checked;
mod checking;
mod checking_amorphous;
mod checking_atoms;
mod checking_defects;
mod checking_extended;
mod checking_interfaces;
mod checking_particles;
mod checking_stack;
mod checking_stack_particles;
mod checking_vacancy_groups;
mod crystal_source;
mod detector_tables;
mod difficulty;
mod fault;
pub(crate) mod limits;
mod optics_table;
mod oriented_crystals;
mod origin;
mod overrides;
mod reading;
pub(crate) mod region;
pub(crate) mod resolved_recipe;
mod shipped_recipe;
pub(crate) mod stack_table;
pub(crate) mod stacked_crystals;
mod surface_table;
pub(crate) mod tables;
mod toml_errors;
pub(crate) mod vacancy_groups_table;

pub use atoms_table::{AtomsTable, is_atoms_file};
pub use checked::CheckedRecipe;
pub use crystal_source::CrystalSource;
pub use detector_tables::{DetectorTable, DetectorTables, NamedDetectorTable};
pub use difficulty::Difficulty;
pub(crate) use limits::BEYOND_FIELD_NM;
pub use optics_table::OpticsTable;
pub use origin::RecipeOrigin;
pub use overrides::Override;
pub use region::Region;
pub use resolved_recipe::Recipe;
pub use shipped_recipe::{RecipeChange, ShippedRecipe};
pub use stack_table::{
    FaultKind, LayerFit, Precipitate, PrecipitateShape, StackDirection, StackDislocation,
    StackFault, StackLayer, StackTable,
};
pub use surface_table::SurfaceTable;
pub use tables::*;
pub use vacancy_groups_table::{
    DoubleVacancies, MissingAtoms, StackEdge, VacancyLines, VacancyPair,
};
