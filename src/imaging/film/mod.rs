//! Thin films of light atoms: under particles, and on the faces of any specimen.

mod block_cache;
mod film_blocks;
pub mod film_imager;
mod film_overview;
mod film_scene;
pub mod grown_carbon;
mod particle_blocks;
mod samples;
pub mod surface_imager;
