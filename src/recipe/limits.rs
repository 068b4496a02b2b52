//! Limits that recipes and specimens share.

/// Width in nm by which the specimen extends beyond the field on every side.
pub(crate) const BEYOND_FIELD_NM: f64 = 12.0;
/// Largest number of cells, from the origin of a grain across the beam, that the keys of atoms can distinguish.
pub(crate) const MOST_CELLS_ACROSS: i64 = 1 << 16;
/// Largest number of cells along the beam.
pub(crate) const MOST_CELLS_ALONG_BEAM: usize = 4000;
