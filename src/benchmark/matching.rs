//! Pairs found places with true places: one to one, and none farther apart than a limit.

use std::collections::HashMap;

/// Returns, for each found place, the true places within `radius_nm`, nearest first.
fn neighbours(found: &[[f64; 2]], truth: &[[f64; 2]], radius_nm: f64) -> Vec<Vec<(usize, f64)>> {
    let cell = |p: &[f64; 2]| p.map(|v| (v / radius_nm).floor() as i64);
    let mut cells: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    for (n, place) in truth.iter().enumerate() {
        cells.entry(cell(place)).or_default().push(n);
    }
    let near = |place: &[f64; 2]| {
        let [x, y] = cell(place);
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
        let candidates = around.filter_map(|at| cells.get(&at)).flatten();
        let distance = |n: &usize| (place[0] - truth[*n][0]).hypot(place[1] - truth[*n][1]);
        let mut near: Vec<(usize, f64)> =
            candidates.map(|n| (*n, distance(n))).filter(|(_, d)| *d <= radius_nm).collect();
        near.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        near
    };
    found.iter().map(near).collect()
}

/// Returns the greatest number of pairs of a found and a true place (x, y in nm) within `radius_nm` of each other, with each place in at
/// most one pair (augmenting paths after A. Pothen and C.-J. Fan, ACM Trans. Math. Softw. 16, 303 (1990)). Places must be finite, and
/// `radius_nm` above 0.
pub fn most_pairs(found: &[[f64; 2]], truth: &[[f64; 2]], radius_nm: f64) -> usize {
    let mut pairs = Pairs { of_found: vec![None; found.len()], of_truth: vec![None; truth.len()] };
    let mut free = PlaceGrid::new(truth, radius_nm, 0..truth.len());
    for (n, place) in found.iter().enumerate() {
        if let Some(t) = free.take(place) {
            pairs.join(n, t);
        }
    }
    loop {
        let paired = (0..truth.len()).filter(|t| pairs.of_truth[*t].is_some());
        let mut untried = PlaceGrid::new(truth, radius_nm, paired);
        let mut more = false;
        for start in 0..found.len() {
            if pairs.of_found[start].is_none() {
                more |= pairs.augment(start, found, (&mut free, &mut untried));
            }
        }
        if !more {
            return pairs.of_found.iter().flatten().count();
        }
    }
}

/// True places in a grid; places near a found one are removed from it one by one.
struct PlaceGrid<'a> {
    truth: &'a [[f64; 2]],
    radius_nm: f64,
    cells: HashMap<[i64; 2], Vec<usize>>,
}

/// Number of cells along a radius: all places of a cell are then within the radius of each other.
const CELLS: i64 = 2;

impl<'a> PlaceGrid<'a> {
    fn new(truth: &'a [[f64; 2]], radius_nm: f64, listed: impl Iterator<Item = usize>) -> Self {
        let mut grid = PlaceGrid { truth, radius_nm, cells: HashMap::new() };
        for n in listed {
            grid.cells.entry(grid.cell(&truth[n])).or_default().push(n);
        }
        grid
    }

    fn cell(&self, place: &[f64; 2]) -> [i64; 2] {
        // The edge is slightly wider, so that rounding puts no place within the radius into a cell beyond.
        let edge_nm = self.radius_nm * (1.0 + 1e-9) / CELLS as f64;
        place.map(|v| (v / edge_nm).floor() as i64)
    }

    /// Removes and returns a true place within the radius. The cell of the found place is searched first.
    fn take(&mut self, place: &[f64; 2]) -> Option<usize> {
        let [x, y] = self.cell(place);
        let rings = 0..=CELLS;
        let around = rings.flat_map(|ring| {
            let square = (-ring..=ring).flat_map(move |dy| (-ring..=ring).map(move |dx| [dx, dy]));
            square.filter(move |d| d[0].abs().max(d[1].abs()) == ring)
        });
        for [dx, dy] in around {
            let Some(list) = self.cells.get_mut(&[x + dx, y + dy]) else { continue };
            let near = |n: &usize| {
                let [u, v] = self.truth[*n];
                (place[0] - u).hypot(place[1] - v) <= self.radius_nm
            };
            if let Some(at) = list.iter().rposition(near) {
                return Some(list.swap_remove(at));
            }
        }
        None
    }
}

