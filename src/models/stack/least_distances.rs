//! Least distances of atoms, and the removal of atoms that overlap.

use std::collections::BTreeMap;

use crate::structure::lattice::{Vec3, norm, subtract};
use crate::structure::{PAIR_CUTOFF_ANGSTROM, Structure, shortest_distances};

/// Least distance of two atoms divided by the shortest distance of their elements in the crystals.
pub const LEAST_SHARE: f64 = 0.75;

/// Least distances of pairs of elements, in Angstrom.
#[derive(Debug, Clone, PartialEq)]
pub struct LeastDistances {
    /// Place of each atomic number in the table; 0 for elements that do not occur.
    rows: [u8; 256],
    count: usize,
    table: Vec<f64>,
    greatest: f64,
}

impl LeastDistances {
    /// Makes the table of some crystals: [`LEAST_SHARE`] times the shortest distance of each pair of elements in any of them. `given` are
    /// distances of other pairs. For a pair in neither, half the shortest distances of both elements are added and multiplied by the share.
    pub fn new<'c>(
        crystals: impl Iterator<Item = &'c Structure>,
        given: &BTreeMap<(u8, u8), f64>,
        others: &[u8],
    ) -> Self {
        let mut shortest: BTreeMap<(u8, u8), f64> = BTreeMap::new();
        for crystal in crystals {
            for (pair, distance) in shortest_distances(crystal, PAIR_CUTOFF_ANGSTROM) {
                let known = shortest.entry(pair).or_insert(distance);
                *known = known.min(distance);
            }
        }
        let mut least: BTreeMap<(u8, u8), f64> =
            shortest.iter().map(|(pair, d)| (*pair, LEAST_SHARE * d)).collect();
        for (&(a, b), &distance) in given {
            let pair = (a.min(b), a.max(b));
            least.entry(pair).and_modify(|known| *known = known.min(distance)).or_insert(distance);
        }
        let mut elements: Vec<u8> = least.keys().flat_map(|(a, b)| [*a, *b]).collect();
        elements.extend(others);
        elements.sort_unstable();
        elements.dedup();
        let nearest = |z: u8| {
            let own = least.iter().filter(|((a, b), _)| *a == z || *b == z).map(|(_, d)| *d);
            own.min_by(f64::total_cmp).unwrap_or(LEAST_SHARE * 2.0)
        };
        let mut rows = [0; 256];
        elements.iter().enumerate().for_each(|(n, z)| rows[usize::from(*z)] = n as u8);
        let entry = |a: u8, b: u8| {
            let known = least.get(&(a.min(b), a.max(b))).copied();
            known.unwrap_or_else(|| 0.5 * (nearest(a) + nearest(b)))
        };
        let table: Vec<f64> =
            elements.iter().flat_map(|a| elements.iter().map(move |b| entry(*a, *b))).collect();
        let greatest = table.iter().copied().fold(0.0, f64::max);
        LeastDistances { rows, count: elements.len(), table, greatest }
    }

    /// Returns the least distance of two elements of the table.
    pub fn of(&self, a: u8, b: u8) -> f64 {
        let [row, column] = [a, b].map(|z| usize::from(self.rows[usize::from(z)]));
        self.table[row * self.count + column]
    }

    /// Returns the greatest of the distances.
    pub fn greatest(&self) -> f64 {
        self.greatest
    }

    /// Decides which atoms stay: an atom is left out if it lies too near to one before it in the list that stays.
    pub fn kept(&self, atoms: &[(Vec3, u8)]) -> Vec<bool> {
        let boxes = AtomBoxes::new(atoms.iter().map(|(at, _)| *at), self.greatest.max(0.5));
        let mut kept = vec![true; atoms.len()];
        for (n, (at, number)) in atoms.iter().enumerate() {
            kept[n] = boxes.near(*at).all(|other| {
                let m = other as usize;
                if m >= n || !kept[m] {
                    return true;
                }
                let (place, other) = atoms[m];
                norm(subtract(*at, place)) >= self.of(*number, other)
            });
        }
        kept
    }
}

/// Atoms sorted into cubes, so that the atoms near a place are found.
#[derive(Debug)]
pub struct AtomBoxes {
    corner: Vec3,
    edge: f64,
    shape: [usize; 3],
    starts: Vec<u32>,
    members: Vec<u32>,
}

/// Largest number of cubes for each atom.
const MOST_CUBES: f64 = 8.0;

