//! Lays out the specimen of a checked recipe.

use std::sync::Arc;

use super::domains::Domains;
use super::epitaxy::Epitaxy;
use super::grains::tilt_grains::Grains;
use super::own_atoms::OwnAtoms;
use super::particles::ParticlesOnCarbon;
use super::relax::Relaxed;
use super::specimen_trait::Specimen;
use super::stack::stack;
use crate::error::Result;
use crate::recipe::CheckedRecipe;
use crate::recipe::tables::StructureKind;

#[cfg(test)]
thread_local! {
    /// Number of specimens that this thread has laid out.
    pub(crate) static LAID_OUT: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// Lays out the specimen that a recipe describes.
///
/// # Errors
/// [`crate::Error::Invalid`] where defects or particles find no room, which limits of single values cannot show.
pub fn specimen(recipe: &CheckedRecipe) -> Result<Arc<dyn Specimen>> {
    #[cfg(test)]
    LAID_OUT.set(LAID_OUT.get() + 1);
    let rigid: Box<dyn Specimen> = match recipe.structure {
        StructureKind::Grains => Box::new(Grains::new(recipe)?),
        StructureKind::Domains => Box::new(Domains::new(recipe)?),
        StructureKind::Epitaxy => Box::new(Epitaxy::new(recipe)?),
        StructureKind::Particles => Box::new(ParticlesOnCarbon::new(recipe)?),
        StructureKind::Atoms => Box::new(OwnAtoms::new(recipe)?),
        StructureKind::Stack => Box::new(stack(recipe)?),
    };
    Ok(Arc::from(Relaxed::of(rigid, recipe)?))
}
