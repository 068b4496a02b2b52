//! From a checked recipe to its specimen.

use super::domains::Domains;
use super::epitaxy::Epitaxy;
use super::grains::tilt_grains::Grains;
use super::model::Specimen;
use super::particles::ParticlesOnCarbon;
use super::relax::Relaxed;
use crate::error::Result;
use crate::recipe::model::Recipe;
use crate::recipe::tables::StructureKind;

/// The specimen that a recipe describes.
///
/// # Errors
/// [`crate::Error::Invalid`] when a value of the recipe is outside its limits.
pub fn specimen(recipe: &Recipe) -> Result<Box<dyn Specimen>> {
    recipe.check()?;
    let rigid: Box<dyn Specimen> = match recipe.structure {
        StructureKind::Grains => Box::new(Grains::new(recipe)?),
        StructureKind::Domains => Box::new(Domains::new(recipe)?),
        StructureKind::Epitaxy => Box::new(Epitaxy::new(recipe)?),
        StructureKind::Particles => Box::new(ParticlesOnCarbon::new(recipe)?),
    };
    Relaxed::of(rigid, recipe)
}