/// The partner of each found and each true place.
struct Pairs {
    of_found: Vec<Option<usize>>,
    of_truth: Vec<Option<usize>>,
}

impl Pairs {
    fn join(&mut self, n: usize, t: usize) {
        (self.of_found[n], self.of_truth[t]) = (Some(t), Some(n));
    }

    /// Pairs `start` along a path of places that change their partners, if there is such a path. True places that were tried lead nowhere
    /// in this round, and are removed from the grid. The search is not recursive, since paths may be as long as the lists.
    fn augment(
        &mut self,
        start: usize,
        found: &[[f64; 2]],
        (free, untried): (&mut PlaceGrid<'_>, &mut PlaceGrid<'_>),
    ) -> bool {
        // Found places, and the true places that they would change to; the last found place has none yet.
        let (mut path, mut changes) = (vec![start], Vec::new());
        while let Some(&n) = path.last() {
            if let Some(t) = free.take(&found[n]) {
                changes.push(t);
                path.into_iter().zip(changes).for_each(|(n, t)| self.join(n, t));
                return true;
            }
            let next = untried.take(&found[n]);
            match next.and_then(|t| Some((t, self.of_truth[t]?))) {
                Some((t, other)) => {
                    changes.push(t);
                    path.push(other);
                }
                None => {
                    path.pop();
                    changes.pop();
                }
            }
        }
        false
    }
}

/// Returns the pairs (found, true): as many as possible, and among these with the least sum of distances. The time grows with the cube of
/// the number of places that are connected by distances within the radius.
pub fn nearest_pairs(found: &[[f64; 2]], truth: &[[f64; 2]], radius_nm: f64) -> Vec<[usize; 2]> {
    let mut all = Vec::new();
    for [founds, truths] in groups(&neighbours(found, truth, radius_nm), truth.len()) {
        let at = |indices: &[usize], places: &[[f64; 2]]| -> Vec<[f64; 2]> {
            indices.iter().map(|n| places[*n]).collect()
        };
        let near = neighbours(&at(&founds, found), &at(&truths, truth), radius_nm);
        let mut pairs =
            Pairs { of_found: vec![None; founds.len()], of_truth: vec![None; truths.len()] };
        // Successive shortest paths, from found places without a pair to true places without one.
        while let Some(path) = shortest_path(&pairs, &near) {
            path.into_iter().for_each(|[n, t]| pairs.join(n, t));
        }
        let pair = |(n, t): (usize, &Option<usize>)| t.map(|t| [founds[n], truths[t]]);
        all.extend(pairs.of_found.iter().enumerate().filter_map(pair));
    }
    all.sort_unstable();
    all
}

/// Returns the groups of found and true places that are connected within the radius, each in ascending order.
fn groups(near: &[Vec<(usize, f64)>], truths: usize) -> Vec<[Vec<usize>; 2]> {
    let mut near_truth = vec![Vec::new(); truths];
    for (n, list) in near.iter().enumerate() {
        list.iter().for_each(|(t, _)| near_truth[*t].push(n));
    }
    let (mut found_known, mut truth_known) = (vec![false; near.len()], vec![false; truths]);
    let mut groups = Vec::new();
    for first in 0..near.len() {
        let (mut founds, mut members) = (vec![first], Vec::new());
        if near[first].is_empty() || std::mem::replace(&mut found_known[first], true) {
            continue;
        }
        let mut next = 0;
        while let Some(&n) = founds.get(next) {
            next += 1;
            for (t, _) in &near[n] {
                if !std::mem::replace(&mut truth_known[*t], true) {
                    members.push(*t);
                    let new = near_truth[*t].iter().copied();
                    founds.extend(new.filter(|m| !std::mem::replace(&mut found_known[*m], true)));
                }
            }
        }
        founds.sort_unstable();
        members.sort_unstable();
        groups.push([founds, members]);
    }
    groups
}

