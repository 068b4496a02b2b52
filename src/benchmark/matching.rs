//! Pairs of places that are found and places that are true: one to one, none farther apart than a limit.

use std::collections::{HashMap, VecDeque};

/// For each found place the true ones within `radius_nm`, nearest first.
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

/// The greatest number of pairs of a found and a true place (x, y in nm) within `radius_nm` of each other, no place in two of them
/// (Hopcroft and Karp, SIAM J. Comput. 2, 225 (1973)). Places have to be finite, and `radius_nm` above 0.
pub fn most_pairs(found: &[[f64; 2]], truth: &[[f64; 2]], radius_nm: f64) -> usize {
    let near = neighbours(found, truth, radius_nm);
    let mut pairs = Pairs { of_found: vec![None; found.len()], of_truth: vec![None; truth.len()] };
    let mut count = 0;
    loop {
        let Some(mut depth) = pairs.depths(&near) else { return count };
        for start in 0..found.len() {
            if pairs.of_found[start].is_none() && pairs.augment(start, &near, &mut depth) {
                count += 1;
            }
        }
    }
}

/// Which is paired with which.
struct Pairs {
    of_found: Vec<Option<usize>>,
    of_truth: Vec<Option<usize>>,
}

impl Pairs {
    /// How many pairs a path to each found place changes, from those without one; `None` where no path ends at a true place without one.
    fn depths(&self, near: &[Vec<(usize, f64)>]) -> Option<Vec<usize>> {
        let mut depth = vec![usize::MAX; near.len()];
        let mut queue: VecDeque<usize> = VecDeque::new();
        for (n, pair) in self.of_found.iter().enumerate() {
            if pair.is_none() {
                depth[n] = 0;
                queue.push_back(n);
            }
        }
        let mut ends = false;
        while let Some(n) = queue.pop_front() {
            for (t, _) in &near[n] {
                match self.of_truth[*t] {
                    None => ends = true,
                    Some(next) if depth[next] == usize::MAX => {
                        depth[next] = depth[n] + 1;
                        queue.push_back(next);
                    }
                    Some(_) => {}
                }
            }
        }
        ends.then_some(depth)
    }

    /// Pairs `start` along a shortest path, if there is one; places that lead nowhere are not tried again. Without recursion: paths may
    /// be as long as the lists.
    fn augment(&mut self, start: usize, near: &[Vec<(usize, f64)>], depth: &mut [usize]) -> bool {
        // (found place, which of its neighbours is tried next)
        let mut path = vec![(start, 0)];
        while let Some((n, next)) = path.last_mut() {
            let here = *n;
            let Some((t, _)) = near[here].get(*next) else {
                depth[here] = usize::MAX;
                path.pop();
                continue;
            };
            *next += 1;
            match self.of_truth[*t] {
                Some(other) if depth[here] != usize::MAX && depth[other] == depth[here] + 1 => {
                    path.push((other, 0));
                }
                Some(_) => {}
                None => {
                    for (n, next) in path {
                        let t = near[n][next - 1].0;
                        (self.of_found[n], self.of_truth[t]) = (Some(t), Some(n));
                    }
                    return true;
                }
            }
        }
        false
    }
}

/// The pairs (found, true) of the greatest number of them whose distances have the least sum: for short lists, such as particles.
/// The time grows with the cube of their length.
pub fn nearest_pairs(found: &[[f64; 2]], truth: &[[f64; 2]], radius_nm: f64) -> Vec<[usize; 2]> {
    let near = neighbours(found, truth, radius_nm);
    // Successive shortest paths, from found places without a pair to true ones without.
    let mut pairs = Pairs { of_found: vec![None; found.len()], of_truth: vec![None; truth.len()] };
    while let Some(path) = shortest_path(&pairs, &near) {
        for [n, t] in path {
            (pairs.of_found[n], pairs.of_truth[t]) = (Some(t), Some(n));
        }
    }
    let pair = |(n, t): (usize, &Option<usize>)| t.map(|t| [n, t]);
    pairs.of_found.iter().enumerate().filter_map(pair).collect()
}

/// The pairs of the path that makes one pair more at the least cost (Bellman and Ford).
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
        // The nearer pair first would leave the other alone.
        let (found, truth) = ([[0.0, 0.0], [1.0, 0.0]], [[0.9, 0.0], [1.9, 0.0]]);
        assert_eq!(most_pairs(&found, &truth, 1.0), 2);
        assert_eq!(nearest_pairs(&found, &truth, 1.0), [[0, 0], [1, 1]]);
        // Edges belong to the circle, on both sides of a cell.
        assert_eq!(most_pairs(&[[-1.0, 0.0]], &[[0.0, 0.0]], 1.0), 1);
    }

    #[test]
    fn long_chains_are_paired() {
        let n = 20_000;
        let found: Vec<[f64; 2]> = (0..n).map(|k| [k as f64, 0.0]).collect();
        let truth: Vec<[f64; 2]> = (0..n).map(|k| [k as f64 + 0.5, 0.0]).collect();
        assert_eq!(most_pairs(&found, &truth, 0.6), n);
    }
}
