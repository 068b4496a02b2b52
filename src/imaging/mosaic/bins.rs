//! Groups of items, and points sorted into square bins.

use crate::plane;

/// Points sorted into square bins.
pub(crate) struct Bins {
    edge: f64,
    /// Index of the first bin along x and y.
    first: [i64; 2],
    /// Number of bins along x and y.
    count: [usize; 2],
    /// Start of each bin in the list of points, row by row, and the end of the last bin.
    starts: Vec<usize>,
    points: Vec<usize>,
}

impl Bins {
    /// Sorts points (x, y) into bins with this `edge`, in the unit of the points.
    pub(crate) fn new(points: impl Iterator<Item = [f64; 2]>, edge: f64) -> Self {
        let bins: Vec<[i64; 2]> = points.map(|at| bin_of(at, edge)).collect();
        let first = [0, 1].map(|k| bins.iter().map(|bin| bin[k]).min().unwrap_or(0));
        let end = [0, 1].map(|k| bins.iter().map(|bin| bin[k] + 1).max().unwrap_or(0));
        let count = plane::sub(end, first).map(|n| n as usize);
        let [x, y] = [0, 1].map(|k| move |bin: &[i64; 2]| (bin[k] - first[k]) as usize);
        let of_point = bins.iter().map(|bin| y(bin) * count[0] + x(bin));
        let (starts, points) = grouped(count[0] * count[1], of_point);
        Bins { edge, first, count, starts, points }
    }

    /// The bin of a place.
    pub(crate) fn bin(&self, at: [f64; 2]) -> [i64; 2] {
        bin_of(at, self.edge)
    }

    /// Indices of the points in a bin, ascending.
    pub(crate) fn of(&self, bin: [i64; 2]) -> &[usize] {
        let [x, y] = plane::sub(bin, self.first).map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        if x >= self.count[0] || y >= self.count[1] {
            return &[];
        }
        let number = y * self.count[0] + x;
        &self.points[self.starts[number]..self.starts[number + 1]]
    }
}

fn bin_of(at: [f64; 2], edge: f64) -> [i64; 2] {
    at.map(|v| (v / edge).floor() as i64)
}

/// Sorts items into groups. Returns the start of each group in a list with the end of the last, and the list: the items' indices, ascending
/// in each group.
pub(crate) fn grouped(
    groups: usize,
    of_item: impl Iterator<Item = usize> + Clone,
) -> (Vec<usize>, Vec<usize>) {
    let mut starts = vec![0; groups + 1];
    of_item.clone().for_each(|group| starts[group + 1] += 1);
    for group in 0..groups {
        starts[group + 1] += starts[group];
    }
    let mut next = starts.clone();
    let mut items = vec![0; starts[groups]];
    for (item, group) in of_item.enumerate() {
        items[next[group]] = item;
        next[group] += 1;
    }
    (starts, items)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bin_holds_the_points_that_lie_in_it() {
        let points: Vec<[f64; 2]> =
            (0..200).map(|n| [f64::from(n * 37 % 101) - 40.0, f64::from(n * 53 % 89)]).collect();
        let bins = Bins::new(points.iter().copied(), 3.0);
        let mut found = 0;
        for (x, y) in (-20..40).flat_map(|x| (-5..40).map(move |y| (x, y))) {
            let inside = |n: &usize| bins.bin(points[*n]) == [x, y];
            let expected: Vec<usize> = (0..points.len()).filter(inside).collect();
            assert_eq!(bins.of([x, y]), expected, "{x} {y}");
            found += expected.len();
        }
        assert_eq!(found, points.len());
        assert_eq!(bins.bin([-0.1, 3.0]), [-1, 1]);
        assert!(Bins::new(std::iter::empty(), 3.0).of([0, 0]).is_empty());
    }

    #[test]
    fn items_keep_their_order_in_their_groups() {
        let (starts, items) = grouped(4, [2, 0, 2, 3, 0].into_iter());
        assert_eq!((starts, items), (vec![0, 2, 2, 4, 5], vec![1, 4, 0, 2, 3]));
    }
}
