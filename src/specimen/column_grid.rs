//! A grid in which the columns of a specimen that is held in memory are looked up by place.

use std::ops::Range;

use crate::plane;
use crate::recipe::region::Region;

/// Least edge of a cell in nm.
const LEAST_EDGE_NM: f64 = 0.5;
/// Largest number of cells.
const MOST_CELLS: f64 = 4e6;

/// Columns sorted by the cells of a grid, row by row; each cell is a range of their numbers.
pub struct ColumnGrid {
    corner_nm: [f64; 2],
    edge_nm: f64,
    /// Cells along x and y.
    shape: [usize; 2],
    /// Number of the first column of each cell, and the number of columns.
    starts: Vec<u32>,
    /// Steps (along x, y, or both) from each cell to the nearest that holds a column.
    steps: Vec<u32>,
}

impl ColumnGrid {
    /// Sorts columns at (x, y) in nm within a region; also returns their order: the old number of each column in the grid.
    pub fn new(region: &Region, positions_nm: &[[f64; 2]]) -> (Self, Vec<u32>) {
        let [width, height] = [region.x, region.y].map(|[low, high]| high - low);
        let edge_nm = LEAST_EDGE_NM.max((width * height / MOST_CELLS).sqrt());
        let shape = [width, height].map(|nm| ((nm / edge_nm).ceil() as usize).max(1));
        let corner_nm = [region.x[0], region.y[0]];
        let mut grid =
            ColumnGrid { corner_nm, edge_nm, shape, starts: Vec::new(), steps: Vec::new() };
        let cells: Vec<usize> = positions_nm.iter().map(|p| grid.number(grid.cell(*p))).collect();
        let mut order: Vec<u32> = (0..positions_nm.len() as u32).collect();
        order.sort_by(|a, b| {
            let [a, b] = [*a as usize, *b as usize];
            let [p, q] = [positions_nm[a], positions_nm[b]];
            let place = || p[1].total_cmp(&q[1]).then(p[0].total_cmp(&q[0]));
            cells[a].cmp(&cells[b]).then_with(place).then(a.cmp(&b))
        });
        let mut starts = vec![0; shape[0] * shape[1] + 1];
        cells.iter().for_each(|cell| starts[cell + 1] += 1);
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        grid.starts = starts;
        grid.steps = grid.steps_to_columns();
        (grid, order)
    }

    fn cell(&self, at: [f64; 2]) -> [usize; 2] {
        let along = plane::sub(at, self.corner_nm).map(|d| (d / self.edge_nm).floor());
        plane::per_axis(along, self.shape, |n, cells| (n.max(0.0) as usize).min(cells - 1))
    }

    fn number(&self, [x, y]: [usize; 2]) -> usize {
        y * self.shape[0] + x
    }

    /// Returns the columns in the cells from `left` to `right` of a row of cells.
    fn columns(&self, row: usize, [left, right]: [usize; 2]) -> Range<usize> {
        let start = |cell: usize| self.starts[cell] as usize;
        start(self.number([left, row]))..start(self.number([right, row]) + 1)
    }

    /// Returns ranges of columns that contain all columns of a region, and some columns beside it.
    pub fn about(&self, region: Region) -> impl Iterator<Item = Range<usize>> {
        let first = self.cell([region.x[0], region.y[0]]);
        let last = self.cell([region.x[1], region.y[1]]);
        (first[1]..=last[1]).map(move |row| self.columns(row, [first[0], last[0]]))
    }

    /// For each cell that holds columns: their numbers, and the centre (x, y) of the cell in nm.
    pub fn filled(&self) -> impl Iterator<Item = (Range<usize>, [f64; 2])> {
        let cells = (0..self.shape[1]).flat_map(|y| (0..self.shape[0]).map(move |x| [x, y]));
        let centre = |cell: [usize; 2]| {
            plane::add(self.corner_nm, cell.map(|n| (n as f64 + 0.5) * self.edge_nm))
        };
        let found = cells.map(move |cell| (self.columns(cell[1], [cell[0]; 2]), centre(cell)));
        found.filter(|(columns, _)| !columns.is_empty())
    }

