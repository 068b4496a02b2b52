//! Which atom stands on a partially occupied site.

use super::source_text::FULLEST_SITE;
use super::{Structure, neighbors};
use crate::error::{Error, Result};
use crate::rng::{Purpose, uniform};
use crate::setting::Setting;

/// Atoms nearer than this, in Angstrom, share one site.
const SAME_SITE: f64 = 0.01;

impl Structure {
    /// Draws one atom, or none, for every site according to the occupancies. Atoms within 0.01 A
    /// of each other share a site, and what their occupancies lack to 1 is the probability of a
    /// vacancy. The draw of a site depends on `seed` and on the index of its first atom only, so
    /// build the supercell first: otherwise all its cells look alike.
    ///
    /// # Errors
    /// [`Error::Invalid`] if an occupancy is outside (0, 1] or those of a site exceed 1.
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
        let first = self.first_of_site();
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); self.atoms.len()];
        for (index, &site) in first.iter().enumerate() {
            members[site].push(index);
        }
        let mut atoms = Vec::with_capacity(self.atoms.len());
        for (site, members) in members.iter().enumerate() {
            if let Some(chosen) = self.choose(seed, site, members)? {
                let mut atom = self.atoms[chosen];
                atom.occupancy = 1.0;
                atoms.push(atom);
            }
        }
        Ok(Structure { cell: self.cell, atoms })
    }

    /// For every atom the smallest index on its site.
    fn first_of_site(&self) -> Vec<usize> {
        let mut first: Vec<usize> = (0..self.atoms.len()).collect();
        if self.atoms.iter().all(|a| a.occupancy == 1.0) {
            return first;
        }
        // `i` never falls, so that `first[i]` is final when it is copied to j.
        neighbors::for_each_pair(self, SAME_SITE, |i, j, _| first[j] = first[j].min(first[i]));
        first
    }

    fn choose(&self, seed: u64, site: usize, members: &[usize]) -> Result<Option<usize>> {
        if let &[only] = members
            && self.atoms[only].occupancy == 1.0
        {
            return Ok(Some(only));
        }
        let total: f64 = members.iter().map(|&m| self.atoms[m].occupancy).sum();
        if total > FULLEST_SITE {
            let value = format!("{total:.4} (site of atom {})", site + 1);
            return Err(Error::invalid(
                Setting::SiteOccupancy,
                value,
                "expected at most 1; lower them or remove an atom",
            ));
        }
        let draw = uniform(seed, Purpose::Occupancy, 0, site as u64) * total.max(1.0);
        let mut below = 0.0;
        for &member in members {
            below += self.atoms[member].occupancy;
            if draw < below {
                return Ok(Some(member));
            }
        }
        // Rounding must not leave a hole in a full site.
        Ok(members.last().copied().filter(|_| total > 1.0 - 1e-9))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Atom;
    use super::*;

    /// Chains of sites: one of Sr (0.6) and Ba (0.3), one full O.
    fn chain(n: usize) -> Structure {
        let mut atoms = Vec::new();
        for i in 0..n {
            let z = 4.0 * i as f64;
            atoms.push(Atom { number: 38, position: [0.0, 0.0, z], occupancy: 0.6 });
            atoms.push(Atom { number: 8, position: [2.0, 2.0, z], occupancy: 1.0 });
            atoms.push(Atom { number: 56, position: [4.0, 0.0, z + 0.004], occupancy: 0.3 });
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
