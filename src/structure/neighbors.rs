//! Finds pairs of near atoms in a periodic cell, by cell lists.

use std::collections::{BTreeMap, HashMap};
use std::ops::{ControlFlow, Range};

use super::Structure;
use super::lattice::{Mat3, Vec3, determinant, face_distances, inverse, norm, row_times, subtract};

/// Number of atoms in a box above which boxes are made smaller.
const CROWD: usize = 64;
/// Number of boxes allowed beyond four for each atom, for a few atoms in a wide cell.
const FEW_BOXES: i64 = 1 << 16;

/// Atoms sorted into boxes along the cell vectors.
struct Boxes {
    counts: [i64; 3],
    /// Largest distance of a neighbour, in boxes.
    reach: [i64; 3],
    /// Atom numbers, sorted by box.
    order: Vec<usize>,
    index: BoxIndex,
    /// Box of each atom.
    home: Vec<[i64; 3]>,
    /// Cartesian positions inside the cell.
    positions: Vec<Vec3>,
}

/// Place of each box's atoms in the order.
enum BoxIndex {
    /// All boxes: `starts[b]..starts[b + 1]` are the atoms of box `b`.
    All(Vec<usize>),
    /// The boxes that are not empty.
    Filled(HashMap<[i64; 3], Range<usize>>),
}

impl Boxes {
    fn new(structure: &Structure, inverse: &Mat3, cutoff: f64) -> Self {
        let n = structure.atoms.len();
        let widths = face_distances(&structure.cell);
        let boxes_of = |edge: f64| widths.map(|w| ((w / edge) as i64).max(1));
        // Boxes hold about one atom each: smaller boxes would cost memory without any gain.
        let mut edge = cutoff.max((determinant(&structure.cell).abs() / n as f64).cbrt());
        let many = |counts: [i64; 3]| {
            let boxes = counts.iter().fold(1_i64, |n, c| n.saturating_mul(*c));
            boxes > FEW_BOXES.saturating_add(4 * n as i64)
        };
        while many(boxes_of(edge)) {
            edge *= 2.0;
        }
        let fractions: Vec<Vec3> = structure
            .atoms
            .iter()
            .map(|atom| row_times(atom.position, inverse).map(|x| x - x.floor()))
            .collect();
        let mut boxes = Self::sorted(structure, &fractions, boxes_of(edge), cutoff, false);
        // A cluster in a wide vacuum may lie in one box completely.
        if edge > cutoff && boxes.fullest() > CROWD {
            boxes = Self::sorted(structure, &fractions, boxes_of(cutoff), cutoff, true);
        }
        boxes
    }

    fn sorted(
        structure: &Structure,
        fractions: &[Vec3],
        counts: [i64; 3],
        cutoff: f64,
        sparse: bool,
    ) -> Self {
        let widths = face_distances(&structure.cell);
        let place = |fraction: &Vec3| -> [i64; 3] {
            std::array::from_fn(|i| ((fraction[i] * counts[i] as f64) as i64).min(counts[i] - 1))
        };
        let home: Vec<[i64; 3]> = fractions.iter().map(place).collect();
        let mut order: Vec<usize> = (0..home.len()).collect();
        order.sort_by_key(|&atom| home[atom]);
        let index = match sparse {
            true => {
                let mut filled = HashMap::new();
                for (at, &atom) in order.iter().enumerate() {
                    filled.entry(home[atom]).or_insert(at..at).end = at + 1;
                }
                BoxIndex::Filled(filled)
            }
            false => {
                let mut starts = vec![0; counts.iter().product::<i64>() as usize + 1];
                home.iter().for_each(|b| starts[number(counts, *b) + 1] += 1);
                for b in 1..starts.len() {
                    starts[b] += starts[b - 1];
                }
                BoxIndex::All(starts)
            }
        };
        Boxes {
            counts,
            reach: std::array::from_fn(|i| (cutoff * counts[i] as f64 / widths[i]).ceil() as i64),
            order,
            index,
            home,
            positions: fractions.iter().map(|f| row_times(*f, &structure.cell)).collect(),
        }
    }

    fn members(&self, place: [i64; 3]) -> &[usize] {
        let range = match &self.index {
            BoxIndex::All(starts) => {
                let b = number(self.counts, place);
                starts[b]..starts[b + 1]
            }
            BoxIndex::Filled(filled) => filled.get(&place).cloned().unwrap_or_default(),
        };
        &self.order[range]
    }

