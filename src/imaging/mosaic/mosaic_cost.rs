//! What making a mosaic will take.

use super::image_note::NewImages;

/// What a mosaic will take.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct MosaicCost {
    /// Whether it takes less than simulating the field itself.
    pub pays: bool,
    /// Images of sheets.
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
