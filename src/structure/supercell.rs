//! Repeats cells.

use super::alternatives::CopiedPlaces;
use super::lattice::{Vec3, row_times};
use super::{Atom, Structure};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Largest number of atoms in a supercell.
const MOST_ATOMS: u128 = 500_000_000;

/// Fails if `cells` cells of `atoms` atoms have too many atoms.
pub(super) fn check_size(cells: u128, atoms: usize) -> Result<()> {
    if cells.saturating_mul(atoms as u128) > MOST_ATOMS {
        return Err(Error::invalid(
            Setting::SupercellAtoms,
            cells.saturating_mul(atoms as u128),
            format!("expected at most {MOST_ATOMS}; repeat the cell less often"),
        ));
    }
    Ok(())
}

impl Structure {
    /// Repeats the cell `count` times along its vectors, cell by cell, the last axis fastest.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a count is zero or there would be more than 5e8 atoms.
    pub fn repeat(&self, count: [usize; 3]) -> Result<Structure> {
        if count.contains(&0) {
            let expected = "each of the three numbers must be at least 1";
            return Err(Error::invalid(Setting::Repeat, format!("{count:?}"), expected));
        }
        let cells = count.iter().try_fold(1u128, |n, &c| n.checked_mul(c as u128));
        check_size(cells.unwrap_or(u128::MAX), self.atoms.len())?;
        let mut atoms = Vec::with_capacity(count.iter().product::<usize>() * self.atoms.len());
        let places = CopiedPlaces::of(self);
        for i in 0..count[0] {
            for j in 0..count[1] {
                for k in 0..count[2] {
                    let shift = row_times([i, j, k].map(|n| n as f64), &self.cell);
                    let copy = (i * count[1] + j) * count[2] + k;
                    atoms.extend(self.atoms.iter().map(|a| places.atom(&moved(a, shift), copy)));
                }
            }
        }
        let cell = std::array::from_fn(|i| self.cell[i].map(|x| x * count[i] as f64));
        Ok(Structure { cell, atoms })
    }
}

fn moved(atom: &Atom, shift: Vec3) -> Atom {
    let position = std::array::from_fn(|axis| atom.position[axis] + shift[axis]);
    Atom { position, ..*atom }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_and_refuses() {
        let s = Structure {
            cell: [[3.0, 0.0, 0.0], [1.0, 4.0, 0.0], [0.0, 0.0, 5.0]],
            atoms: vec![Atom { occupancy: 0.5, ..Atom::new(6, [0.5, 0.0, 0.0]) }],
        };
        let r = s.repeat([1, 2, 2]).unwrap();
        assert_eq!(r.cell, [[3.0, 0.0, 0.0], [2.0, 8.0, 0.0], [0.0, 0.0, 10.0]]);
        let positions: Vec<_> = r.atoms.iter().map(|a| a.position).collect();
        assert_eq!(positions, [[0.5, 0.0, 0.0], [0.5, 0.0, 5.0], [1.5, 4.0, 0.0], [1.5, 4.0, 5.0]]);
        assert_eq!(r.atoms[3].occupancy, 0.5);
        assert_eq!(s.repeat([1, 1, 1]).unwrap(), s);
        assert!(s.repeat([1, 0, 1]).is_err());
        assert!(s.repeat([usize::MAX; 3]).is_err());
    }
}
