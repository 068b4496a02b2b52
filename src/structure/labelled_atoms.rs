//! Atoms with labels from their file: whether an atom is a defect, and the phase or grain that it belongs to.

use super::{Structure, elements};

/// Label of a site in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) enum SiteLabel {
    /// The atom belongs there, or there is no label.
    #[default]
    Pristine,
    /// The atom is missing.
    Vacancy,
    /// The atom is a defect.
    Substitution,
}

/// A site of a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LabelledAtom {
    /// Cartesian position in Angstrom.
    pub position: [f64; 3],
    /// Atomic number; of a vacancy, the atomic number of the missing atom.
    pub number: u8,
    /// Label of the site.
    pub label: SiteLabel,
    /// Index into [`LabelledAtoms::groups`]; 0 where there are none.
    pub group: u16,
}

/// The sites of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct LabelledAtoms {
    /// Cell vectors as rows, in Angstrom.
    pub cell: [[f64; 3]; 3],
    /// The sites, in the order of the file.
    pub atoms: Vec<LabelledAtom>,
    /// Names of the phases that the file distinguishes, or of the grains if it names no phases.
    pub groups: Vec<String>,
    /// Warnings about the file, as sentences for the user.
    pub notes: Vec<String>,
}

impl LabelledAtoms {
    /// Takes atoms without labels.
    ///
    /// # Errors
    /// A message about a site that is partly occupied.
    pub(super) fn of(structure: &Structure, notes: Vec<String>) -> Result<Self, String> {
        let site = |(n, atom): (usize, &super::Atom)| {
            if atom.occupancy != 1.0 {
                return Err(partly_occupied(&format!("atom {}", n + 1), atom.occupancy));
            }
            let (position, number) = (atom.position, atom.number);
            Ok(LabelledAtom { position, number, label: SiteLabel::Pristine, group: 0 })
        };
        let atoms = structure.atoms.iter().enumerate().map(site).collect::<Result<_, _>>()?;
        Ok(LabelledAtoms { cell: structure.cell, atoms, groups: Vec::new(), notes })
    }

    /// Returns the least and the greatest coordinate along each axis, in Angstrom.
    pub(crate) fn extent(&self) -> [[f64; 2]; 3] {
        let ends = |mut ends: [f64; 2], x: f64| {
            ends = [ends[0].min(x), ends[1].max(x)];
            ends
        };
        let along = |k: usize| {
            self.atoms.iter().map(|a| a.position[k]).fold([f64::INFINITY, f64::NEG_INFINITY], ends)
        };
        [along(0), along(1), along(2)]
    }

    /// Returns the symbols of the elements that occur, sorted.
    pub(crate) fn elements(&self) -> Vec<String> {
        let mut there = [false; 256];
        for atom in self.atoms.iter().filter(|a| a.label != SiteLabel::Vacancy) {
            there[usize::from(atom.number)] = true;
        }
        let numbers = (1..=u8::MAX).filter(|n| there[usize::from(*n)]);
        let mut symbols: Vec<String> = numbers.map(|n| elements::symbol(n).to_owned()).collect();
        symbols.sort();
        symbols
    }
}

/// Returns the message about a site that may or may not hold an atom.
pub(super) fn partly_occupied(which: &str, occupancy: f64) -> String {
    format!(
        "{which} has the occupancy {occupancy}: each site of a world holds one atom or is vacant; expected 1, or 0 for a vacant site. Draw \
         the atoms of mixed sites first"
    )
}
