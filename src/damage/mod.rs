//! Damage by the beam: the probability that an electron displaces an atom.

mod atomic_masses;
mod damage_table;
mod knock_on;

pub use atomic_masses::atomic_mass;
pub use damage_table::{BARN_ANGSTROM2, DamageTable};
pub use knock_on::{greatest_transfer_ev, knock_on_angstrom2, vibrating_knock_on_angstrom2};
