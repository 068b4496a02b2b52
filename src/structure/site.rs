//! Lattice sites for the simulation: atoms that vibrate.

use super::{Anisotropy, Atom, Structure, elements};
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::collections::BTreeMap;

/// Largest accepted standard deviation, in Angstrom: above, the crystal has melted.
pub const LARGEST_SIGMA_ANGSTROM: f64 = 1.0;

/// A lattice site for the engine: its mean position and its vibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Mean position in Angstrom, in the frame of the simulated box; the beam runs along +z.
    pub position: [f64; 3],
    /// Atomic number.
    pub number: u8,
    /// Standard deviation of each Cartesian component of the thermal displacement, in Angstrom; with an anisotropy, the root mean square of
    /// the three.
    pub sigma_angstrom: f64,
    /// Dependence of the displacement on the direction, if there is one.
    pub anisotropy: Option<Anisotropy>,
    /// Identifies the site for the random numbers: its displacement in configuration `c` depends on (seed, c, key) only, and not on the
    /// simulated box.
    pub key: u64,
}

impl Site {
    /// Returns the mean square displacements `<u_i u_j>` in square Angstrom.
    pub fn displacement_tensor(&self) -> [[f64; 3]; 3] {
        let square = self.sigma_angstrom * self.sigma_angstrom;
        match self.anisotropy {
            Some(anisotropy) => anisotropy.tensor(self.sigma_angstrom),
            None => [[square, 0.0, 0.0], [0.0, square, 0.0], [0.0, 0.0, square]],
        }
    }
}

/// Vibration of the atoms of a structure: the standard deviation of each Cartesian component of their thermal displacements, in Angstrom.
#[derive(Debug, Clone, PartialEq)]
pub enum Sigmas {
    /// Atoms do not vibrate.
    None,
    /// One value for all elements.
    All(f64),
    /// Values by atomic number.
    ByElement(BTreeMap<u8, f64>),
    /// The displacement of each atom ([`Atom::displacement`]); values by atomic number for atoms without one.
    OfAtoms(BTreeMap<u8, f64>),
}

impl Sigmas {
    /// Returns the standard deviation of an atom in Angstrom, and how its displacement depends on the direction.
    fn of_atom(&self, atom: &Atom) -> Result<(f64, Option<Anisotropy>)> {
        match (self, atom.displacement) {
            (Sigmas::OfAtoms(_), Some(own)) => Ok((own.sigma_angstrom(), own.anisotropy())),
            _ => Ok((self.of(atom.number)?, None)),
        }
    }

    /// Returns the standard deviation of an element in Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an element without a value, and for a value outside 0 to 1 A.
    pub fn of(&self, number: u8) -> Result<f64> {
        let sigma = match self {
            Sigmas::None => 0.0,
            Sigmas::All(sigma) => *sigma,
            Sigmas::ByElement(values) | Sigmas::OfAtoms(values) => {
                *values.get(&number).ok_or_else(|| {
                    let symbol = elements::symbol(number);
                    let value = format!("none for {symbol}");
                    Error::invalid(
                        Setting::ThermalSigma,
                        value,
                        format!("add one for {symbol}, in A"),
                    )
                })?
            }
        };
        if (0.0..=LARGEST_SIGMA_ANGSTROM).contains(&sigma) {
            return Ok(sigma);
        }
        let expected = format!("expected a length from 0 to {LARGEST_SIGMA_ANGSTROM} A");
        Err(Error::invalid(Setting::ThermalSigma, sigma, expected))
    }
}

impl Structure {
    /// Converts the atoms to sites of a simulation, in their order, with the standard deviations `sigmas`. Positions are in Angstrom; the
    /// key of a site is the index of its atom.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the name of an element without a standard deviation, for a value outside 0 to 1 A, and for sites that are
    /// partly occupied: [`Structure::resolve_occupancy`] draws their atoms first.
    pub fn sites(&self, sigmas: &Sigmas) -> Result<Vec<Site>> {
        let site = |(index, atom): (usize, &Atom)| {
            if atom.occupancy != 1.0 {
                let value = format!("{} (atom {})", atom.occupancy, index + 1);
                let expected = "draw the atoms of mixed sites first";
                return Err(Error::invalid(Setting::Occupancy, value, expected));
            }
            let (sigma_angstrom, anisotropy) = sigmas.of_atom(atom)?;
            Ok(Site {
                position: atom.position,
                number: atom.number,
                sigma_angstrom,
                anisotropy,
                key: index as u64,
            })
        };
        self.atoms.iter().enumerate().map(site).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Atom;
    use super::*;

    fn structure() -> Structure {
        let atom = |number, x| Atom::new(number, [x, 1.0, 2.0]);
        let cell = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
        Structure { cell, atoms: vec![atom(38, 0.5), atom(8, 2.5)] }
    }

    #[test]
    fn sites_are_the_atoms_in_their_order() {
        let both = Sigmas::ByElement(BTreeMap::from([(8, 0.085), (38, 0.084)]));
        let sites = structure().sites(&both).unwrap();
        assert_eq!(
            sites[1],
            Site {
                position: [2.5, 1.0, 2.0],
                number: 8,
                sigma_angstrom: 0.085,
                anisotropy: None,
                key: 1,
            }
        );
        assert_eq!((sites[0].number, sites[0].sigma_angstrom, sites[0].key), (38, 0.084, 0));
        let sigmas = |s: Sigmas| -> Vec<f64> {
            structure().sites(&s).unwrap().iter().map(|s| s.sigma_angstrom).collect()
        };
        assert_eq!(sigmas(Sigmas::None), [0.0, 0.0]);
        assert_eq!(sigmas(Sigmas::All(0.1)), [0.1, 0.1]);
    }

    #[test]
    fn what_cannot_be_simulated_is_named() {
        let message = |structure: &Structure, sigmas: Sigmas| {
            structure.sites(&sigmas).unwrap_err().to_string()
        };
        let only_sr = Sigmas::ByElement(BTreeMap::from([(38, 0.084)]));
        let missing = message(&structure(), only_sr);
        assert!(missing.contains("none for O") && missing.contains("sigma (A)"), "{missing}");
        for wrong in [-0.1, 1.5, f64::NAN] {
            assert!(message(&structure(), Sigmas::All(wrong)).contains("from 0 to 1 A"));
        }
        let mut mixed = structure();
        mixed.atoms[1].occupancy = 0.5;
        assert!(message(&mixed, Sigmas::None).contains("0.5 (atom 2)"));
    }
}
