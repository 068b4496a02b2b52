//! The mosaic: a world's image put together from exactly simulated units.
//!
//! The image around an atomic column depends on the displacements and the occupation of that column's own
//! atoms; those of its neighbours change it by less than 0.5 %. So units with the same contents in the same
//! surroundings share simulations, made once in small sheets ([`library`]) and kept on disk ([`cache`]). Each
//! pixel takes the image of the unit nearest to it, with narrow ramps halfway between units ([`assembly`]).
//! What is unlike anything else is simulated where it lies.
//!
//! Configuration by configuration the world is a definite set of atoms ([`atoms`]), which any engine can simulate
//! again.

mod assembly;
mod atoms;
mod cache;
mod engine;
mod library;
mod survey;

pub use atoms::DisplacedAtoms;
pub use cache::{Cache, Holding, VARIABLE as CACHE_VARIABLE};
pub use engine::{BLOCK_PX, Mosaic, MosaicEngine, Outlook, atoms_by_seed};
