//! Finds the nearest of many points on an image.

use crate::plane;

/// Points sorted into squares of an image.
pub(super) struct NearestCells {
    points: Vec<[f64; 2]>,
    /// Edge of a square in pixels.
    edge: f64,
    /// Number of squares along x and y.
    count: [usize; 2],
    /// Numbers of the points in each square.
    squares: Vec<Vec<u32>>,
}

impl NearestCells {
    /// Sorts finite points (x, y) in pixels, in or beside an image of this shape.
    pub fn new(points: Vec<[f64; 2]>, [rows, columns]: [usize; 2]) -> Self {
        let area = (rows * columns) as f64;
        let edge = (area / points.len().max(1) as f64).sqrt().max(1.0);
        let count = [columns, rows].map(|n| ((n as f64 / edge).ceil() as usize).max(1));
        let squares = vec![Vec::new(); count[0] * count[1]];
        let mut cells = NearestCells { points, edge, count, squares };
        for number in 0..cells.points.len() {
            let [x, y] = cells.square(cells.points[number]);
            cells.squares[y * cells.count[0] + x].push(number as u32);
        }
        cells
    }

    fn square(&self, place: [f64; 2]) -> [usize; 2] {
        plane::per_axis(place, self.count, |at, cells| {
            ((at / self.edge).max(0.0) as usize).min(cells - 1)
        })
    }

    /// Returns the number of the point nearest to a place in the image; among equally near ones the first. `None` without points.
    pub fn nearest(&self, place: [f64; 2]) -> Option<usize> {
        let [x, y] = self.square(place);
        let mut best: Option<(f64, u32)> = None;
        for ring in 0..=self.count[0].max(self.count[1]) {
            // Points of this ring are at least this far away; points beside the image are even farther than the squares that hold them.
            let away = (ring as f64 - 1.0) * self.edge - 1.0;
            if best.is_some_and(|(squared, _)| away > 0.0 && away * away > squared) {
                break;
            }
            for number in self.ring([x, y], ring) {
                let [a, b] = self.points[number as usize];
                let squared = (a - place[0]).powi(2) + (b - place[1]).powi(2);
                if best.is_none_or(|(least, first)| (squared, number) < (least, first)) {
                    best = Some((squared, number));
                }
            }
        }
        best.map(|(_, number)| number as usize)
    }

    /// Returns the points in squares that are `ring` squares away.
    fn ring(&self, [x, y]: [usize; 2], ring: usize) -> impl Iterator<Item = u32> {
        let rows = y.saturating_sub(ring)..(y + ring + 1).min(self.count[1]);
        rows.flat_map(move |row| {
            let whole = row.abs_diff(y) == ring;
            let from = x.saturating_sub(ring);
            let columns = from..(x + ring + 1).min(self.count[0]);
            columns
                .filter(move |column| whole || column.abs_diff(x) == ring)
                .flat_map(move |column| self.squares[row * self.count[0] + column].iter().copied())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{self, Purpose};

    #[test]
    fn the_nearest_is_found() {
        let draw = |k: u32, n: u64| rng::uniform(3, Purpose::Tile, k, n);
        for count in [1, 2, 40, 900] {
            // Half of the points lie in a corner, so that many squares are empty.
            let point = |n: u64| {
                let part = if n.is_multiple_of(2) { 1.0 } else { 0.2 };
                [part * draw(0, n) * 260.0 - 30.0, part * draw(1, n) * 149.0]
            };
            let points: Vec<[f64; 2]> = (0..count).map(point).collect();
            let cells = NearestCells::new(points.clone(), [150, 200]);
            for n in 0..500 {
                let place = [(draw(2, n) * 200.0).floor(), (draw(3, n) * 150.0).floor()];
                let far = |p: &[f64; 2]| (p[0] - place[0]).hypot(p[1] - place[1]);
                let least = points.iter().map(far).fold(f64::INFINITY, f64::min);
                let found = cells.nearest(place).unwrap();
                assert!((far(&points[found]) - least).abs() < 1e-9, "{count}: {place:?}");
            }
        }
        assert_eq!(NearestCells::new(Vec::new(), [4, 4]).nearest([1.0, 1.0]), None);
    }
}
