//! Finds the slices with atoms near a window, and the heights at which they act there. Other slices are passed in one step.
//!
//! Particles, edges, tilted crystals and amorphous specimens have thin slices, and a window meets few atoms in each of them, or none. So a
//! slice can act at the height of its atoms near the window, not at the mean height of all its atoms.

use super::grid::Grid;
use super::phonons::displaced;
use super::plan::Plan;
use crate::plane;
use crate::potential::projected::{PlacedAtom, Projection};
use crate::structure::Site;

/// A slice is empty in a window if it has no atom within this distance from the window, in Angstrom. On a tilted Pt particle of 2.8 nm with
/// windows of 5.9 A and slices of 0.5 A, this changes bright pixels by 0.002 % rms (no pixel by more than 0.006 % of the maximum) and takes
/// 0.38 times as long. With 0.5 A the changes would be 0.004 and 0.009 %, with 0 A 0.03 and 0.11 %.
const NEAR_ANGSTROM: f64 = 1.0;
/// Distance in Angstrom from the middle of a window at which an atom's weight is 1/e, for the height at which its slice acts in the window
/// ([`Slicing::Local`](crate::potential::slices::Slicing::Local)). Bright pixels of `cargo bench --bench slices`, with slices of 0.5 A that do not join, are off by 0.25 % with equal
/// weights, and by 0.20 / 0.15 / 0.11 / 0.11 % with 4 / 2.5 / 1.5 / 1 A; by 0.46 % where slices act at one height.
const MIDDLE_ANGSTROM: f64 = 1.5;
/// Slices join while the weighted sum of their atoms' squared distances from the common height is at most the square of this, in Angstrom.
/// A Pt particle of 2.4 nm in any orientation, slices of 0.35 A, windows of 7.8 A, one configuration: bright pixels are 0.13 / 0.16 / 0.24
/// / 0.31 / 0.60 % off with 0.05 / 0.07 / 0.15 / 0.2 / 0.3 A. With 0.07 A a window passes a fifth fewer slices than if none join.
const JOINED_ANGSTROM: f64 = 0.07;
/// Atoms further apart along the beam than this, in Angstrom, never act in one step, even far from the middle.
const MOST_JOINED_ANGSTROM: f64 = 2.0;
/// Least weight of an atom far from the middle, so that there is always a mean height.
const LEAST_WEIGHT: f64 = 1e-9;
/// Local heights are multiples of this, in Angstrom, so that few propagators serve all windows.
const HEIGHT_STEP_ANGSTROM: f64 = 0.01;

/// Slices that a window passes in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalSlice {
    pub first: usize,
    pub last: usize,
    /// Height at which the slices' potentials act, in Angstrom.
    pub height_angstrom: f64,
}

impl LocalSlice {
    /// A key that is different for each slice and height.
    pub fn key(&self) -> (usize, usize, u64) {
        (self.first, self.last, self.height_angstrom.to_bits())
    }
}

/// Atoms that act in one step.
#[derive(Debug, Clone, Copy)]
struct Together {
    first: usize,
    last: usize,
    /// Lowest and highest atom, in Angstrom.
    heights: [f64; 2],
    weight: f64,
    /// Weighted mean height, and the weighted sum of squared distances from it.
    mean: f64,
    squares: f64,
}

impl Together {
    /// Joins the atoms of a slice, given as squared distance from the middle of the window, and height; `None` without atoms.
    fn new(slice: usize, atoms: impl Iterator<Item = (f64, f64)>) -> Option<Self> {
        let one = |(square, z): (f64, f64)| {
            let weight = LEAST_WEIGHT + (-square / MIDDLE_ANGSTROM.powi(2)).exp();
            Together { first: slice, last: slice, heights: [z; 2], weight, mean: z, squares: 0.0 }
        };
        atoms.map(one).reduce(Together::with)
    }

    fn with(self, other: Self) -> Self {
        let weight = self.weight + other.weight;
        let apart = other.mean - self.mean;
        Together {
            first: self.first,
            last: other.last,
            heights: [self.heights[0].min(other.heights[0]), self.heights[1].max(other.heights[1])],
            weight,
            mean: self.mean + apart * other.weight / weight,
            squares: self.squares
                + other.squares
                + apart.powi(2) * self.weight * other.weight / weight,
        }
    }

    fn may_act_in_one_plane(&self) -> bool {
        self.squares <= JOINED_ANGSTROM.powi(2)
            && self.heights[1] - self.heights[0] <= MOST_JOINED_ANGSTROM
    }

    fn slice(&self) -> LocalSlice {
        let height = (self.mean / HEIGHT_STEP_ANGSTROM).round() * HEIGHT_STEP_ANGSTROM;
        LocalSlice { first: self.first, last: self.last, height_angstrom: height }
    }
}

/// The atoms of each slice, seen along the beam.
pub(super) struct SliceCoverage {
    /// Grid of the transmission functions.
    grid: Grid,
    /// Points (x, y) of a window.
    window: [usize; 2],
    /// x and y in pixels within the cell, seen from windows that follow the beam, and heights in Angstrom of each slice's atoms, by
    /// ascending y.
    slices: Vec<Vec<[f64; 3]>>,
    /// Heights at which slices act in the mean of the cell, in Angstrom.
    planes: Vec<f64>,
    /// Whether slices act at the height of their atoms in a window, and join others there.
    local: bool,
    /// Slices after which images are recorded, ascending: a step ends there.
    record_after: Vec<usize>,
    /// Whether atoms reach into other slices than their own, so that no slice is empty.
    spread: bool,
}

