//! Projected potentials of atoms: scattering factors, slices, structure factors.

mod bessel;
pub mod cores;
pub mod projected;
pub mod scattering;
pub mod slices;
