//! The cost of a mosaic.

use super::image_note::NewImages;
use crate::recipe::CheckedRecipe;

/// The cost of a mosaic.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct MosaicCost {
    /// Whether the mosaic is cheaper than direct simulation of the field.
    pub pays: bool,
    /// Whether all its images are in the supplied library.
    pub supplied: bool,
    /// Number of images of library cells.
    pub images: usize,
    /// Number of images that the cache lacks.
    pub missing: usize,
    /// Why the cache lacks them.
    pub new: Vec<NewImages>,
    /// Number of probes of the missing images.
    pub missing_probes: usize,
    /// Size of the missing images on disk in bytes.
    pub missing_bytes: u64,
    /// Number of columns with a place in the library.
    pub columns: u64,
    /// Number of columns that are simulated at their place in the field.
    pub unique_columns: u64,
    /// Memory of the library's images in bytes.
    pub image_bytes: u64,
}

impl MosaicCost {
    /// Whether the errors of the mosaic are known. They are if all images are in the supplied library and nothing lies on the faces of the
    /// specimen.
    pub(crate) fn is_known(&self, recipe: &CheckedRecipe) -> bool {
        self.supplied && recipe.surface.is_none()
    }
}