/// Returns the pairs of the path that adds one pair at the least cost (Bellman and Ford).
fn shortest_path(pairs: &Pairs, near: &[Vec<(usize, f64)>]) -> Option<Vec<[usize; 2]>> {
    let mut to_found: Vec<f64> =
        pairs.of_found.iter().map(|p| if p.is_none() { 0.0 } else { f64::INFINITY }).collect();
    let mut to_truth = vec![(f64::INFINITY, 0_usize); pairs.of_truth.len()];
    let mut changed = true;
    while changed {
        changed = false;
        for (n, list) in near.iter().enumerate() {
            for (t, distance) in list.iter().filter(|(t, _)| pairs.of_found[n] != Some(*t)) {
                let cost = to_found[n] + distance;
                if cost < to_truth[*t].0 - 1e-12 {
                    to_truth[*t] = (cost, n);
                    changed = true;
                    if let Some(other) = pairs.of_truth[*t] {
                        let own = near[other].iter().find(|(o, _)| o == t).map_or(0.0, |(_, d)| *d);
                        to_found[other] = cost - own;
                    }
                }
            }
        }
    }
    let free = (0..to_truth.len()).filter(|t| pairs.of_truth[*t].is_none());
    let end = free.filter(|t| to_truth[*t].0.is_finite());
    let mut t = end.min_by(|a, b| to_truth[*a].0.total_cmp(&to_truth[*b].0))?;
    let mut path = Vec::new();
    loop {
        let n = to_truth[t].1;
        path.push([n, t]);
        match pairs.of_found[n] {
            Some(before) => t = before,
            None => break,
        }
    }
    Some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_place_is_in_two_pairs() {
        let truth = [[0.0, 0.0]];
        assert_eq!(most_pairs(&[[0.0, 0.1], [0.1, 0.0]], &truth, 1.0), 1);
        assert_eq!(most_pairs(&[[3.0, 0.0]], &truth, 1.0), 0);
        assert_eq!(most_pairs(&[], &truth, 1.0), 0);
        // Taking the nearer pair first would leave the other two without a pair.
        let (found, truth) = ([[0.0, 0.0], [1.0, 0.0]], [[0.9, 0.0], [1.9, 0.0]]);
        assert_eq!(most_pairs(&found, &truth, 1.0), 2);
        assert_eq!(nearest_pairs(&found, &truth, 1.0), [[0, 0], [1, 1]]);
        // Places at exactly the radius count, on both sides of a cell.
        assert_eq!(most_pairs(&[[-1.0, 0.0]], &[[0.0, 0.0]], 1.0), 1);
    }

    #[test]
    fn no_other_pairing_has_more_pairs() {
        // Reference by the simplest method: one augmenting path after the other through a matrix of neighbours.
        fn plain(
            near: &[Vec<bool>],
            n: usize,
            seen: &mut [bool],
            of: &mut [Option<usize>],
        ) -> bool {
            (0..seen.len()).any(|t| {
                let open = near[n][t] && !seen[t];
                seen[t] |= near[n][t];
                let ends = open && of[t].is_none_or(|m| plain(near, m, seen, of));
                if ends {
                    of[t] = Some(n);
                }
                ends
            })
        }
        let mut state = 1_u64;
        let mut place = || {
            let mut next = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 40) as f64 / (1 << 24) as f64
            };
            [10.0 * next(), 10.0 * next() - 5.0]
        };
        for (founds, truths, radius_nm) in
            [(60, 60, 0.8), (80, 40, 1.5), (30, 90, 5.0), (70, 70, 0.1), (90, 90, 1.1)]
        {
            let found: Vec<_> = (0..founds).map(|_| place()).collect();
            let truth: Vec<_> = (0..truths).map(|_| place()).collect();
            let near = |f: &[f64; 2], t: &[f64; 2]| (f[0] - t[0]).hypot(f[1] - t[1]) <= radius_nm;
            let matrix: Vec<Vec<bool>> =
                found.iter().map(|f| truth.iter().map(|t| near(f, t)).collect()).collect();
            let mut of = vec![None; truths];
            let ends = |n: &usize| plain(&matrix, *n, &mut vec![false; truths], &mut of);
            let most = (0..founds).filter(ends).count();
            assert_eq!(most_pairs(&found, &truth, radius_nm), most, "{radius_nm}");
        }
    }

    #[test]
    fn long_chains_are_paired() {
        let n = 20_000;
        let found: Vec<[f64; 2]> = (0..n).map(|k| [k as f64, 0.0]).collect();
        let truth: Vec<[f64; 2]> = (0..n).map(|k| [k as f64 + 0.5, 0.0]).collect();
        assert_eq!(most_pairs(&found, &truth, 0.6), n);
    }
}
