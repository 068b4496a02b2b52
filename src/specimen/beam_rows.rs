//! Rows of atoms along the beam, found among any atoms.
//!
//! In the order of their depth, atoms join the nearest row whose first atom lies within [`ROW_RADIUS_NM`] of them in projection along the
//! beam, or else begin a row. Rows whose means lie that near to each other are then joined, the smallest first, unless an atom of either
//! lies farther than [`DISPLACED_NM`] from the common mean. So a few atoms that vibrate, or lean out of a row, make no separate row.

use crate::plane;
use std::collections::HashMap;

use super::sites::DISPLACED_NM;

/// Atoms whose distance from the first atom of a row is below this, in projection along the beam, belong to the row; in nm.
pub const ROW_RADIUS_NM: f64 = 0.048;
/// Largest distance of the atoms of joined rows from their mean.
const REACH_NM: f64 = 0.99 * DISPLACED_NM;
/// Edge of the squares by which rows are looked up.
const SQUARE_NM: f64 = 2.0 * ROW_RADIUS_NM;
/// Stands for no atom.
const NONE: u32 = u32::MAX;

/// Returns the row of each atom; rows are numbered in the order of their first atoms. `positions` (x, y, z) in nm are sorted by depth. The
/// result does not depend on the order of atoms at equal depth, except for atoms at the same position.
pub fn beam_rows(positions: &[[f64; 3]]) -> Vec<u32> {
    let (mut rows, squares) = Rows::first(positions);
    rows.join(&squares);
    rows.numbered(positions.len())
}

/// Rows by the square in which their first atom lies.
type RowSquares = HashMap<[i64; 2], Vec<u32>>;

/// Rows under construction.
struct Rows<'a> {
    positions: &'a [[f64; 3]],
    /// Atoms of each row as a linked list: the first and the last of the row, and the next of each atom.
    first: Vec<u32>,
    last: Vec<u32>,
    next: Vec<u32>,
    /// Sums of x and y, and numbers of atoms; the number is 0 for rows that have been joined to others.
    sum: Vec<[f64; 2]>,
    count: Vec<u32>,
}

/// Lists the squares that lie within `radius` of a place.
fn squares_about([x, y]: [f64; 2], radius: f64) -> impl Iterator<Item = [i64; 2]> {
    let square = |v: f64| (v / SQUARE_NM).floor() as i64;
    let [left, right] = [square(x - radius), square(x + radius)];
    (square(y - radius)..=square(y + radius)).flat_map(move |j| (left..=right).map(move |i| [i, j]))
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
    (dx * dx + dy * dy).sqrt()
}

impl<'a> Rows<'a> {
    /// Groups the atoms into rows about the rows' first atoms.
    fn first(positions: &'a [[f64; 3]]) -> (Self, RowSquares) {
        let mut squares = RowSquares::new();
        let mut rows = Rows {
            positions,
            first: Vec::new(),
            last: Vec::new(),
            next: vec![NONE; positions.len()],
            sum: Vec::new(),
            count: Vec::new(),
        };
        for (atom, [x, y, _]) in positions.iter().enumerate() {
            let at = [*x, *y];
            let near = squares_about(at, ROW_RADIUS_NM).filter_map(|square| squares.get(&square));
            let gap = |row: u32| (distance(at, rows.place(rows.first[row as usize])), row);
            let nearest = near
                .flatten()
                .map(|row| gap(*row))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            match nearest.filter(|(gap, _)| *gap < ROW_RADIUS_NM) {
                Some((_, row)) => rows.append(row as usize, atom as u32),
                None => {
                    let square = at.map(|v| (v / SQUARE_NM).floor() as i64);
                    squares.entry(square).or_default().push(rows.first.len() as u32);
                    rows.begin(atom as u32);
                }
            }
        }
        (rows, squares)
    }

    fn place(&self, atom: u32) -> [f64; 2] {
        let [x, y, _] = self.positions[atom as usize];
        [x, y]
    }

    fn begin(&mut self, atom: u32) {
        self.first.push(atom);
        self.last.push(atom);
        self.sum.push(self.place(atom));
        self.count.push(1);
    }

    fn append(&mut self, row: usize, atom: u32) {
        self.next[self.last[row] as usize] = atom;
        self.last[row] = atom;
        let [x, y] = self.place(atom);
        self.sum[row] = [self.sum[row][0] + x, self.sum[row][1] + y];
        self.count[row] += 1;
    }

