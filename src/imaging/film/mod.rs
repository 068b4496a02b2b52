//! Particles on a thin film of light atoms.

pub mod film_imager;
mod particle_blocks;
mod samples;
