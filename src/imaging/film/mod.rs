//! Particles on a thin film of light atoms.

mod block_cache;
mod film_blocks;
pub mod film_imager;
mod film_scene;
mod particle_blocks;
mod samples;
