//! Damage by the beam: the probability that an electron displaces an atom.

mod atomic_masses;
mod damage_table;
mod knock_on;

pub(crate) use atomic_masses::atomic_mass;
pub use damage_table::DamageTable;
