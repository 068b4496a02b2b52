//! What making a mosaic will take.

use super::image_note::NewImages;
use crate::recipe::CheckedRecipe;

/// What a mosaic will take.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct MosaicCost {
    /// Whether it takes less than simulating the field itself.
    pub pays: bool,
    /// Whether all its images come along with the program.
    pub supplied: bool,
    /// Images of library cells.
    pub images: usize,
    /// Those that the cache lacks.
    pub missing: usize,
    /// Why the cache lacks them.
    pub new: Vec<NewImages>,
    /// Probes that they take.
    pub missing_probes: usize,
    /// Bytes that they take on disk.
    pub missing_bytes: u64,
    /// Columns with a place in the library.
    pub columns: u64,
    /// Columns that are simulated where they lie.
    pub unique_columns: u64,
    /// Memory of the library's images.
    pub image_bytes: u64,
}

impl MosaicCost {
    /// Whether its errors are known: those of the library that comes along, with nothing on the faces of the specimen.
    pub fn is_known(&self, recipe: &CheckedRecipe) -> bool {
        self.supplied && recipe.surface.is_none()
    }
}