    /// Returns the number of atoms in the fullest box.
    fn fullest(&self) -> usize {
        match &self.index {
            BoxIndex::All(starts) => starts.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0),
            BoxIndex::Filled(filled) => filled.values().map(Range::len).max().unwrap_or(0),
        }
    }
}

fn number(counts: [i64; 3], b: [i64; 3]) -> usize {
    ((b[0] * counts[1] + b[1]) * counts[2] + b[2]) as usize
}

/// Calls `visit(i, j, distance)` for every pair with `i <= j` and `distance <= cutoff` Angstrom, once for each periodic image; `i == j` is
/// an atom and its own image. A pair of images may be visited from either side. `i` never decreases.
pub(crate) fn for_each_pair(
    structure: &Structure,
    cutoff: f64,
    mut visit: impl FnMut(usize, usize, f64),
) {
    let all = |i, j, distance| {
        visit(i, j, distance);
        ControlFlow::Continue(())
    };
    // `visit` never stops the search here.
    let _ = try_each_pair(structure, cutoff, all);
}

/// Visits pairs like [`for_each_pair`], until `visit` stops the search.
pub(super) fn try_each_pair(
    structure: &Structure,
    cutoff: f64,
    mut visit: impl FnMut(usize, usize, f64) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let Some(inverse) = inverse(&structure.cell).filter(|_| !structure.atoms.is_empty()) else {
        return ControlFlow::Continue(());
    };
    let boxes = Boxes::new(structure, &inverse, cutoff);
    let mut near: [Vec<NearBox>; 3] = Default::default();
    for i in 0..structure.atoms.len() {
        for (axis, near) in near.iter_mut().enumerate() {
            let (home, reach, count) = (boxes.home[i][axis], boxes.reach[axis], boxes.counts[axis]);
            near.clear();
            near.extend((-reach..=reach).map(|offset| NearBox::of(home + offset, count)));
        }
        let [along_x, along_y, along_z] = &near;
        for x in along_x {
            for y in along_y {
                for z in along_z {
                    visit_box(structure, &boxes, i, [*x, *y, *z], cutoff, &mut visit)?;
                }
            }
        }
    }
    ControlFlow::Continue(())
}

/// Number of a box along an axis, and by how many periods the box was moved to get it.
#[derive(Clone, Copy)]
struct NearBox {
    number: i64,
    turns: i64,
}

impl NearBox {
    fn of(place: i64, count: i64) -> Self {
        NearBox { number: place.rem_euclid(count), turns: place.div_euclid(count) }
    }
}

fn visit_box(
    structure: &Structure,
    boxes: &Boxes,
    i: usize,
    [x, y, z]: [NearBox; 3],
    cutoff: f64,
    visit: &mut impl FnMut(usize, usize, f64) -> ControlFlow<()>,
) -> ControlFlow<()> {
    let members = boxes.members([x.number, y.number, z.number]);
    if members.is_empty() {
        return ControlFlow::Continue(());
    }
    let turns = [x.turns, y.turns, z.turns];
    let shift = row_times([x.turns as f64, y.turns as f64, z.turns as f64], &structure.cell);
    let here = subtract(boxes.positions[i], shift);
    for &j in members {
        if j < i || (j == i && turns == [0; 3]) {
            continue;
        }
        let distance = norm(subtract(boxes.positions[j], here));
        if distance <= cutoff {
            visit(i, j, distance)?;
        }
    }
    ControlFlow::Continue(())
}

/// Returns the smallest distance in Angstrom between two atoms, periodic images included; `None` without atoms. Sites with partial
/// occupancy count as atoms, so resolve them first.
pub fn min_pair_distance(structure: &Structure) -> Option<f64> {
    let count = structure.atoms.len();
    if count == 0 {
        return None;
    }
    // No packing of points is denser than close packing, so this distance reaches at least one pair.
    let per_atom = determinant(&structure.cell).abs() / count as f64;
    let cutoff = (std::f64::consts::SQRT_2 * per_atom).cbrt() * (1.0 + 1e-9);
    let mut smallest = f64::INFINITY;
    for_each_pair(structure, cutoff, |_, _, distance| smallest = smallest.min(distance));
    Some(smallest).filter(|d| d.is_finite())
}

/// Returns the shortest distance in Angstrom of every pair of elements that comes within `cutoff`, the lower atomic number first.
pub fn shortest_distances(structure: &Structure, cutoff: f64) -> BTreeMap<(u8, u8), f64> {
    let mut shortest = BTreeMap::new();
    for_each_pair(structure, cutoff, |i, j, distance| {
        let (a, b) = (structure.atoms[i].number, structure.atoms[j].number);
        let entry = shortest.entry((a.min(b), a.max(b))).or_insert(distance);
        *entry = f64::min(*entry, distance);
    });
    shortest
}