impl SliceCoverage {
    pub fn new(plan: &Plan, by_slice: &[Vec<PlacedAtom>]) -> Self {
        let grid = plan.transmission_grid;
        let pixel = grid.sampling_angstrom();
        let sorted = |(atoms, plane): (&Vec<PlacedAtom>, &f64)| {
            // Windows follow the beam, so slices move relative to them.
            let moved = plan.window_shift(*plane);
            let at = |a: &PlacedAtom| {
                let [x, y] = [0, 1].map(|k| {
                    (a.position[k] / pixel[k] - moved[k] as f64).rem_euclid(grid.points[k] as f64)
                });
                [x, y, a.position[2]]
            };
            let mut places: Vec<[f64; 3]> = atoms.iter().map(at).collect();
            places.sort_by(|a, b| a[1].total_cmp(&b[1]));
            places
        };
        let slices = by_slice.iter().zip(&plan.slices.planes).map(sorted).collect();
        let spread = plan.settings.projection == Projection::Finite;
        let local = plan.has_local_slices();
        let planes = plan.slices.planes.clone();
        let record_after = plan.record_after.clone();
        let window = plan.wave_grid.points;
        SliceCoverage { grid, window, slices, planes, local, record_after, spread }
    }

    /// The slices that hold atoms near a window whose first pixel is `origin` (row, column), ascending.
    pub fn within(&self, origin: (usize, usize)) -> Vec<LocalSlice> {
        let pixel = self.grid.sampling_angstrom();
        let cell = self.grid.points.map(|n| n as f64);
        let reach = pixel.map(|p| NEAR_ANGSTROM / p);
        let origin = [origin.1 as f64, origin.0 as f64];
        let start = [0, 1].map(|k| (origin[k] - reach[k]).rem_euclid(cell[k]));
        let from = |atom: &[f64; 3], k: usize| (atom[k] - start[k]).rem_euclid(cell[k]);
        let most = plane::per_axis(self.window, reach, |n, reach| n as f64 + 2.0 * reach);
        let off_middle = |atom: &[f64; 3]| {
            let off = [0, 1].map(|k| (from(atom, k) - 0.5 * most[k]) * pixel[k]);
            off[0].powi(2) + off[1].powi(2)
        };
        let met = |slice: usize| {
            // The search begins at the window's first row and wraps around the edge of the cell, because large fields have many atoms.
            let atoms = &self.slices[slice];
            let (before, after) = atoms.split_at(atoms.partition_point(|a| a[1] < start[1]));
            let rows = after.iter().chain(before).take_while(|a| from(a, 1) <= most[1]);
            rows.filter(|a| from(a, 0) <= most[0]).map(|a| (off_middle(a), a[2]))
        };
        if !self.local || self.spread {
            let filled = (0..self.slices.len()).filter(|&i| self.spread || met(i).next().is_some());
            return filled.map(|i| self.in_the_mean(i)).collect();
        }
        self.joined((0..self.slices.len()).filter_map(|i| Together::new(i, met(i))))
    }

    /// Joins slices into steps as long as the error stays small.
    fn joined(&self, slices: impl Iterator<Item = Together>) -> Vec<LocalSlice> {
        let mut steps: Vec<Together> = Vec::new();
        for slice in slices {
            let recorded = |last: usize| {
                let next = self.record_after.partition_point(|r| *r < last);
                self.record_after.get(next).is_some_and(|r| *r < slice.first)
            };
            match steps.last_mut() {
                Some(last)
                    if !recorded(last.last) && {
                        let both = last.with(slice);
                        both.may_act_in_one_plane()
                    } =>
                {
                    *last = last.with(slice);
                }
                _ => steps.push(slice),
            }
        }
        steps.iter().map(Together::slice).collect()
    }

    /// A slice at its mean height in the cell.
    pub fn in_the_mean(&self, slice: usize) -> LocalSlice {
        LocalSlice { first: slice, last: slice, height_angstrom: self.planes[slice] }
    }

    /// Makes every slice filled everywhere.
    #[cfg(test)]
    pub fn spread(&mut self) {
        self.spread = true;
    }
}

/// The displaced atoms of one phonon configuration, slice by slice.
pub(super) fn place(plan: &Plan, sites: &[Site], configuration: u32) -> Vec<Vec<PlacedAtom>> {
    let slices = &plan.slices;
    let mut by_slice = vec![Vec::new(); slices.len()];
    for site in sites {
        let position = match plan.settings.phonons {
            Some(p) => displaced(site, p.seed, configuration),
            None => site.position,
        };
        // Wrapped by the mean height: an atom near a face must not jump to the other one.
        let z = slices.wrap(site.position[2]) + (position[2] - site.position[2]);
        let position = [position[0], position[1], z];
        by_slice[slices.index(z)].push(PlacedAtom { position, number: site.number });
    }
    by_slice
}
