//! The point group of a crystal, found from its atoms.

use crate::structure::Structure;
use crate::structure::lattice::{Mat3, Vec3, inverse, norm, row_times, subtract};

/// Largest change of a cell vector's length or of an atom's place by an operation of the group, in Angstrom.
const TOLERANCE_ANGSTROM: f64 = 0.05;

/// Returns the rotations and reflections of a crystal as orthogonal matrices M, for `r -> r M` with rows r. Operations are found whose
/// indices, in the vectors of the cell, are -1, 0 or 1: all operations of the usual cells.
pub fn point_group(crystal: &Structure) -> Vec<Mat3> {
    let Some(to_fraction) = inverse(&crystal.cell) else { return Vec::new() };
    let images = crystal.cell.map(|vector| images_of(vector, &crystal.cell));
    let mut group = Vec::new();
    for a in &images[0] {
        for b in images[1].iter().filter(|b| keeps_angle(crystal, [0, 1], [*a, **b])) {
            for c in &images[2] {
                let rows = [*a, *b, *c];
                let angles = [[0, 2], [1, 2]];
                if angles.iter().all(|&[i, j]| keeps_angle(crystal, [i, j], [rows[i], rows[j]])) {
                    let matrix = to_fraction.map(|row| row_times(row, &rows));
                    if keeps_atoms(crystal, &to_fraction, &matrix) {
                        group.push(matrix);
                    }
                }
            }
        }
    }
    group
}

/// Returns the lattice vectors with indices -1, 0 and 1 that are as long as `vector`.
fn images_of(vector: Vec3, cell: &Mat3) -> Vec<Vec3> {
    let length = norm(vector);
    let index = |n: i32, k: u32| f64::from(n / 3i32.pow(k) % 3 - 1);
    let all = (0..27).map(|n| row_times([index(n, 2), index(n, 1), index(n, 0)], cell));
    all.filter(|image| (norm(*image) - length).abs() < TOLERANCE_ANGSTROM).collect()
}

/// Whether two images enclose the angle of the cell vectors `pair`.
fn keeps_angle(crystal: &Structure, pair: [usize; 2], images: [Vec3; 2]) -> bool {
    let [a, b] = pair.map(|k| crystal.cell[k]);
    let apart = |a: Vec3, b: Vec3| norm(subtract(a, b));
    (apart(a, b) - apart(images[0], images[1])).abs() < TOLERANCE_ANGSTROM
}

/// Whether an operation, with some shift, takes every atom to an atom of its element.
fn keeps_atoms(crystal: &Structure, to_fraction: &Mat3, matrix: &Mat3) -> bool {
    let atoms = &crystal.atoms;
    let count = |z: u8| atoms.iter().filter(|atom| atom.number == z).count();
    let Some(first) = atoms.iter().min_by_key(|atom| count(atom.number)) else { return true };
    let turned: Vec<Vec3> = atoms.iter().map(|atom| row_times(atom.position, matrix)).collect();
    let start = row_times(first.position, matrix);
    let same = |place: Vec3, number: u8| {
        atoms.iter().filter(|other| other.number == number).any(|other| {
            let apart = row_times(subtract(place, other.position), to_fraction);
            norm(row_times(apart.map(|v| v - v.round()), &crystal.cell)) < TOLERANCE_ANGSTROM
        })
    };
    atoms.iter().filter(|atom| atom.number == first.number).any(|target| {
        let shift = subtract(target.position, start);
        atoms
            .iter()
            .zip(&turned)
            .all(|(atom, at)| same(std::array::from_fn(|k| at[k] + shift[k]), atom.number))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals::crystal;
    use crate::structure::lattice::determinant;

    #[test]
    fn the_orders_are_those_of_the_international_tables() {
        // m-3m, m-3m, -43m, m-3m, 4mm, 6mm, -6m2.
        let orders = [
            ("pt", 48),
            ("si", 48),
            ("gaas", 24),
            ("srtio3", 48),
            ("batio3_tetragonal", 8),
            ("gan", 12),
            ("mos2", 12),
        ];
        for (name, order) in orders {
            let group = point_group(&crystal(name).unwrap());
            assert_eq!(group.len(), order, "{name}");
            assert!(group.iter().all(|m| (determinant(m).abs() - 1.0).abs() < 1e-3), "{name}");
        }
    }
}
