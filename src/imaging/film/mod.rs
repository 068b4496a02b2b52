//! Particles on a thin film of light atoms.

pub mod film_imager;
