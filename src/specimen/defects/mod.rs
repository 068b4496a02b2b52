//! Which lattice sites are vacant or hold another element.

pub mod clusters;
pub mod rules;
pub mod vacancies;
