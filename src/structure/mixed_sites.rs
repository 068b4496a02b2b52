//! Draws the atoms on partially occupied sites.

use super::exclusive_sites::{ExclusiveSites, SiteUnit, units};
use super::overlap::FULLEST_SITE;
use super::{Atom, Structure};
use crate::error::{Error, Result};
use crate::rng::{Purpose, uniform};
use crate::setting::Setting;

/// Draws of a place: the alternative that fills it ...
const WAY: u32 = 0;
/// ... and the atoms on the sites of that alternative.
const WITHIN_WAY: u32 = 1;

impl Structure {
    /// Draws one atom, or none, for every site according to the occupancies. Atoms within 0.01 A of each other share a site; if their
    /// occupancies add to less than 1, the rest is the probability of a vacancy. Sites that exclude each other share one draw: the sites of
    /// one place of [`super::Alternative`], and partly occupied sites that are closer than any bond (1.2 A; less between C, N, O and H) and
    /// whose occupancies add to at most 1. A draw depends on `seed` and on the index of the first of these atoms only, so build the
    /// supercell first: otherwise all its cells are alike.
    ///
    /// # Errors
    /// [`Error::Invalid`] if an occupancy is outside (0, 1], or if the occupancies of a site or place exceed 1.
    pub fn resolve_occupancy(&self, seed: u64) -> Result<Structure> {
        for (index, atom) in self.atoms.iter().enumerate() {
            if !(atom.occupancy > 0.0 && atom.occupancy <= 1.0) {
                let value = format!("{} (atom {})", atom.occupancy, index + 1);
                return Err(Error::invalid(
                    Setting::Occupancy,
                    value,
                    "expected a number in (0, 1]",
                ));
            }
        }
        if self.atoms.iter().all(|a| a.occupancy == 1.0 && a.alternative.is_none()) {
            return Ok(self.clone());
        }
        let exclusive = ExclusiveSites::of(self);
        let mut chosen = Vec::with_capacity(self.atoms.len());
        for (first, members) in exclusive.members().iter().enumerate() {
            if let Some(unit) = self.choose(seed, first, units(self, &exclusive.site, members))? {
                self.fill(seed, &unit, &exclusive.site, &mut chosen);
            }
        }
        chosen.sort_by_key(|&(order, _)| order);
        let full = |(_, atom): (usize, usize)| Atom {
            occupancy: 1.0,
            alternative: None,
            ..self.atoms[atom]
        };
        Ok(Structure { cell: self.cell, atoms: chosen.into_iter().map(full).collect() })
    }

    fn choose(&self, seed: u64, first: usize, units: Vec<SiteUnit>) -> Result<Option<SiteUnit>> {
        let total: f64 = units.iter().map(|unit| unit.occupancy).sum();
        if total > FULLEST_SITE {
            let value = format!("{total:.4} (site of atom {})", first + 1);
            return Err(Error::invalid(
                Setting::SiteOccupancy,
                value,
                "expected at most 1; lower them or remove an atom",
            ));
        }
        let draw = uniform(seed, Purpose::Occupancy, WAY, first as u64) * total.max(1.0);
        let (mut below, mut last) = (0.0, None);
        for unit in units {
            below += unit.occupancy;
            if draw < below {
                return Ok(Some(unit));
            }
            last = Some(unit);
        }
        // Rounding must not leave a full site empty.
        Ok(last.filter(|_| total > 1.0 - 1e-9))
    }

    /// Fills the sites of a unit: each with one of its atoms, or with none if its atoms occur less often than the unit. The chosen atoms
    /// are listed with the smallest index on their site.
    fn fill(&self, seed: u64, unit: &SiteUnit, site: &[usize], chosen: &mut Vec<(usize, usize)>) {
        if let &[only] = unit.atoms.as_slice() {
            return chosen.push((site[only], only));
        }
        let mut sites: Vec<usize> = unit.atoms.iter().map(|&atom| site[atom]).collect();
        sites.sort_unstable();
        sites.dedup();
        for place in sites {
            let draw = uniform(seed, Purpose::Occupancy, WITHIN_WAY, place as u64) * unit.occupancy;
            let mut below = 0.0;
            let found = unit.atoms.iter().filter(|&&atom| site[atom] == place).find(|&&atom| {
                below += self.atoms[atom].occupancy;
                draw < below
            });
            chosen.extend(found.map(|&atom| (place, atom)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Atom;
    use super::*;

    /// Chains of sites: one with Sr (0.6) and Ba (0.3), one full with O.
    fn chain(n: usize) -> Structure {
        let mut atoms = Vec::new();
        for i in 0..n {
            let z = 4.0 * i as f64;
            atoms.push(Atom { occupancy: 0.6, ..Atom::new(38, [0.0, 0.0, z]) });
            atoms.push(Atom::new(8, [2.0, 2.0, z]));
            atoms.push(Atom { occupancy: 0.3, ..Atom::new(56, [4.0, 0.0, z + 0.004]) });
        }
        let cell = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0 * n as f64]];
        Structure { cell, atoms }
    }

    #[test]
    fn frequencies_are_the_occupancies() {
        let n = 20_000;
        let resolved = chain(n).resolve_occupancy(5).unwrap();
        let count = |z: u8| resolved.atoms.iter().filter(|a| a.number == z).count() as f64;
        assert_eq!(count(8), n as f64);
        assert!((count(38) / n as f64 - 0.6).abs() < 0.015);
        assert!((count(56) / n as f64 - 0.3).abs() < 0.015);
        assert!(resolved.atoms.iter().all(|a| a.occupancy == 1.0));
        let nearest = super::super::min_pair_distance(&resolved).unwrap();
        assert!(nearest > 2.0, "two atoms on one site: {nearest}");
    }

    #[test]
    fn the_seed_decides_and_nothing_else() {
        let a = chain(50).resolve_occupancy(1).unwrap();
        assert_eq!(a, chain(50).resolve_occupancy(1).unwrap());
        assert_ne!(a, chain(50).resolve_occupancy(2).unwrap());
        assert_eq!(a, a.resolve_occupancy(9).unwrap());
    }

    #[test]
    fn overfull_sites_are_errors() {
        let mut s = chain(1);
        s.atoms[2].occupancy = 0.5;
        let error = s.resolve_occupancy(1).unwrap_err().to_string();
        assert!(error.contains("1.1000 (site of atom 1)"), "{error}");
        s.atoms[2].occupancy = f64::NAN;
        assert!(s.resolve_occupancy(1).is_err());
    }
}
