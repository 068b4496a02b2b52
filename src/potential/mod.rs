//! Projected potentials of atoms: scattering factors, slices, structure factors.

mod bessel;
pub(crate) mod cores;
pub(crate) mod projected;
pub(crate) mod scattering;
pub(crate) mod slices;

pub use projected::Projection;
pub use scattering::Parametrization;
pub use slices::{Slices, Slicing};
