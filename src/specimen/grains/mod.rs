//! Crystals in grains with symmetric tilt boundaries between them.

mod boundary;
mod boundary_motif;
mod grain;
pub(crate) mod tilt_grains;
