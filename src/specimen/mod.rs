//! Specimens: every lattice site of a full field, computed region by region.
//!
//! recipe -> specimen. A specimen is never held in memory as a whole: [`Specimen::query`] computes the columns and sites of any region, and
//! the result does not depend on how the field is divided into regions.

pub(crate) mod alloy_spacing;
pub mod atom_columns;
pub(crate) mod beam_rows;
pub mod census;
pub(crate) mod coherent;
pub(crate) mod column_grid;
pub(crate) mod column_index;
pub(crate) mod composition;
pub mod damaged;
pub(crate) mod defects;
pub mod domains;
pub mod epitaxy;
mod factory;
pub mod grains;
pub mod own_atoms;
pub mod particles;
pub mod relax;
pub(crate) mod roughness;
pub mod sites;
pub mod specimen_trait;
pub(crate) mod stack;
pub mod stripes;
pub mod surface_layers;
pub mod units;
pub(crate) mod wave;

pub use atom_columns::{AtomColumn, Sites};
pub use census::{counted_sites, estimated_sites};
pub use damaged::{damaged_specimen::DamagedSpecimen, dose_map::DoseMap};
#[cfg(all(test, feature = "hdf5"))]
pub(crate) use factory::LAID_OUT;
pub use factory::specimen;
pub use sites::{DISPLACED_NM, SiteKind, SpecimenSite};
pub(crate) use specimen_trait::outlines_in;
pub use specimen_trait::{
    Boundary, BoundaryKind, DislocationTruth, ExpectedSites, LayerTruth, ParticleOutline,
    ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout, StackTruth, ThinFilm,
};

pub use surface_layers::{CarbonLayer, SurfaceLayers};
