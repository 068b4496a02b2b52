//! Places that can be filled in several ways, for example by a molecule in one of two orientations.

use super::{Atom, Structure};

/// One of the ways in which a place can be filled. The atoms of one way occur together; the ways of one place exclude each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Alternative {
    /// Number of the place; every place in every cell has a different number.
    pub place: u32,
    /// Number of the way in which the place is filled.
    pub choice: u32,
}

/// Numbers the places of repeated cells.
pub(super) struct CopiedPlaces {
    /// Number of places in one cell.
    each: u32,
}

impl CopiedPlaces {
    pub fn of(structure: &Structure) -> Self {
        let places = structure.atoms.iter().filter_map(|a| a.alternative);
        CopiedPlaces { each: places.map(|a| a.place.saturating_add(1)).max().unwrap_or(0) }
    }

    /// Returns the atom in cell number `copy`, with the place number of that cell.
    pub fn atom(&self, atom: &Atom, copy: usize) -> Atom {
        let moved = |a: Alternative| Alternative {
            place: a.place.wrapping_add(self.each.wrapping_mul(copy as u32)),
            ..a
        };
        Atom { alternative: atom.alternative.map(moved), ..*atom }
    }
}
