//! Specimens that lose atoms under the beam: the map of doses, and the atoms left in each column.

pub(crate) mod damaged_specimen;
pub(crate) mod dose_map;
mod unit_patterns;
