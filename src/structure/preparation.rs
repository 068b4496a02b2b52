//! Prepares the atoms of a file for simulation: rotates, strains and repeats the structure, and draws mixed sites.

use super::lattice::{face_distances, inverse, row_times};
use super::{ReadStructure, Structure};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Atoms further than this outside their cell, in Angstrom, are more than displaced, and are reported.
const OUTSIDE_ANGSTROM: f64 = 0.5;
/// Strain below this is rounding of the file, and is not reported.
const REPORTED_STRAIN: f64 = 1e-5;

/// Settings of the preparation of a structure.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Preparation {
    /// Lattice direction along the beam.
    pub zone: Option<[i32; 3]>,
    /// Lattice direction along +y.
    pub up: Option<[i32; 3]>,
    /// Largest principal strain in per cent that may make the box orthogonal. With `None`, angles within 1 mrad of right angles are made
    /// right if a zone is given.
    pub max_strain_percent: Option<f64>,
    /// Number of repetitions of the box along x, y and the beam.
    pub repeat: Option<[usize; 3]>,
    /// Seed of mixed sites.
    pub seed: u64,
}

/// A structure in an orthogonal box, with all sites occupied.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PreparedStructure {
    /// The atoms.
    pub structure: Structure,
    /// Edges of the box in Angstrom.
    pub size_angstrom: [f64; 3],
    /// Warnings, as sentences for the user.
    pub notes: Vec<String>,
    /// Largest principal strain in per cent that made the box orthogonal, if there was any.
    pub strain_percent: Option<f64>,
}

impl Preparation {
    /// Rotates, strains and repeats a structure, and draws the atoms of mixed sites.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a cell that cannot be made orthogonal, sites that are too full, and too many atoms or none.
    pub(crate) fn prepare(&self, read: ReadStructure) -> Result<PreparedStructure> {
        let ReadStructure { mut structure, mut notes } = read;
        notes.extend(atoms_outside(&structure));
        let mut strain_percent = None;
        if self.zone.is_some() || self.up.is_some() || self.max_strain_percent.is_some() {
            let limit = self.max_strain_percent.map(|percent| 0.01 * percent);
            let zone = self.zone.unwrap_or([0, 0, 1]);
            let made = structure.oriented_within(zone, self.up, limit)?;
            structure = made.structure;
            if made.strain > REPORTED_STRAIN {
                strain_percent = Some(100.0 * made.strain);
                notes.push(format!(
                    "the cell was strained by {:.3} % to make its angles 90 degrees",
                    100.0 * made.strain
                ));
            }
        }
        if let Some(count) = self.repeat {
            structure = structure.repeat(count)?;
        }
        let structure = structure.resolve_occupancy(self.seed)?;
        if structure.atoms.is_empty() {
            return Err(Error::invalid(Setting::StructureFile, "no atoms", "nothing to simulate"));
        }
        let size_angstrom = structure.orthogonal_box()?;
        Ok(PreparedStructure { structure, size_angstrom, notes, strain_percent })
    }
}

/// Reports atoms outside their cell.
fn atoms_outside(structure: &Structure) -> Option<String> {
    let inverse = inverse(&structure.cell)?;
    let heights = face_distances(&structure.cell);
    let beyond = |position: [f64; 3]| {
        let u = row_times(position, &inverse);
        (0..3).map(|k| heights[k] * (-u[k]).max(u[k] - 1.0)).fold(0.0, f64::max)
    };
    let far = structure.atoms.iter().map(|a| beyond(a.position)).filter(|d| *d > OUTSIDE_ANGSTROM);
    let (count, most) = far.fold((0, 0.0), |(n, most): (usize, f64), d| (n + 1, most.max(d)));
    (count > 0).then(|| {
        format!(
            "{count} of {} atoms lie outside the cell, up to {most:.1} A; the cell is periodic, so they appear on its other side. If atoms \
             were rotated without their cell, put them into a larger one (ASE: atoms.rotate(..., rotate_cell=True), or \
             atoms.center(vacuum=5)); if the cell does not begin at 0, give its origin (Origin=\"x y z\" in extended XYZ)",
            structure.atoms.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::Atom;

    const CELL: [[f64; 3]; 3] = [[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 5.0]];

    #[test]
    fn atoms_far_outside_are_counted() {
        let atom = |x: f64| Atom::new(14, [x, 1.0, 1.0]);
        let inside = Structure { cell: CELL, atoms: vec![atom(-0.3), atom(5.4)] };
        assert_eq!(atoms_outside(&inside), None);
        let outside = Structure { cell: CELL, atoms: vec![atom(1.0), atom(-2.0), atom(6.5)] };
        let message = atoms_outside(&outside).unwrap();
        assert!(message.starts_with("2 of 3 atoms lie outside the cell, up to 2.0 A"), "{message}");
    }

    #[test]
    fn strain_is_reported() {
        let mut cell = CELL;
        cell[1][0] = 0.05;
        let structure = Structure { cell, atoms: vec![Atom::new(14, [0.0; 3])] };
        let read = ReadStructure { structure, notes: Vec::new() };
        let preparation = Preparation { max_strain_percent: Some(1.0), ..Preparation::default() };
        let made = preparation.prepare(read.clone()).unwrap();
        assert!((made.strain_percent.unwrap() - 0.5).abs() < 0.01);
        assert!(made.notes[0].contains("strained by 0.50"), "{:?}", made.notes);
        assert!(Preparation::default().prepare(read).is_err());
    }
}
