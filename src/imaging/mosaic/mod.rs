//! The mosaic: a world's image assembled from exactly simulated units.
//!
//! The image around an atomic column depends on the displacements and the occupation of its own atoms. The atoms of its neighbours change
//! it by less than 0.5 %. So units with equal contents and equal surroundings share simulations, made once in small cells
//! ([`image_library`]) and cached on disk ([`library_cache`]). The simulations for the program's own recipes are installed with it
//! (`supplied_library`). Each pixel shows the unit nearest to it, with narrow ramps halfway between units ([`assembly`]). Columns that do
//! not repeat are simulated at their place in the field. In crystals the recipe says which columns repeat; among the atoms of a file or a
//! stack they are found (`specimen::repeating_units`).
//!
//! In each phonon configuration the world is a definite set of atoms ([`super::displaced_atoms`]), which any engine can simulate again.

mod assembly;
mod bins;
mod cell_images;
mod dense_mean;
pub(crate) mod image_library;
pub(crate) mod image_note;
#[cfg(feature = "hdf5")]
pub mod library_archive;
pub(crate) mod library_cache;
mod missing_blocks;
pub(crate) mod mosaic_cost;
pub(crate) mod mosaic_imager;
pub(crate) mod shared_cells;
pub mod supplied_images;
#[cfg(feature = "hdf5")]
pub(crate) mod supplied_library;
pub(crate) mod survey;
mod unit_values;