impl AtomBoxes {
    /// Sorts places in Angstrom into cubes of at least `edge`.
    pub fn new(places: impl Iterator<Item = Vec3> + Clone, edge: f64) -> Self {
        let bounds = |k: usize| {
            places
                .clone()
                .map(|p| p[k])
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
        };
        let ends = [bounds(0), bounds(1), bounds(2)];
        let count = places.clone().count();
        let size = ends.map(|[l, h]| if h > l { h - l } else { 0.0 });
        let mut edge = edge;
        let shape_of = |edge: f64| size.map(|s| (s / edge) as usize + 1);
        let cubes = |edge: f64| shape_of(edge).iter().map(|n| *n as f64).product::<f64>();
        while cubes(edge) > 1e5 + MOST_CUBES * count as f64 {
            edge *= 1.3;
        }
        let shape = shape_of(edge);
        let corner = ends.map(|[l, _]| if l.is_finite() { l } else { 0.0 });
        let mut boxes = AtomBoxes { corner, edge, shape, starts: Vec::new(), members: Vec::new() };
        let homes: Vec<u32> = places.map(|p| boxes.number(boxes.cube(p)) as u32).collect();
        let mut starts = vec![0u32; shape.iter().product::<usize>() + 1];
        homes.iter().for_each(|home| starts[*home as usize + 1] += 1);
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![0; homes.len()];
        for (atom, home) in homes.iter().enumerate() {
            members[next[*home as usize] as usize] = atom as u32;
            next[*home as usize] += 1;
        }
        boxes.starts = starts;
        boxes.members = members;
        boxes
    }

    fn cube(&self, at: Vec3) -> [usize; 3] {
        std::array::from_fn(|k| {
            let along = ((at[k] - self.corner[k]) / self.edge).max(0.0) as usize;
            along.min(self.shape[k] - 1)
        })
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.shape[1] + y) * self.shape[0] + x
    }

    /// Lists the atoms in the cube of a place and in the cubes about it, in an order that depends on the places alone.
    pub fn near(&self, at: Vec3) -> impl Iterator<Item = u32> + '_ {
        let cube = self.cube(at);
        let span = move |k: usize| cube[k].saturating_sub(1)..=(cube[k] + 1).min(self.shape[k] - 1);
        let [first, last] = [*span(0).start(), *span(0).end()];
        span(2).flat_map(move |z| {
            span(1).flat_map(move |y| {
                let begin = self.starts[self.number([first, y, z])] as usize;
                let end = self.starts[self.number([last, y, z]) + 1] as usize;
                self.members[begin..end].iter().copied()
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, uniform};
    use crate::structure::crystals;

    #[test]
    fn distances_are_shares_of_the_shortest_in_the_crystals() {
        let crystals = ["srtio3", "si"].map(|name| crystals::crystal(name).unwrap());
        let least = LeastDistances::new(crystals.iter(), &BTreeMap::new(), &[]);
        assert!((least.of(22, 8) - 0.75 * 1.9525).abs() < 1e-9);
        assert!((least.of(8, 22) - 0.75 * 1.9525).abs() < 1e-9);
        assert!((least.of(14, 14) - 0.75 * 5.431 * 3f64.sqrt() / 4.0).abs() < 1e-9);
        // A pair that no crystal holds: half the sum of the nearest neighbours of both.
        let expected = 0.5 * (least.of(14, 14) + least.of(22, 8));
        assert!((least.of(14, 22) - expected).abs() < 1e-12);
        let given = BTreeMap::from([((14, 22), 1.0)]);
        assert_eq!(LeastDistances::new(crystals.iter(), &given, &[]).of(22, 14), 1.0);
    }

    #[test]
    fn kept_atoms_do_not_overlap_and_the_others_do() {
        let silicon = crystals::crystal("si").unwrap();
        let least = LeastDistances::new([&silicon].into_iter(), &BTreeMap::new(), &[]);
        let place = |n: u64| [0, 1, 2].map(|k| 12.0 * uniform(5, Purpose::Defect, k, n));
        let atoms: Vec<(Vec3, u8)> = (0..600).map(|n| (place(n), 14)).collect();
        let kept = least.kept(&atoms);
        let near = |a: usize, b: usize| norm(subtract(atoms[a].0, atoms[b].0)) < least.of(14, 14);
        for n in 0..atoms.len() {
            let clash = (0..n).any(|m| kept[m] && near(n, m));
            assert_eq!(kept[n], !clash, "{n}");
        }
        assert!(kept.iter().filter(|k| **k).count() > 100);
    }
}
