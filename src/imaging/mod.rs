//! Imaging: the noise-free image of any rectangle of a field.
//!
//! specimen -> slices -> engine -> detector image.

pub mod audit;
pub mod choose;
pub mod displaced_atoms;
pub mod film;
pub mod mosaic;
pub mod pixels;
pub mod progress_share;
pub mod region_imager;
pub mod simulator;