    fn mean(&self, row: usize) -> [f64; 2] {
        self.sum[row].map(|s| s / f64::from(self.count[row]))
    }

    fn atoms(&self, row: usize) -> impl Iterator<Item = u32> {
        let step = |atom: &u32| Some(self.next[*atom as usize]).filter(|next| *next != NONE);
        std::iter::successors(Some(self.first[row]), step)
    }

    /// Joins rows whose means lie near each other.
    fn join(&mut self, squares: &RowSquares) {
        let mut order: Vec<u32> = (0..self.first.len() as u32).collect();
        order.sort_by_key(|row| (self.count[*row as usize], std::cmp::Reverse(*row)));
        for row in order.into_iter().map(|row| row as usize) {
            let at = self.mean(row);
            // The first atom of a row may lie at this distance from the row's mean.
            let near = squares_about(at, ROW_RADIUS_NM + REACH_NM)
                .filter_map(|square| squares.get(&square));
            let others = near.flatten().map(|other| *other as usize).filter(|other| {
                let (own, its) = (self.count[row], self.count[*other]);
                its > own || its == own && *other < row
            });
            let gap = |other: usize| (distance(at, self.mean(other)), other);
            let nearest = others.map(gap).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if let Some((_, other)) = nearest.filter(|(gap, _)| *gap < ROW_RADIUS_NM)
                && self.fit(row, other)
            {
                self.absorb(other, row);
            }
        }
    }

    /// Whether all atoms of two rows lie near the mean of both.
    fn fit(&self, a: usize, b: usize) -> bool {
        let count = f64::from(self.count[a] + self.count[b]);
        let mean = plane::add(self.sum[a], self.sum[b]).map(|sum| sum / count);
        self.atoms(a).chain(self.atoms(b)).all(|atom| distance(self.place(atom), mean) < REACH_NM)
    }

    fn absorb(&mut self, row: usize, other: usize) {
        self.next[self.last[row] as usize] = self.first[other];
        self.last[row] = self.last[other];
        self.sum[row] = plane::add(self.sum[row], self.sum[other]);
        self.count[row] += self.count[other];
        self.count[other] = 0;
    }

    fn numbered(&self, atoms: usize) -> Vec<u32> {
        let mut of_atom = vec![0; atoms];
        let kept = (0..self.first.len()).filter(|row| self.count[*row] > 0);
        for (number, row) in kept.enumerate() {
            self.atoms(row).for_each(|atom| of_atom[atom as usize] = number as u32);
        }
        of_atom
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn atoms_over_each_other_are_a_row_and_dumbbells_are_two() {
        let mut positions = Vec::new();
        for depth in 0..10 {
            let z = 0.2 * f64::from(depth);
            // The second row wavers by a hundredth of a nm, the third stands 0.08 nm beside it.
            positions.extend([
                [0.0, 0.0, z],
                [0.5 + 0.01 * f64::from(depth % 2), 0.0, z],
                [0.59, 0.0, z],
            ]);
        }
        let rows = beam_rows(&positions);
        for (atom, row) in rows.iter().enumerate() {
            assert_eq!(*row as usize, atom % 3, "{atom}");
        }
    }

    #[test]
    fn one_atom_that_leans_out_stays_in_its_row() {
        let mut positions: Vec<[f64; 3]> =
            (0..20).map(|n| [0.0, 0.0, 0.2 * f64::from(n)]).collect();
        positions[7][0] = 0.04;
        // The first atom decides where a row is looked up; the mean decides whether rows are joined.
        positions[0][0] = -0.02;
        assert!(beam_rows(&positions).iter().all(|row| *row == 0));
    }

    #[test]
    fn leaning_rows_are_cut_where_atoms_would_lie_too_far_from_their_column() {
        let positions: Vec<[f64; 3]> =
            (0..100).map(|n| [0.005 * f64::from(n), 0.0, 0.2 * f64::from(n)]).collect();
        let rows = beam_rows(&positions);
        let count = 1 + *rows.iter().max().unwrap();
        assert!((3..=11).contains(&count), "{count}");
        for row in 0..count {
            let x: Vec<f64> = positions
                .iter()
                .zip(&rows)
                .filter(|(_, r)| **r == row)
                .map(|(p, _)| p[0])
                .collect();
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            assert!(!x.is_empty() && x.iter().all(|x| (x - mean).abs() < DISPLACED_NM));
        }
    }
}
