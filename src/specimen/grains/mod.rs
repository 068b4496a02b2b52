//! Crystals in grains with symmetric tilt boundaries between them.

pub mod boundary;
pub mod boundary_motif;
pub mod grain;
pub mod tilt_grains;
