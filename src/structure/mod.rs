//! Atoms in a cell: data types, readers and writers, supercells.
//!
//! [`read()`] takes CIF, extended XYZ and POSCAR files; [`Structure::oriented`] rotates a crystal so that the beam runs along a zone axis;
//! [`Structure::resolve_occupancy`] draws mixed sites; and [`Structure::sites`] converts the atoms to the sites that the engine simulates.

mod alternatives;
mod atom_check;
mod cif;
pub(crate) mod coincidence;
pub(crate) mod columns;
pub mod crystals;
mod debye_waller;
pub mod direction;
mod displacement_tensor;
pub mod elements;
mod exclusive_sites;
mod foreign_formats;
mod frames;
mod labelled_atoms;
pub mod lattice;
mod mixed_sites;
mod neighbors;
mod orient;
mod overlap;
mod poscar;
mod preparation;
mod read;
mod site;
mod source_text;
mod supercell;
mod xyz;
mod xyz_labels;

pub use alternatives::Alternative;
pub(crate) use debye_waller::{ROOM_TEMPERATURE_K, tabulated_sigma_angstrom};
pub use displacement_tensor::{Anisotropy, DisplacementTensor};
pub use frames::{FrameRange, read_frames};
pub(crate) use labelled_atoms::{LabelledAtom, LabelledAtoms, SiteLabel};
pub(crate) use neighbors::for_each_pair;
pub use neighbors::{min_pair_distance, shortest_distances};
pub(crate) use orient::OrientedBox;
pub(crate) use preparation::Preparation;
#[cfg(all(test, feature = "hdf5"))]
pub(crate) use read::PARSED;
pub(crate) use read::parse_labelled;
pub use read::{
    FileSigmas, Format, ReadStructure, parse, parse_noted, read, read_noted, sigmas_of_file,
};
pub use site::{LARGEST_SIGMA_ANGSTROM, Sigmas, Site};

/// Upper bound of the distance of neighbouring pairs in any crystal, in Angstrom.
pub(crate) const PAIR_CUTOFF_ANGSTROM: f64 = 6.0;

use crate::error::{Error, Result};
use crate::setting::Setting;

/// One atom (or a partially occupied site).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Atom {
    /// Atomic number.
    pub number: u8,
    /// Cartesian position in Angstrom.
    pub position: [f64; 3],
    /// Fraction of the site that this atom occupies, in (0, 1].
    pub occupancy: f64,
    /// The place and the alternative that this atom belongs to, if the place can be filled in several ways.
    pub alternative: Option<Alternative>,
    /// Thermal displacement on the axes of `position`, if it differs with the direction.
    pub displacement: Option<DisplacementTensor>,
}

impl Atom {
    /// Makes an atom that occupies its site alone, at a position in Angstrom.
    pub fn new(number: u8, position: [f64; 3]) -> Self {
        Atom { number, position, occupancy: 1.0, alternative: None, displacement: None }
    }
}

/// Atoms in a (triclinic) cell; the beam runs along +z.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// Cell vectors as rows, in Angstrom.
    pub cell: [[f64; 3]; 3],
    /// The atoms.
    pub atoms: Vec<Atom>,
}

impl Structure {
    /// Returns the edge lengths of the cell if its vectors lie along x, y and z to within `1e-4` A.
    ///
    /// # Errors
    /// [`Error::Invalid`] for any other cell.
    pub fn orthogonal_box(&self) -> Result<[f64; 3]> {
        let off = (0..3).any(|i| (0..3).any(|j| i != j && self.cell[i][j].abs() > 1e-4));
        let lengths = [self.cell[0][0], self.cell[1][1], self.cell[2][2]];
        if off || lengths.iter().any(|&l| l <= 0.0) {
            return Err(Error::invalid(
                Setting::Cell,
                format!("{:?}", self.cell),
                "the simulation needs a box with edges along x, y and z; orient the crystal along a zone \
                 axis first",
            ));
        }
        Ok(lengths)
    }
}
