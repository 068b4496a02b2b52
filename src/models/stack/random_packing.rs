//! Amorphous layers as dense random packings: atoms at random places, pushed apart until no two are nearer than a least distance.

use rayon::prelude::*;

use super::least_distances::{AtomBoxes, LeastDistances};
use crate::rng::{Purpose, words};
use crate::structure::lattice::Vec3;

/// Largest number of rounds in which atoms are pushed apart.
const MOST_ROUNDS: usize = 200;
/// Atoms are pushed until their distance exceeds the least distance by this factor, so that rounds end.
const BEYOND: f64 = 1.04;
/// Share of an overlap by which each atom of a pair moves in a round.
const STEP: f64 = 0.5;
/// The rounds end when at most this share of the atoms is still too near to another; one atom of each such pair is left out.
const NEAR_SHARE: f64 = 5e-4;
/// Greatest movement of an atom in a round, in Angstrom.
const MOST_STEP: f64 = 0.4;
/// Largest share of atoms that may be left out because they found no room.
const MOST_LEFT_OUT: f64 = 0.02;

/// A kind of amorphous matter.
#[derive(Debug, Clone, PartialEq)]
pub struct Packing {
    /// Atoms of each element per cubic Angstrom.
    pub per_angstrom3: Vec<(u8, f64)>,
    /// Least distances of its atoms.
    pub least: LeastDistances,
}

impl Packing {
    /// Fills a box with atoms: (x, y, z) in Angstrom and atomic number. The atoms depend on the box, the seed and the number of the layer.
    ///
    /// The packing has the density of the matter to within 2 % and no two atoms nearer than the least distances. It has no network of
    /// bonds: its coordination is not the coordination of a glass.
    ///
    /// # Errors
    /// The share of the atoms that find no room, if it is above 2 %.
    pub fn fill(
        &self,
        region: [[f64; 2]; 3],
        seed: u64,
        layer: u32,
    ) -> Result<Vec<(Vec3, u8)>, f64> {
        let volume: f64 = region.iter().map(|[low, high]| (high - low).max(0.0)).product();
        let mut atoms: Vec<(Vec3, u8)> = Vec::new();
        for (number, density) in &self.per_angstrom3 {
            let count = (density * volume).round() as u64;
            let first = atoms.len() as u64;
            atoms.extend(
                (first..first + count).map(|n| (random_place(region, seed, layer, n), *number)),
            );
        }
        for _ in 0..MOST_ROUNDS {
            let (moved, near) = self.pushed(&atoms, region);
            atoms = moved;
            if near as f64 <= NEAR_SHARE * atoms.len() as f64 {
                break;
            }
        }
        let kept = self.least.kept(&atoms);
        let out = kept.iter().filter(|kept| !**kept).count() as f64 / atoms.len().max(1) as f64;
        if out > MOST_LEFT_OUT {
            return Err(out);
        }
        Ok(atoms.into_iter().zip(kept).filter(|(_, kept)| *kept).map(|(atom, _)| atom).collect())
    }

    /// Pushes all atoms away from their near neighbours; also returns how many were too near.
    fn pushed(&self, atoms: &[(Vec3, u8)], region: [[f64; 2]; 3]) -> (Vec<(Vec3, u8)>, usize) {
        let boxes = AtomBoxes::new(atoms.iter().map(|(at, _)| *at), BEYOND * self.least.greatest());
        let moved: Vec<((Vec3, u8), bool)> = atoms
            .par_iter()
            .enumerate()
            .map(|(n, (at, number))| {
                let (mut push, mut apart) = ([0.0; 3], true);
                for m in boxes.near(*at).map(|m| m as usize).filter(|m| *m != n) {
                    let (other, z) = atoms[m];
                    let from: Vec3 = std::array::from_fn(|k| at[k] - other[k]);
                    let distance =
                        (from[0] * from[0] + from[1] * from[1] + from[2] * from[2]).sqrt();
                    let least = self.least.of(*number, z);
                    if distance < BEYOND * least && distance > 0.0 {
                        apart &= distance >= least;
                        let share = STEP * (BEYOND * least - distance) / distance;
                        push = std::array::from_fn(|k| push[k] + share * from[k]);
                    }
                }
                let length = (push[0] * push[0] + push[1] * push[1] + push[2] * push[2]).sqrt();
                let scale = if length > MOST_STEP { MOST_STEP / length } else { 1.0 };
                let to: Vec3 = std::array::from_fn(|k| {
                    (at[k] + scale * push[k]).clamp(region[k][0], region[k][1])
                });
                ((to, *number), apart)
            })
            .collect();
        let near = moved.iter().filter(|(_, apart)| !*apart).count();
        (moved.into_iter().map(|(atom, _)| atom).collect(), near)
    }
}

fn random_place(region: [[f64; 2]; 3], seed: u64, layer: u32, n: u64) -> Vec3 {
    let drawn = words(seed, Purpose::Amorphous, layer, n);
    std::array::from_fn(|k| {
        let share = (f64::from(drawn[k]) + 0.5) / 4_294_967_296.0;
        region[k][0] + share * (region[k][1] - region[k][0])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::lattice::{norm, subtract};
    use std::collections::BTreeMap;

    fn silica(density: f64) -> Packing {
        // 2.20 g/cm3 is 0.02205 SiO2 per cubic Angstrom.
        let units = density / 60.084 * 0.602_214_076;
        let given = BTreeMap::from([((8, 8), 2.3), ((8, 14), 1.5), ((14, 14), 2.7)]);
        let least = LeastDistances::new(std::iter::empty(), &given, &[]);
        Packing { per_angstrom3: vec![(8, 2.0 * units), (14, units)], least }
    }

    #[test]
    fn silica_has_its_density_and_no_atoms_too_near() {
        let packing = silica(2.2);
        let region = [[0.0, 24.0], [-10.0, 14.0], [5.0, 29.0]];
        let atoms = packing.fill(region, 3, 1).unwrap();
        let expected = 3.0 * 0.02205 * 24f64.powi(3);
        assert!((atoms.len() as f64 / expected - 1.0).abs() < 0.02, "{} {expected}", atoms.len());
        for (n, (at, a)) in atoms.iter().enumerate() {
            assert!((0..3).all(|k| (region[k][0]..=region[k][1]).contains(&at[k])));
            for (other, b) in &atoms[..n] {
                assert!(norm(subtract(*at, *other)) >= packing.least.of(*a, *b));
            }
        }
        assert_eq!(packing.fill(region, 3, 1).unwrap(), atoms);
        assert_ne!(packing.fill(region, 4, 1).unwrap(), atoms);
    }

    #[test]
    fn a_density_without_room_is_refused() {
        assert!(silica(9.0).fill([[0.0, 15.0]; 3], 3, 1).unwrap_err() > 0.02);
    }
}
