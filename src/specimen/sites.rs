//! Lattice sites of a specimen.

use crate::engine::Site;
use crate::recipe::tables::PhononTable;

/// Sites are never further than this from the position of their column, in nm.
pub const DISPLACED_NM: f64 = 0.1;

/// What a lattice site holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SiteKind {
    /// The atom that belongs there.
    Pristine,
    /// Nothing.
    Vacancy,
    /// Another element.
    Substitution,
}

/// A lattice site of the specimen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpecimenSite {
    /// Unique in the specimen, whichever region is asked for.
    pub key: u64,
    /// Mean position in nm: x and y from the centre of pixel (0, 0) of the full field, z from the
    /// entrance surface.
    pub position_nm: [f64; 3],
    /// Atomic number; of a vacancy, that of the missing atom.
    pub number: u8,
    /// What the site holds.
    pub kind: SiteKind,
}

impl SpecimenSite {
    /// The atom here, in Angstrom from `corner_nm` (x, y) of the entrance surface; `None` for a vacancy.
    pub fn atom(&self, corner_nm: [f64; 2], phonons: &PhononTable) -> Option<Site> {
        let [x, y, z] = self.position_nm;
        (self.kind != SiteKind::Vacancy).then(|| Site {
            position: [10.0 * (x - corner_nm[0]), 10.0 * (y - corner_nm[1]), 10.0 * z],
            number: self.number,
            sigma_angstrom: phonons.sigma_angstrom(self.number),
            key: self.key,
        })
    }
}
