//! Worlds: from a recipe to a specimen, its simulated image, and one file with the ground truth.
//!
//! recipe -> specimen -> sub-tiles -> engine -> blended image -> noise -> tiles -> file. A sub-tile
//! is saved as soon as it is computed, so an interrupted build goes on where it was.

pub mod audit;
pub mod boundary;
mod boundary_motif;
pub mod build;
mod census;
mod coherent;
pub mod coincidence;
mod composition;
pub mod contents;
pub mod crystal;
pub mod crystal_source;
pub mod defects;
pub mod domains;
mod drawing;
pub mod epitaxy;
mod export;
pub mod field_image;
pub mod film;
pub mod footprint;
pub mod grains;
pub mod method;
pub mod mosaic;
pub mod noise;
mod orientation;
mod overrides;
pub mod particles;
mod particles_check;
pub mod pixel_box;
mod pool;
pub mod recipe;
mod recipe_check;
pub mod relax;
mod roughness;
pub mod sheet;
pub mod simulator;
pub mod specimen;
mod stitch;
mod store;
pub(crate) mod subprogress;
pub mod subtiles;
pub mod tables;
mod truth;
mod units;
pub mod vacancies;
mod wave;

pub use build::{BuildOptions, SubTileEngine, Summary, build};
pub use census::{counted_sites, estimated_sites};
pub use drawing::Drawing;
pub use export::{ExportOptions, ExportSummary, export};
pub use overrides::Override;
pub use recipe::{Difficulty, Recipe};
pub use simulator::Simulator;
pub use specimen::{
    AtomColumn, Boundary, BoundaryKind, ParticleTruth, Region, SiteKind, Sites, Specimen,
    SpecimenSite, specimen,
};
pub use truth::Counts;
