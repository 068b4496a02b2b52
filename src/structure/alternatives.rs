//! Places that can be filled in several ways, such as a molecule that stands in one of two orientations.

use super::{Atom, Structure};

/// One of the ways in which a place can be filled. Atoms of one way stand together; ways of one place exclude each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Alternative {
    /// Number of the place; each place of each cell has its own.
    pub place: u32,
    /// Number of the way in which the place is filled.
    pub choice: u32,
}

/// Numbers the places of repeated cells.
pub(super) struct CopiedPlaces {
    /// Places of one cell.
    each: u32,
}

impl CopiedPlaces {
    pub fn of(structure: &Structure) -> Self {
        let places = structure.atoms.iter().filter_map(|a| a.alternative);
        CopiedPlaces { each: places.map(|a| a.place.saturating_add(1)).max().unwrap_or(0) }
    }

    /// The atom as one of the cell number `copy`, with places of its own.
    pub fn atom(&self, atom: &Atom, copy: usize) -> Atom {
        let moved = |a: Alternative| Alternative {
            place: a.place.wrapping_add(self.each.wrapping_mul(copy as u32)),
            ..a
        };
        Atom { alternative: atom.alternative.map(moved), ..*atom }
    }
}
