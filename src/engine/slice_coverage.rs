//! Which slices hold atoms near a window: the others are passed in one step there.
//!
//! Particles, edges, tilted crystals and amorphous specimens have thin slices, and a window meets few atoms in each of
//! them, or none.

use super::grid::Grid;
use super::phonons::displaced;
use super::plan::Plan;
use crate::potential::projected::{PlacedAtom, Projection};
use crate::structure::Site;

/// A slice without an atom so near to a window, in Angstrom, is empty there. On a tilted Pt particle of 2.8 nm, windows of
/// 5.9 A and slices of 0.5 A, that changes bright pixels by 0.002 % rms (no pixel by more than 0.006 % of the maximum) and
/// takes 0.38 times as long; with 0.5 A it would be 0.004 and 0.009 %, with 0 A 0.03 and 0.11 %.
const NEAR_ANGSTROM: f64 = 1.0;

/// The atoms of each slice, seen along the beam.
pub(super) struct SliceCoverage {
    /// Grid of the transmission functions.
    grid: Grid,
    /// Points (x, y) of a window.
    window: [usize; 2],
    /// x and y of the atoms in pixels within the cell, seen from windows that follow the beam, by ascending y.
    slices: Vec<Vec<[f64; 2]>>,
    /// Whether atoms reach into other slices than their own, so that no slice is empty.
    spread: bool,
}

impl SliceCoverage {
    pub fn new(plan: &Plan, by_slice: &[Vec<PlacedAtom>]) -> Self {
        let grid = plan.transmission_grid;
        let pixel = grid.sampling_angstrom();
        let sorted = |(atoms, plane): (&Vec<PlacedAtom>, &f64)| {
            // Windows follow the beam; seen from them, slices move.
            let moved = plan.window_shift(*plane);
            let at = |a: &PlacedAtom| {
                [0, 1].map(|k| {
                    (a.position[k] / pixel[k] - moved[k] as f64).rem_euclid(grid.points[k] as f64)
                })
            };
            let mut places: Vec<[f64; 2]> = atoms.iter().map(at).collect();
            places.sort_by(|a, b| a[1].total_cmp(&b[1]));
            places
        };
        let slices = by_slice.iter().zip(&plan.slices.planes).map(sorted).collect();
        let spread = plan.settings.projection == Projection::Finite;
        SliceCoverage { grid, window: plan.wave_grid.points, slices, spread }
    }

    /// The slices that hold atoms near a window whose first pixel is `origin` (row, column), ascending.
    pub fn within(&self, origin: (usize, usize)) -> Vec<usize> {
        let pixel = self.grid.sampling_angstrom();
        let cell = self.grid.points.map(|n| n as f64);
        let reach = pixel.map(|p| NEAR_ANGSTROM / p);
        let origin = [origin.1 as f64, origin.0 as f64];
        let start = [0, 1].map(|k| (origin[k] - reach[k]).rem_euclid(cell[k]));
        let near = |atom: &[f64; 2], k: usize| {
            (atom[k] - start[k]).rem_euclid(cell[k]) <= self.window[k] as f64 + 2.0 * reach[k]
        };
        let met = |atoms: &Vec<[f64; 2]>| {
            // From the window's first row on, around the edge of the cell: large fields have many atoms.
            let (before, after) = atoms.split_at(atoms.partition_point(|a| a[1] < start[1]));
            after.iter().chain(before).take_while(|a| near(a, 1)).any(|a| near(a, 0))
        };
        (0..self.slices.len()).filter(|&i| self.spread || met(&self.slices[i])).collect()
    }

    /// Makes every slice count as filled everywhere.
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
