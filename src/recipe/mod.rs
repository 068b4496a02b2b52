//! Recipes: what a world is made of, as TOML with one table per difficulty.
//!
//! A [`Recipe`] holds what is written; a [`CheckedRecipe`] has been held against all limits, with its crystals read, and is
//! the only way to a specimen.

pub mod checking;
mod checking_particles;
pub mod crystal_source;
pub mod limits;
pub mod model;
pub mod overrides;
pub mod region;
pub mod tables;

pub use crystal_source::CrystalSource;
pub use limits::BEYOND_FIELD_NM;
pub use model::{Difficulty, Recipe};
pub use overrides::Override;
pub use region::Region;
pub use tables::*;
