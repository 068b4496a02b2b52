//! Amorphous carbon as a random network.

pub mod block;
pub mod dynamics;
pub mod film;
pub mod melt;
pub mod network;
mod tersoff;

/// A vector in Angstrom.
type Vec3 = [f64; 3];
