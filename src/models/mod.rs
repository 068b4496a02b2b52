//! Models: atoms that the program generates.
//!
//! [`carbon`] grows amorphous films by molecular dynamics; [`particles`] builds clusters of metals by Wulff's construction, as
//! decahedra and as icosahedra; `stack` joins crystals and packs amorphous layers, with faults and dislocations.

pub mod carbon;
pub mod particles;
pub(crate) mod stack;
