//! The cost of a simulation: waves, steps, operations and memory, estimated without running it.

use super::bright_detectors::bright_box_bins;
use super::grid::Grid;
use super::plan::Plan;
use super::probe_patches::{ProbePatches, expanded_waves, waves_of_patch};
use super::probe_scan::Scan;
use super::settings::Algorithm;
use super::slice_coverage::{SliceCoverage, place};
use super::stepper::waves_together;
use crate::optics::foci;
use crate::plane;
use crate::structure::Site;

/// Largest number of windows that are examined to estimate how many slices a wave passes.
const SAMPLED_WINDOWS: usize = 400;
/// Bytes of a complex number.
const COMPLEX_BYTES: usize = 8;
/// Number of arrays of the potential grid that each thread holds.
const POTENTIAL_ARRAYS: u64 = 5;
/// Number of arrays of the wave grid that each thread holds besides the waves that step together.
const EXTRA_WAVES: u64 = 2;
/// Operations for each value of the waves that all patches share where detectors read the coherent tail. Measured for MoS2 at 80 kV: they
/// take as long as these nominal operations of multislice.
const SHARED_WAVES_FLOPS: f64 = 1e5;
/// Bytes of an image for each probe, detector and thickness.
const IMAGE_BYTES: usize = 16;

/// The cost of simulating a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Cost {
    /// Number of probes.
    pub probes: usize,
    /// Waves propagated for each probe; fewer than 1 where probes are expanded in fewer waves. PRISM propagates its beams instead, for any
    /// number of probes.
    pub waves_per_probe: f64,
    /// Slices that a wave passes: all, or the mean over windows, which skip slices without atoms.
    pub steps_per_wave: f64,
    /// Beams of PRISM, 0 with other algorithms.
    beams: usize,
    configurations: u32,
    /// Nominal operations of one step of one wave.
    step_flops: f64,
    /// Nominal operations of the potentials of one configuration.
    potential_flops: f64,
    /// Nominal operations of the reduction of PRISM, for each probe.
    reduction_flops: f64,
    /// Operations before the first probe, as the nominal ones that take equally long.
    once_flops: f64,
    /// Bytes of the memory that threads share.
    shared_bytes: u64,
    /// Bytes of memory of each thread.
    thread_bytes: u64,
    /// Bytes of memory of the images, for each probe.
    probe_bytes: usize,
}

/// A plan, with its scan and the cost of both.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub(crate) struct PlannedScan {
    /// The plan.
    pub plan: Plan,
    /// The probes.
    pub scan: Scan,
    /// The cost of this scan.
    pub cost: Cost,
}

impl Cost {
    /// The cost of a scan whose waves pass all slices of the plan.
    pub fn new(plan: &Plan, scan: &Scan) -> Self {
        // Expanded probes of all foci share their waves.
        let foci = foci(&plan.settings.optics).map_or(1, |foci| foci.len());
        let waves = expanded_waves(plan, scan).unwrap_or(scan.len() * foci);
        Cost {
            probes: scan.len(),
            waves_per_probe: waves as f64 / scan.len().max(1) as f64,
            steps_per_wave: plan.slices.len() as f64,
            beams: plan.beams,
            configurations: plan.settings.configurations(),
            step_flops: 2.0 * transform_flops(&plan.wave_grid),
            potential_flops: plan.slices.len() as f64 * 4.0 * transform_flops(&plan.potential_grid),
            reduction_flops: reduction_flops(plan) * foci as f64,
            once_flops: shared_waves_flops(plan) * foci as f64,
            shared_bytes: shared_bytes(plan),
            thread_bytes: thread_bytes(plan),
            probe_bytes: plan.settings.detectors.len() * plan.record_after.len() * IMAGE_BYTES,
        }
    }

    /// Estimates the cost as [`Cost::new`] does, with the mean number of slices in which windows of this scan meet atoms.
    pub(crate) fn with_atoms(plan: &Plan, scan: &Scan, sites: &[Site]) -> Self {
        let cost = Cost::new(plan, scan);
        if !plan.has_windows() || scan.is_empty() {
            return cost;
        }
        let coverage = SliceCoverage::new(plan, &place(plan, sites, 0));
        let patches = ProbePatches::new(plan, scan).patches;
        let sampled: Vec<usize> = patches
            .iter()
            .step_by(patches.len().div_ceil(SAMPLED_WINDOWS))
            .map(|patch| coverage.within(patch.origin).len())
            .collect();
        let steps_per_wave = sampled.iter().sum::<usize>() as f64 / sampled.len() as f64;
        Cost { steps_per_wave, ..cost }
    }