    /// Finds the column nearest to a place; `positions_nm` are sorted as in the grid. `None` if there are no columns.
    pub fn nearest(&self, positions_nm: &[[f64; 2]], at: [f64; 2]) -> Option<usize> {
        let centre = self.cell(at);
        let most = self.shape[0].max(self.shape[1]);
        let mut nearest: Option<(f64, usize)> = None;
        for ring in self.steps[self.number(centre)] as usize..most {
            for column in self.ring(centre, ring).flatten() {
                let [dx, dy] = plane::sub(positions_nm[column], at);
                let square = dx * dx + dy * dy;
                if nearest.is_none_or(|(least, known)| {
                    square < least || square == least && column < known
                }) {
                    nearest = Some((square, column));
                }
            }
            // The next ring begins at least this far away.
            let reach = ring as f64 * self.edge_nm;
            if nearest.is_some_and(|(square, _)| square <= reach * reach) {
                break;
            }
        }
        nearest.map(|(_, column)| column)
    }

    /// Returns the columns of the cells that are exactly `steps` steps away.
    fn ring(&self, [x, y]: [usize; 2], steps: usize) -> impl Iterator<Item = Range<usize>> {
        let span = |c: usize, size: usize| c.saturating_sub(steps)..(c + steps + 1).min(size);
        let (across, down) = (span(x, self.shape[0]), span(y, self.shape[1]));
        down.flat_map(move |row| {
            let across = across.clone();
            let whole = row.abs_diff(y) == steps;
            let columns = across.filter(move |column| whole || column.abs_diff(x) == steps);
            columns.map(move |column| self.columns(row, [column; 2]))
        })
    }

    /// Computes [`ColumnGrid::steps`] in two sweeps over the cells; distances are the moves of a king on a chess board.
    fn steps_to_columns(&self) -> Vec<u32> {
        let [width, height] = self.shape;
        let empty = |cell: &usize| self.starts[*cell] == self.starts[*cell + 1];
        let far = (width + height) as u32;
        let mut steps: Vec<u32> =
            (0..width * height).map(|cell| if empty(&cell) { far } else { 0 }).collect();
        let mut sweep = |cells: &mut dyn Iterator<Item = usize>, before: [[i64; 2]; 4]| {
            for cell in cells {
                let (x, y) = ((cell % width) as i64, (cell / width) as i64);
                for [dx, dy] in before {
                    let (i, j) = (x + dx, y + dy);
                    if (0..width as i64).contains(&i) && (0..height as i64).contains(&j) {
                        let other = steps[j as usize * width + i as usize] + 1;
                        steps[cell] = steps[cell].min(other);
                    }
                }
            }
        };
        let before = [[-1, 0], [-1, -1], [0, -1], [1, -1]];
        sweep(&mut (0..width * height), before);
        sweep(&mut (0..width * height).rev(), before.map(|[x, y]| [-x, -y]));
        steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_column_is_found_across_empty_space() {
        let region = Region { x: [-10.0, 40.0], y: [-10.0, 20.0] };
        let positions: Vec<[f64; 2]> = (0..300u32)
            .map(|n| {
                let [a, b] = [n.wrapping_mul(2_654_435_761) % 1000, n.wrapping_mul(40_503) % 1000];
                [f64::from(a) * 0.012 - 9.0, f64::from(b) * 0.025 - 8.0]
            })
            .collect();
        let (grid, order) = ColumnGrid::new(&region, &positions);
        let sorted: Vec<[f64; 2]> = order.iter().map(|n| positions[*n as usize]).collect();
        for at in [[0.0, 0.0], [39.0, 19.0], [-9.9, -9.9], [20.0, -3.0], [2.3, 7.7]] {
            let square = |p: &[f64; 2]| (p[0] - at[0]).powi(2) + (p[1] - at[1]).powi(2);
            let least = sorted.iter().map(square).fold(f64::INFINITY, f64::min);
            let found = grid.nearest(&sorted, at).unwrap();
            assert_eq!(square(&sorted[found]), least, "{at:?}");
        }
        let part = Region { x: [0.0, 3.0], y: [0.0, 3.0] };
        let inside = |p: &&[f64; 2]| part.contains(**p);
        let about = grid.about(part).flat_map(|r| sorted[r].iter().filter(inside)).count();
        assert_eq!(about, positions.iter().filter(inside).count());
        let held: usize = grid.filled().map(|(columns, _)| columns.len()).sum();
        assert_eq!(held, positions.len());
        let (none, _) = ColumnGrid::new(&region, &[]);
        assert_eq!(none.nearest(&[], [0.0, 0.0]), None);
    }
}
