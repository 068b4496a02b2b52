//! Models: atoms that the program generates.
//!
//! [`carbon`] grows amorphous films by molecular dynamics; [`particles`] builds clusters of metals by Wulff's construction, as
//! decahedra and as icosahedra.

pub mod carbon;
pub mod particles;
