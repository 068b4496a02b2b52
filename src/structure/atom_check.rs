//! Checks of atoms that do not come from a file.

use super::overlap::Overlap;
use super::source_text::{FARTHEST, check_cell};
use super::{Atom, Structure, elements};
use crate::error::{Error, Result};
use crate::setting::Setting;

impl Structure {
    /// Checks atoms like the atoms of a file: the cell has a volume, positions are finite, elements exist, occupancies lie above 0 and up
    /// to 1, and no two atoms are in one place.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the number of the atom, from 0.
    pub(crate) fn checked(self) -> Result<Self> {
        let fault = |value: String, expected: String| {
            Err(Error::invalid(Setting::StructureFile, value, expected))
        };
        if let Err(message) = check_cell(&self.cell) {
            return fault(format!("cell {:?}", self.cell), message);
        }
        for (number, atom) in self.atoms.iter().enumerate() {
            let Atom { position, occupancy, .. } = atom;
            if !position.iter().all(|x| x.abs() <= FARTHEST) {
                let value = format!("atoms[{number}] at {position:?} A");
                return fault(value, "expected a position near the cell".into());
            }
            if !(*occupancy > 0.0 && *occupancy <= 1.0) {
                let value = format!("atoms[{number}] with occupancy {occupancy}");
                return fault(value, "expected above 0, to 1".into());
            }
            if !(1..=elements::MAX_ATOMIC_NUMBER).contains(&atom.number) {
                let value = format!("atoms[{number}] with atomic number {}", atom.number);
                return fault(value, format!("expected 1 to {}", elements::MAX_ATOMIC_NUMBER));
            }
        }
        match Overlap::of(&self) {
            None => Ok(self),
            Some(overlap) => {
                let message = overlap.describe(&self, "this", |first| format!("atoms[{first}]"));
                fault(format!("atoms[{}]", overlap.atom()), message)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_files_are_refused_for_is_refused() {
        let cell = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
        let of = |cell, atoms: Vec<Atom>| match (Structure { cell, atoms }).checked() {
            Ok(_) => String::new(),
            Err(error) => error.to_string(),
        };
        let at = |x: f64| Atom::new(14, [x, 1.0, 1.0]);
        assert_eq!(of(cell, vec![at(1.0), at(3.0)]), "");
        let text = of(cell, vec![at(1.0), at(3.0), at(1.0)]);
        assert!(text.contains("atoms[2]: this Si and the Si of atoms[0]"), "{text}");
        let half = Atom { occupancy: 0.5, ..at(1.0) };
        assert_eq!(of(cell, vec![half, half]), "");
        assert!(of(cell, vec![Atom { occupancy: 0.0, ..at(1.0) }]).contains("occupancy 0"));
        assert!(of(cell, vec![at(f64::NAN)]).contains("near the cell"));
        assert!(of(cell, vec![Atom::new(0, [0.0; 3])]).contains("atomic number 0"));
        assert!(of([cell[0], cell[0], cell[2]], vec![at(1.0)]).contains("no volume"));
    }
}
