//! Specimens: every lattice site of a full field, computed region by region.
//!
//! recipe -> specimen. A specimen is never held in memory as a whole: [`Specimen::query`] computes the columns and sites of any region, and
//! the result does not depend on how the field is divided into regions.

pub(crate) mod alloy_spacing;
pub(crate) mod atom_columns;
pub(crate) mod beam_rows;
pub(crate) mod census;
pub(crate) mod coherent;
pub(crate) mod column_grid;
pub(crate) mod column_index;
pub(crate) mod composition;
mod damaged;
pub(crate) mod defects;
mod domains;
mod epitaxy;
mod factory;
mod grains;
mod held_columns;
mod own_atoms;
pub(crate) mod particle_orientation;
mod particles;
mod relax;
pub(crate) mod repeating_units;
pub(crate) mod roughness;
pub(crate) mod scattered_circles;
pub(crate) mod sites;
pub(crate) mod specimen_trait;
pub(crate) mod stack;
pub(crate) mod stripes;
pub(crate) mod surface_layers;
mod unit_likeness;
pub(crate) mod units;
pub(crate) mod wave;

pub use atom_columns::{AtomColumn, Sites};
pub use census::{counted_sites, estimated_sites};
pub use damaged::{damaged_specimen::DamagedSpecimen, dose_map::DoseMap};
#[cfg(all(test, feature = "hdf5"))]
pub(crate) use factory::LAID_OUT;
pub use factory::specimen;
pub use particles::ROW_TILT_DEG;
pub use sites::{DISPLACED_NM, SiteKind, SpecimenSite};
pub(crate) use specimen_trait::outlines_in;
pub use specimen_trait::{
    Boundary, BoundaryKind, DislocationTruth, ExpectedSites, LayerTruth, ParticleOutline,
    ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout, StackTruth, ThinFilm,
};
pub use stripes::{Stripe, for_each_stripe};
pub use surface_layers::{CarbonLayer, SurfaceLayers};
pub use units::library_cell::{LibraryCell, LibrarySite, LibraryUnit};
pub use units::occupation::DefectKind;
pub use units::unit_tag::{PatternIndex, TurnedFamily, UnitFamily, UnitTag};
