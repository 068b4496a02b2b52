//! Thin films of light atoms: under particles, and on the faces of any specimen.

mod block_cache;
mod film_blocks;
pub(crate) mod film_imager;
mod film_overview;
mod film_scene;
pub(crate) mod grown_carbon;
mod particle_blocks;
mod samples;
pub(crate) mod surface_imager;
