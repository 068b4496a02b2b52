//! Finds atoms in one place.

use std::ops::ControlFlow;

use super::{Structure, elements, neighbors};

/// Atoms closer than this, in Angstrom, must share one site by their occupancies.
pub(super) const OVERLAP: f64 = 0.3;
/// Largest number of atoms within the distance of an overlap that can be one site.
const MOST_ON_A_SITE: usize = 200;
/// Sum of occupancies accepted on one site; above 1 for the sake of rounded thirds.
pub(super) const FULLEST_SITE: f64 = 1.005;

/// Atoms that cannot be present together.
pub(super) enum Overlap {
    /// Two atoms, and their distance in Angstrom.
    Pair { first: usize, second: usize, distance: f64 },
    /// One atom and many others.
    Crowd { first: usize },
}

impl Overlap {
    /// Finds the first overlap of a structure.
    pub fn of(structure: &Structure) -> Option<Self> {
        let mut fault: Option<(usize, usize, f64)> = None;
        let (mut first, mut near) = (0, 0);
        // The search stops at the first faulty atom: a million atoms in one place have too many pairs.
        let _ = neighbors::try_each_pair(structure, OVERLAP, |i, j, distance| {
            if i != first {
                (first, near) = (i, 0);
            }
            near += 1;
            if fault.is_some_and(|(a, _, _)| a < i) || near > MOST_ON_A_SITE && fault.is_none() {
                return ControlFlow::Break(());
            }
            let together = structure.atoms[i].occupancy + structure.atoms[j].occupancy;
            if together > FULLEST_SITE && fault.is_none_or(|(a, b, _)| (i, j) < (a, b)) {
                fault = Some((i, j, distance));
            }
            ControlFlow::Continue(())
        });
        match fault {
            Some((first, second, distance)) => Some(Overlap::Pair { first, second, distance }),
            None => (near > MOST_ON_A_SITE).then_some(Overlap::Crowd { first }),
        }
    }

    /// Returns the atom that an error names.
    pub fn atom(&self) -> usize {
        match *self {
            Overlap::Pair { second, .. } => second,
            Overlap::Crowd { first } => first,
        }
    }

    /// Describes the fault: `this` stands for that atom, and `place` describes where another atom is listed.
    pub fn describe(
        &self,
        structure: &Structure,
        this: &str,
        place: impl Fn(usize) -> String,
    ) -> String {
        let name = |k: usize| elements::symbol(structure.atoms[k].number);
        match *self {
            Overlap::Crowd { .. } => format!(
                "more than {MOST_ON_A_SITE} atoms (or their periodic images) lie within {OVERLAP} A of this one"
            ),
            Overlap::Pair { first, second, distance } => format!(
                "{this} {} and the {} of {} (or their periodic images) are {distance:.3} A apart, \
                 and together occupy more than one site; remove one, or give coordinates on special \
                 positions with more digits",
                name(second),
                name(first),
                place(first)
            ),
        }
    }
}