    /// The cost of another number of probes, with equally many waves for each probe.
    #[must_use]
    pub(crate) fn for_probes(self, probes: usize) -> Self {
        Cost { probes, ..self }
    }

    /// Waves propagated for each phonon configuration.
    pub(crate) fn waves(&self) -> f64 {
        match self.beams {
            0 => self.probes as f64 * self.waves_per_probe,
            beams => beams as f64,
        }
    }

    /// Nominal floating-point operations of all phonon configurations, `5 N log2 N` a transform.
    pub(crate) fn nominal_flops(&self) -> f64 {
        let propagation = self.waves() * self.steps_per_wave * self.step_flops;
        let reduction = self.probes as f64 * self.reduction_flops;
        let each = propagation + self.potential_flops + reduction;
        f64::from(self.configurations) * each + self.once_flops
    }

    /// Advice for too little memory on `threads` threads: what most of it is used for, and what needs less.
    pub(crate) fn memory_remedy(&self, threads: usize) -> &'static str {
        let images = (self.probes * self.probe_bytes) as u64;
        let waves = self.thread_bytes * threads as u64;
        if images >= waves.max(self.shared_bytes) {
            "images need most of the memory; use fewer probes, detectors or thicknesses"
        } else if waves >= self.shared_bytes {
            "the waves of each thread need most of the memory; use windows that follow the probe, or fewer threads"
        } else if self.beams > 0 {
            "the waves of PRISM need most of the memory; use windows that follow the probe, or a larger interpolation factor"
        } else {
            "the potential of all slices needs most of the memory; use a smaller specimen, a smaller part of it at a time, or a coarser grid"
        }
    }

    /// Memory in bytes of the largest arrays on `threads` threads.
    pub(crate) fn memory_bytes(&self, threads: usize) -> u64 {
        let images = (self.probes * self.probe_bytes) as u64;
        self.shared_bytes + self.thread_bytes * threads as u64 + images
    }
}

impl PlannedScan {
    /// Estimates the cost of a scan; `sites` are the atoms, if they are known.
    pub(crate) fn new(plan: Plan, scan: Scan, sites: Option<&[Site]>) -> Self {
        let cost = match sites {
            Some(sites) => Cost::with_atoms(&plan, &scan, sites),
            None => Cost::new(&plan, &scan),
        };
        PlannedScan { plan, scan, cost }
    }
}

/// Nominal operations of one transform.
fn transform_flops(grid: &Grid) -> f64 {
    let n = (grid.points[0] * grid.points[1]) as f64;
    5.0 * n * n.log2()
}

/// Nominal operations of the reduction of PRISM, for each probe.
fn reduction_flops(plan: &Plan) -> f64 {
    match (&plan.exit_grid, plan.settings.algorithm) {
        (Some(g), Algorithm::Prism { interpolation }) => {
            let window = (g.points[0] / interpolation[0] * (g.points[1] / interpolation[1])) as f64;
            plan.record_after.len() as f64 * 8.0 * window * plan.beams as f64 * 1.3
        }
        _ => 0.0,
    }
}

/// Operations that choose the waves of a patch for detectors that read the coherent tail.
fn shared_waves_flops(plan: &Plan) -> f64 {
    let values = bright_box_bins(plan) as f64 * waves_of_patch(plan) as f64;
    SHARED_WAVES_FLOPS * values
}

fn grid_bytes(grid: &Grid) -> u64 {
    (grid.points[0] * grid.points[1] * COMPLEX_BYTES) as u64
}

/// Bytes of transmission functions and exit waves.
fn shared_bytes(plan: &Plan) -> u64 {
    // Transmission functions continue beyond the cell, so that no window reaches past them.
    let padding = if plan.has_windows() { plan.wave_grid.points } else { [0, 0] };
    let [nx, ny] = plane::add(plan.transmission_grid.points, padding);
    let transmission = (nx * ny * COMPLEX_BYTES * plan.slices.len()) as u64;
    let exit = plan.exit_grid.as_ref().map_or(0, |g| grid_bytes(g) * plan.beams as u64);
    transmission + exit
}

/// Bytes of the waves and potentials of one thread.
fn thread_bytes(plan: &Plan) -> u64 {
    let wave = grid_bytes(&plan.wave_grid);
    // Expanded probes need the waves of a patch, and equally many amplitudes on detectors.
    let together = waves_together(wave as usize).max(2 * waves_of_patch(plan));
    wave * (together as u64 + EXTRA_WAVES) + grid_bytes(&plan.potential_grid) * POTENTIAL_ARRAYS
}
