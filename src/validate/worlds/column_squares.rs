//! Finds the nearest neighbours of many columns.

use std::collections::HashMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Number of columns in a square of [`CELL_NM`] above which a list cannot be a list of columns: atoms are 0.1 nm apart.
const MOST_IN_CELL: usize = 256;
/// Edge of the squares in which neighbours are searched.
const CELL_NM: f64 = 0.25;
/// Largest distance of a neighbour; farther ones count as this far.
const FARTHEST_NEIGHBOUR_NM: f64 = 1.0;

/// Points, sorted into squares.
pub struct ColumnSquares<'a> {
    points: &'a [[f32; 2]],
    cells: HashMap<(i64, i64), Vec<u32>>,
}

impl<'a> ColumnSquares<'a> {
    /// Sorts the points; fails where so many lie in one square that the search for neighbours would not end.
    pub fn new(points: &'a [[f32; 2]], path: &Path) -> Result<Self> {
        let mut cells: HashMap<(i64, i64), Vec<u32>> = HashMap::new();
        for (i, p) in points.iter().enumerate() {
            let cell = cells.entry(Self::of(*p)).or_default();
            cell.push(i as u32);
            if cell.len() > MOST_IN_CELL {
                let message = format!(
                    "lists more than {MOST_IN_CELL} columns within {CELL_NM} nm of {p:?} nm (x, y); are they columns?"
                );
                return Err(Error::invalid(Setting::WorldFile, path.display(), message));
            }
        }
        Ok(ColumnSquares { points, cells })
    }

    fn of([x, y]: [f32; 2]) -> (i64, i64) {
        ((f64::from(x) / CELL_NM).floor() as i64, (f64::from(y) / CELL_NM).floor() as i64)
    }

    /// Returns the distance of each point to its nearest neighbour, in nm.
    pub fn nearest(&self) -> Vec<f32> {
        (0..self.points.len()).map(|i| self.nearest_to(i)).collect()
    }

    fn nearest_to(&self, i: usize) -> f32 {
        let p = self.points[i];
        let (cx, cy) = Self::of(p);
        let mut best = FARTHEST_NEIGHBOUR_NM;
        for ring in 0_i64.. {
            // Points of this ring are at least this far away.
            if (ring - 1) as f64 * CELL_NM >= best {
                break;
            }
            for y in cy - ring..=cy + ring {
                let whole = (y - cy).abs() == ring;
                let step = if whole { 1 } else { (2 * ring).max(1) };
                let mut x = cx - ring;
                while x <= cx + ring {
                    for j in self.cells.get(&(x, y)).into_iter().flatten() {
                        let q = self.points[*j as usize];
                        let d = f64::from(q[0] - p[0]).hypot(f64::from(q[1] - p[1]));
                        if *j as usize != i {
                            best = best.min(d);
                        }
                    }
                    x += step;
                }
            }
        }
        best as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_neighbours_are_as_by_brute_force() {
        let points: Vec<[f32; 2]> = (0..300)
            .map(|i| {
                let turn = i as f32 * 0.618_034;
                [3.0 * turn.fract(), 3.0 * (turn * 7.31).fract()]
            })
            .collect();
        let nearest = |points: &[[f32; 2]]| {
            ColumnSquares::new(points, Path::new("w.h5")).map(|c| c.nearest())
        };
        for (i, found) in nearest(&points).unwrap().into_iter().enumerate() {
            let distance = |j: usize| {
                f64::from(points[i][0] - points[j][0]).hypot(f64::from(points[i][1] - points[j][1]))
            };
            let expected = (0..300).filter(|j| *j != i).map(distance).fold(1.0, f64::min);
            assert!((f64::from(found) - expected).abs() < 1e-6, "{i}: {found} {expected}");
        }
        assert_eq!(nearest(&[[0.0, 0.0]]).unwrap(), [1.0]);
        let text = nearest(&[[0.5, 0.5]; 257]).unwrap_err().to_string();
        assert!(text.contains("w.h5") && text.contains("more than 256"), "{text}");
    }
}