#[cfg(test)]
mod tests {
    use super::super::Atom;
    use super::*;
    use crate::rng::{Purpose, normal3, uniform};

    fn atom(position: Vec3) -> Atom {
        Atom::new(14, position)
    }

    /// Reference: every pair through every image within three cells.
    fn slow(structure: &Structure) -> f64 {
        let mut smallest = f64::INFINITY;
        for (i, a) in structure.atoms.iter().enumerate() {
            for (j, b) in structure.atoms.iter().enumerate() {
                for n in 0..343 {
                    let turn = [n / 49 - 3, n / 7 % 7 - 3, n % 7 - 3];
                    if i == j && turn == [0; 3] {
                        continue;
                    }
                    let shift = row_times(turn.map(f64::from), &structure.cell);
                    let d: Vec3 = std::array::from_fn(|k| b.position[k] + shift[k] - a.position[k]);
                    smallest = smallest.min(norm(d));
                }
            }
        }
        smallest
    }

    #[test]
    fn equals_the_direct_sum_in_random_cells() {
        for case in 0..60u64 {
            let mut cell: Mat3 =
                std::array::from_fn(|i| normal3(case, Purpose::Phonon, 0, i as u64));
            for i in 0..3 {
                cell[i][i] += 6.0;
            }
            let n = 1 + case % 12;
            let atoms = (0..n)
                .map(|i| {
                    let u = |k: u32| 3.0 * uniform(case, Purpose::Defect, k, i) - 1.0;
                    atom(row_times([u(0), u(1), u(2)], &cell))
                })
                .map(|mut a| {
                    // The direct sum needs atoms inside the cell.
                    let f = row_times(a.position, &inverse(&cell).unwrap()).map(|x| x - x.floor());
                    a.position = row_times(f, &cell);
                    a
                })
                .collect();
            let structure = Structure { cell, atoms };
            let (fast, slow) = (min_pair_distance(&structure).unwrap(), slow(&structure));
            assert!((fast - slow).abs() < 1e-9, "case {case}: {fast} {slow}");
        }
    }

    #[test]
    fn a_cluster_in_a_wide_vacuum_is_as_in_a_narrow_one() {
        let cluster = |width: f64| {
            let cell = [[width, 0.0, 0.0], [0.0, width, 0.0], [0.0, 0.0, width]];
            let place = |i: u64, k: u32| 5.0 * uniform(3, Purpose::Defect, k, i);
            let atoms = (0..400).map(|i| atom([0, 1, 2].map(|k| 1.0 + place(i, k)))).collect();
            let mut pairs = Vec::new();
            for_each_pair(&Structure { cell, atoms }, 0.4, |i, j, d| pairs.push((i, j, d as f32)));
            pairs.sort_by(|a, b| a.partial_cmp(b).unwrap());
            pairs
        };
        let narrow = cluster(8.0);
        assert!(narrow.len() > 100);
        for wide in [100.0, 1e5] {
            assert_eq!(cluster(wide).len(), narrow.len(), "{wide}");
        }
        let pairs =
            |list: &[(usize, usize, f32)]| -> Vec<_> { list.iter().map(|p| (p.0, p.1)).collect() };
        assert_eq!(pairs(&cluster(100.0)), pairs(&narrow));
    }

    #[test]
    fn one_atom_sees_its_own_image() {
        let cell = [[2.0, 2.0, 0.0], [2.0, 0.0, 2.0], [0.0, 2.0, 2.0]];
        let fcc = Structure { cell, atoms: vec![atom([0.3, 0.0, 7.0])] };
        assert!((min_pair_distance(&fcc).unwrap() - 8f64.sqrt()).abs() < 1e-12);
        assert_eq!(min_pair_distance(&Structure { cell, atoms: vec![] }), None);
    }

    #[test]
    fn pairs_across_a_face_are_found() {
        let cell = [[50.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 70.0]];
        let atoms = vec![atom([0.1, 59.9, 0.0]), atom([49.9, 0.1, 69.9]), atom([20.0, 20.0, 20.0])];
        let d = min_pair_distance(&Structure { cell, atoms }).unwrap();
        assert!((d - 0.3).abs() < 1e-9, "{d}");
    }
}
