//! Specimens that lose atoms under the beam: the dose at every place, and what it has left of each column.

pub mod damaged_specimen;
pub mod dose_map;
mod unit_patterns;
