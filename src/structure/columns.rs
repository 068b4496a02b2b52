//! Crystals as columns of atoms along the beam on a rectangular lattice, from which specimens are built.

use crate::error::{Error, Result};
use crate::lengths;
use crate::structure::Structure;

/// Largest distance in projection of atoms of one column, in Angstrom.
const SAME_COLUMN_ANGSTROM: f64 = 0.02;
/// Largest difference of fractions of the cell that count as equal.
const SAME_FRACTION: f64 = 1e-3;
/// Number of sites of a cell that the keys of specimens can distinguish.
pub(crate) const MOST_SITES: usize = 1 << 10;
/// Number of chains of one column that `ColumnOutcome` of boundaries can distinguish.
const MOST_CHAINS: usize = 64;

/// A row of equal atoms along the beam, one per unit cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chain {
    /// Height in the unit cell, as a fraction of the cell's edge.
    pub z: f64,
    /// Atomic number.
    pub number: u8,
    /// Number of the site in the cell.
    pub site: usize,
}

/// A column of the unit cell: the chains that share a projected position.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ColumnKind {
    /// Position in the cell, as fractions.
    pub xy: [f64; 2],
    /// The chains, by ascending height.
    pub chains: Vec<Chain>,
}

/// A crystal as columns.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ColumnCrystal {
    /// Edges of the rectangular cell along x, y and the beam in Angstrom.
    pub cell: [f64; 3],
    /// Columns of one cell.
    pub columns: Vec<ColumnKind>,
}

impl ColumnCrystal {
    /// Groups a crystal in a box with edges along x, y and the beam into columns. Heights are shifted so that the entrance surface lies in
    /// the middle of the widest gap between atomic planes.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another cell, partly occupied sites, or too many of them.
    pub(crate) fn new(structure: &Structure) -> Result<Self> {
        let cell = structure.orthogonal_box()?;
        if structure.atoms.iter().any(|a| a.occupancy < 1.0) {
            let expected = "specimens are built from fully occupied sites; give one element per \
                            site and mix with [substitutions] or [vacancies]";
            return Err(Error::invalid(crate::Setting::Crystal, "partial occupancy", expected));
        }
        if structure.atoms.len() > MOST_SITES {
            let expected = format!("at most {MOST_SITES} in the cell along this zone axis");
            return Err(Error::invalid(
                crate::Setting::CrystalSites,
                structure.atoms.len(),
                expected,
            ));
        }
        let fraction = |position: [f64; 3]| [0, 1, 2].map(|k| wrap(position[k] / cell[k]));
        let sites: Vec<[f64; 3]> = structure.atoms.iter().map(|a| fraction(a.position)).collect();
        let entrance = widest_gap(sites.iter().map(|s| s[2]).collect());
        let mut columns: Vec<ColumnKind> = Vec::new();
        for (site, (at, atom)) in sites.iter().zip(&structure.atoms).enumerate() {
            let chain = Chain { z: wrap(at[2] - entrance), number: atom.number, site };
            let same = |c: &&mut ColumnKind| {
                let d = [0, 1].map(|k| apart(c.xy[k], at[k]) * cell[k]);
                d[0] * d[0] + d[1] * d[1] < SAME_COLUMN_ANGSTROM * SAME_COLUMN_ANGSTROM
            };
            match columns.iter_mut().find(same) {
                Some(column) => column.chains.push(chain),
                None => columns.push(ColumnKind { xy: [at[0], at[1]], chains: vec![chain] }),
            }
        }
        for column in &mut columns {
            column.chains.sort_by(|a, b| a.z.total_cmp(&b.z));
            if column.chains.len() > MOST_CHAINS {
                let expected = format!("at most {MOST_CHAINS} in one column of the cell");
                return Err(Error::invalid(
                    crate::Setting::ColumnSites,
                    column.chains.len(),
                    expected,
                ));
            }
        }
        Ok(ColumnCrystal { cell, columns })
    }

    /// Returns all chains.
    pub(crate) fn chains(&self) -> impl Iterator<Item = &Chain> {
        self.columns.iter().flat_map(|c| &c.chains)
    }

