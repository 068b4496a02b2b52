//! Marks decahedra: five twinned tetrahedra about a common axis, with re-entrant notches.

use super::{Candidate, Cluster, Metal, Morphology, Vec3};
use crate::plane;

/// Five crystals about a common axis. In projection along it, each fills a wedge with rows of atoms (i, j), i steps along one side of the
/// wedge and j along the other; a row has `axis - i - j` atoms, so that {111} facets cap it.
///
/// L. D. Marks, J. Cryst. Growth 61, 556 (1983); the crystals are strained evenly, as in C. Y. Yang, J. Cryst. Growth
/// 47, 274 (1979).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decahedron {
    /// Number of atoms on the axis.
    pub axis: usize,
    /// Greatest i + j: the place of the {100} facet.
    pub depth: usize,
    /// Greatest i and greatest j: less than `depth` if a notch is cut into the twin boundary.
    pub arm: usize,
}

/// Spacing along the axis and length of the steps across it, in units of the bulk bond: they close the gap of 7.35 degrees between
/// five regular tetrahedra at the least energy of springs between neighbours (test below).
const ALONG: f64 = 1.003_88;
const ACROSS: f64 = 0.860_42;

impl Decahedron {
    /// Returns the rows (i, j) of one crystal, without the twin plane j > 0, i = 0, which belongs to the next.
    fn rows(self) -> impl Iterator<Item = [usize; 2]> {
        let Decahedron { depth, arm, .. } = self;
        (1..=arm).flat_map(move |i| (0..=arm.min(depth - i)).map(move |j| [i, j]))
    }
}

impl Candidate for Decahedron {
    const MORPHOLOGY: Morphology = Morphology::Decahedral;

    fn count(&self) -> usize {
        self.axis + 5 * self.rows().map(|[i, j]| self.axis - i - j).sum::<usize>()
    }

    fn cluster(&self, metal: &Metal) -> Cluster {
        let bond = metal.bond();
        let mut positions: Vec<Vec3> = Vec::new();
        let mut row = |[x, y]: [f64; 2], length: usize| {
            for n in 0..length {
                let z = n as f64 - 0.5 * (length as f64 - 1.0);
                positions.push([bond * x, bond * y, bond * ALONG * z]);
            }
        };
        row([0.0; 2], self.axis);
        let side = |n: f64| {
            let angle = std::f64::consts::PI / 5.0 * n;
            [ACROSS * libm::cos(angle), ACROSS * libm::sin(angle)]
        };
        for crystal in 0..5 {
            let (e, f) =
                (side(2.0 * f64::from(crystal) - 1.0), side(2.0 * f64::from(crystal) + 1.0));
            for [i, j] in self.rows() {
                let at = plane::add(e.map(|e| i as f64 * e), f.map(|f| j as f64 * f));
                row(at, self.axis - i - j);
            }
        }
        Cluster::centred(positions)
    }

    fn key(&self) -> [u64; 4] {
        [self.axis, self.depth, self.arm, 0].map(|n| n as u64)
    }
}

/// Returns decahedra of about this diameter.
pub(super) fn candidates(metal: &Metal, diameter_nm: f64) -> Vec<Decahedron> {
    let wanted = metal.count(diameter_nm);
    // An axis longer than this would make needles, and a depth greater than the axis has no atoms.
    let most = (20.0 * diameter_nm / metal.bond()) as usize + 3;
    let mut out = Vec::new();
    for axis in 2..=most {
        for depth in 1..axis {
            for arm in depth.div_ceil(2)..=depth {
                let decahedron = Decahedron { axis, depth, arm };
                if (0.8..1.25).contains(&(decahedron.count() as f64 / wanted)) {
                    out.push(decahedron);
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Energy of springs along the six directions to neighbours: one along the axis, one across, four between.
    fn energy(along: f64, across: f64) -> f64 {
        let slant = (across * across + 0.25 * along * along).sqrt();
        let tangent = 2.0 * across * (std::f64::consts::PI / 5.0).sin();
        (along - 1.0).powi(2) + 4.0 * (slant - 1.0).powi(2) + (tangent - 1.0).powi(2)
    }

    #[test]
    fn the_strain_has_the_least_energy() {
        let least = energy(ALONG, ACROSS);
        for (da, dc) in [(1e-4, 0.0), (-1e-4, 0.0), (0.0, 1e-4), (0.0, -1e-4)] {
            assert!(energy(ALONG + da, ACROSS + dc) > least);
        }
    }
}
