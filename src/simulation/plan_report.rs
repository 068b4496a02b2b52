//! The plan of a simulation and its cost, as numbers.

use serde::Serialize;

use super::time_estimate;
use crate::engine::{Algorithm, Cost, Grid, Plan};

/// The plan of a simulation and its cost.
#[derive(Debug, Clone, Serialize)]
pub struct PlanReport {
    /// Algorithm and its parameters.
    pub algorithm: Algorithm,
    /// Grid of the waves.
    pub wave_grid: GridReport,
    /// Grid of the transmission functions.
    pub transmission_grid: GridReport,
    /// Grid of the potentials.
    pub potential_grid: GridReport,
    /// Largest angle carried, in mrad.
    pub band_limit_mrad: f64,
    /// Electron wavelength in Angstrom.
    pub wavelength_angstrom: f64,
    /// Slices.
    pub slices: SliceReport,
    /// Thicknesses recorded, in Angstrom.
    pub thicknesses_angstrom: Vec<f64>,
    /// Plane waves of PRISM, or 0.
    pub beams: usize,
    /// Phonon configurations.
    pub configurations: u32,
    /// Probes per simulation.
    pub probes: usize,
    /// Memory of the largest arrays in bytes.
    pub memory_bytes: u64,
    /// Number of threads.
    pub threads: usize,
    /// Estimated time in seconds, from the current speed of transforms: the middle of the range.
    pub estimated_time_s: f64,
    /// Shortest time in seconds, on an idle machine, and longest time, under the machine's current load.
    pub estimated_range_s: [f64; 2],
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// A grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GridReport {
    /// Points along x and y.
    pub points: [usize; 2],
    /// Edges (x, y) in Angstrom.
    pub extent_angstrom: [f64; 2],
    /// Pixel (x, y) in Angstrom.
    pub sampling_angstrom: [f64; 2],
}

/// Slices.
#[derive(Debug, Clone, Serialize)]
pub struct SliceReport {
    /// Number of slices.
    pub count: usize,
    /// Mean number of slices that a wave passes.
    pub passed: f64,
    /// Thickness of the thinnest slice in Angstrom.
    pub thinnest_angstrom: f64,
    /// Thickness of the thickest slice in Angstrom.
    pub thickest_angstrom: f64,
}

impl From<&Grid> for GridReport {
    fn from(grid: &Grid) -> Self {
        GridReport {
            points: grid.points,
            extent_angstrom: grid.extent_angstrom,
            sampling_angstrom: grid.sampling_angstrom(),
        }
    }
}

impl PlanReport {
    /// Reports a plan that runs `runs` times, each at this cost. Measures the speed of the machine for 0.2 s.
    pub fn new(plan: &Plan, cost: &Cost, runs: usize) -> Self {
        let thickness = plan.slices.boundaries.windows(2).map(|w| w[1] - w[0]);
        let slices = SliceReport {
            count: plan.slices.len(),
            passed: cost.steps_per_wave,
            thinnest_angstrom: thickness.clone().fold(f64::INFINITY, f64::min),
            thickest_angstrom: thickness.fold(0.0, f64::max),
        };
        let threads = time_estimate::threads();
        let estimated_range_s = time_estimate::seconds(plan, cost, runs);
        PlanReport {
            algorithm: plan.settings.algorithm,
            wave_grid: (&plan.wave_grid).into(),
            transmission_grid: (&plan.transmission_grid).into(),
            potential_grid: (&plan.potential_grid).into(),
            band_limit_mrad: plan.band_limit_mrad,
            wavelength_angstrom: plan.settings.optics.wavelength_angstrom(),
            slices,
            thicknesses_angstrom: plan.thicknesses_angstrom(),
            beams: plan.beams,
            configurations: plan.settings.configurations(),
            probes: cost.probes,
            memory_bytes: cost.memory_bytes(threads),
            threads,
            estimated_time_s: middle(estimated_range_s),
            estimated_range_s,
            warnings: plan.warnings.clone(),
        }
    }

    /// Adds the time of other simulations.
    pub(crate) fn add_time(&mut self, [least, most]: [f64; 2]) {
        self.estimated_range_s[0] += least;
        self.estimated_range_s[1] += most;
        self.estimated_time_s = middle(self.estimated_range_s);
    }
}

/// The geometric mean of a range that is known up to a factor.
fn middle([least, most]: [f64; 2]) -> f64 {
    (least * most).sqrt()
}