    /// Returns the lightest element, if there are several: its atoms are removed first where others need room.
    pub(crate) fn lightest(&self) -> Option<u8> {
        let least = self.chains().map(|c| c.number).min();
        least.filter(|_| self.chains().map(|c| c.number).max() != least)
    }

    /// Returns the number of cells along the beam in `thickness_nm`, at least one.
    pub(crate) fn cells_along_beam(&self, thickness_nm: f64) -> usize {
        ((lengths::angstrom(thickness_nm) / self.cell[2]).round() as usize).max(1)
    }

    /// Whether the mirror image in a plane perpendicular to x is the same crystal, apart from a shift.
    pub(crate) fn has_mirror_x(&self) -> bool {
        let atoms: Vec<([f64; 3], u8)> = self
            .columns
            .iter()
            .flat_map(|c| c.chains.iter().map(|n| ([c.xy[0], c.xy[1], n.z], n.number)))
            .collect();
        let Some(&(first, element)) = atoms.first() else { return true };
        let mirrored = |[x, y, z]: [f64; 3]| [-x, y, z];
        let fits = |shift: [f64; 3]| {
            atoms.iter().all(|&(at, number)| {
                let image = mirrored(at);
                let same =
                    |p: [f64; 3]| (0..3).all(|k| apart(p[k], image[k] + shift[k]) < SAME_FRACTION);
                atoms.iter().any(|&(p, n)| n == number && same(p))
            })
        };
        let image = mirrored(first);
        let candidates = atoms.iter().filter(|(_, n)| *n == element);
        candidates.map(|(p, _)| [0, 1, 2].map(|k| p[k] - image[k])).any(fits)
    }
}

/// Moves a fraction into [0, 1), with rounding errors at zero.
fn wrap(x: f64) -> f64 {
    crate::structure::lattice::wrap_unit(x)
}

/// Returns the distance of two fractions of a period.
fn apart(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(1.0);
    d.min(1.0 - d)
}

/// Returns the middle of the widest gap between fractional heights; of equal gaps, the one at the end of the cell.
fn widest_gap(mut z: Vec<f64>) -> f64 {
    z.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (z.first(), z.last()) else { return 0.0 };
    let mut widest = (first + 1.0 - last, 0.5 * (first + last - 1.0));
    for pair in z.windows(2) {
        if pair[1] - pair[0] > widest.0 + SAME_FRACTION {
            widest = (pair[1] - pair[0], 0.5 * (pair[0] + pair[1]));
        }
    }
    widest.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals;

    fn seen(name: &str, zone: [i32; 3], up: [i32; 3]) -> ColumnCrystal {
        ColumnCrystal::new(&crystals::crystal(name).unwrap().oriented(zone, Some(up)).unwrap())
            .unwrap()
    }

    #[test]
    fn strontium_titanate_has_its_planes_in_the_middle_of_slices() {
        let c = seen("srtio3", [0, 0, 1], [0, 1, 0]);
        let heights = |k: usize| c.columns[k].chains.iter().map(|n| (n.z, n.number)).collect();
        let all: Vec<Vec<(f64, u8)>> = (0..4).map(heights).collect();
        assert_eq!(all[0], [(0.25, 38)]);
        assert_eq!(all[1], [(0.25, 8), (0.75, 22)]);
        assert_eq!([&all[2], &all[3]], [&[(0.75, 8)], &[(0.75, 8)]]);
        assert_eq!(c.lightest(), Some(8));
        assert_eq!(c.cells_along_beam(10.0), 26);
    }

    #[test]
    fn dumbbells_and_mirrors() {
        let si = seen("si", [1, 1, 0], [1, -1, 0]);
        // Half of [110] is a lattice vector as well, so each column of the box holds two atoms.
        assert!(si.columns.len() == 8 && si.columns.iter().all(|c| c.chains.len() == 2));
        assert!(si.lightest().is_none() && si.has_mirror_x());
        // A crystal with its polar axis along x has no mirror perpendicular to x; with its polar axis across x it has one.
        assert!(!seen("gan", [1, 1, 0], [1, -1, 0]).has_mirror_x());
        assert!(seen("gan", [1, 1, 0], [0, 0, 1]).has_mirror_x());
    }
}
