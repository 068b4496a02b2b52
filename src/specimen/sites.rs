//! Lattice sites of a specimen.

use crate::engine::Site;
use crate::lengths;
use crate::recipe::tables::PhononTable;

/// Largest distance of a site from the position of its column, in nm.
pub const DISPLACED_NM: f64 = 0.1;

/// The contents of a lattice site.
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
    /// Number that is unique in the specimen and does not depend on the queried region.
    pub key: u64,
    /// Mean position in nm: x and y from the centre of pixel (0, 0) of the full field, z from the
    /// entrance surface.
    pub position_nm: [f64; 3],
    /// Atomic number; of a vacancy, the atomic number of the missing atom.
    pub number: u8,
    /// Contents of the site.
    pub kind: SiteKind,
}

impl SpecimenSite {
    /// Returns the atom of the site, in Angstrom from `corner_nm` (x, y) of the entrance surface; `None` for a vacancy.
    pub fn atom(&self, corner_nm: [f64; 2], phonons: &PhononTable) -> Option<Site> {
        let [x, y, z] = self.position_nm;
        (self.kind != SiteKind::Vacancy).then(|| Site {
            position: lengths::angstrom([x - corner_nm[0], y - corner_nm[1], z]),
            number: self.number,
            sigma_angstrom: phonons.sigma_angstrom(self.number),
            anisotropy: None,
            key: self.key,
        })
    }
}
