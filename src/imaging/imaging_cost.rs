//! The cost of the image of a field.

use super::mosaic::mosaic_cost::MosaicCost;
use crate::engine::{Cost, Plan, PlannedScan};

/// A number of similar simulations.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationRuns {
    /// The plan of each simulation.
    pub plan: Plan,
    /// The cost of each simulation.
    pub cost: Cost,
    /// The number of simulations.
    pub runs: usize,
}

impl SimulationRuns {
    /// A number of simulations with this plan and cost.
    pub(crate) fn new(planned: PlannedScan, runs: usize) -> Self {
        SimulationRuns { plan: planned.plan, cost: planned.cost, runs }
    }

    /// Replaces the number of probes in each simulation.
    #[must_use]
    pub(crate) fn for_probes(self, probes: usize) -> Self {
        SimulationRuns { cost: self.cost.for_probes(probes), ..self }
    }
}

/// The cost of the image of a field.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagingCost {
    /// The simulations that decide memory and time.
    pub main: SimulationRuns,
    /// Further simulations, of columns like no other, that take time.
    pub more: Option<SimulationRuns>,
    /// A plan whose memory is not needed at the same time as that of `main`.
    pub largest_block: Option<SimulationRuns>,
    /// Distance (x, y) of probes in Angstrom.
    pub probe_step_angstrom: [f64; 2],
    /// Memory of the images that are kept.
    pub image_bytes: u64,
    /// The cost of the mosaic, also of one that is not cheaper than direct simulation.
    pub mosaic: Option<MosaicCost>,
    /// Probes that the particles on a film need in each configuration.
    pub particle_probes: Option<usize>,
}

impl ImagingCost {
    /// Memory in bytes of the largest arrays on this number of threads.
    pub(crate) fn memory_bytes(&self, threads: usize) -> u64 {
        let largest = self.largest(threads).cost;
        self.image_bytes + largest.memory_bytes(threads)
    }

    /// Advice for too little memory: what most of it is used for, and what needs less.
    pub(crate) fn memory_remedy(&self, threads: usize) -> &'static str {
        let largest = self.largest(threads).cost;
        match self.image_bytes > largest.memory_bytes(threads) {
            true => {
                "the library of the mosaic needs most of the memory; use windows without a mosaic"
            }
            false => largest.memory_remedy(threads),
        }
    }

    fn largest(&self, threads: usize) -> &SimulationRuns {
        let others = [self.more.as_ref(), self.largest_block.as_ref()].into_iter().flatten();
        others.fold(&self.main, |most, runs| {
            let bytes = |r: &SimulationRuns| r.cost.memory_bytes(threads);
            if bytes(runs) > bytes(most) { runs } else { most }
        })
    }
}
