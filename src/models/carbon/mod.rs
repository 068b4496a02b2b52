//! Amorphous carbon as a random network of 2.0 g/cm3.
//!
//! [`block`] is a periodic cube quenched from the melt (`melt`) in Tersoff's potential; it is installed with the program. `carbon_film`
//! makes a film of any extent from it. `dynamics` moves the atoms of a `network`.

use crate::structure::lattice::Vec3;

pub mod block;
pub(crate) mod carbon_film;
mod dynamics;
mod melt;
pub(crate) mod network;
mod tersoff;

pub use carbon_film::{CELL, Film, FilmAtom, LEAST_DISTANCE, unfolded};
pub use melt::Melt;
pub use network::{Neighbours, Network};
