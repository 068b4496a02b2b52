//! What making the image of a field will take.

use super::mosaic::mosaic_cost::MosaicCost;
use crate::engine::{Cost, Plan, PlannedScan};

/// Simulations that are alike.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationRuns {
    /// The plan of each.
    pub plan: Plan,
    /// What each takes.
    pub cost: Cost,
    /// How many there are.
    pub runs: usize,
}

impl SimulationRuns {
    /// So many simulations as planned.
    pub fn new(planned: PlannedScan, runs: usize) -> Self {
        SimulationRuns { plan: planned.plan, cost: planned.cost, runs }
    }

    /// The same with another number of probes in each.
    #[must_use]
    pub fn for_probes(self, probes: usize) -> Self {
        SimulationRuns { cost: self.cost.for_probes(probes), ..self }
    }
}

/// What making the image of a field will take.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagingCost {
    /// The simulations that decide memory and time.
    pub main: SimulationRuns,
    /// Others that take time, of columns like no other.
    pub more: Option<SimulationRuns>,
    /// A plan whose memory is needed at another time than that of `main`.
    pub largest_block: Option<SimulationRuns>,
    /// Distance (x, y) of probes in Angstrom.
    pub probe_step_angstrom: [f64; 2],
    /// Memory of images that are kept.
    pub image_bytes: u64,
    /// What is known of a mosaic, also of one that does not pay.
    pub mosaic: Option<MosaicCost>,
    /// Probes of each configuration that the particles on a film take.
    pub particle_probes: Option<usize>,
}

impl ImagingCost {
    /// Bytes of memory that the largest arrays take on so many threads.
    pub fn memory_bytes(&self, threads: usize) -> u64 {
        let largest = self.largest(threads).cost;
        self.image_bytes + largest.memory_bytes(threads)
    }

    /// What most of the memory goes to, and what takes less.
    pub fn memory_remedy(&self, threads: usize) -> &'static str {
        let largest = self.largest(threads).cost;
        match self.image_bytes > largest.memory_bytes(threads) {
            true => "most of it is the library of the mosaic: windows without a mosaic take less",
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
