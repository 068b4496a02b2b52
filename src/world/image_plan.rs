//! The cost of the noise-free image of some pixels, for recordings and tiles that need no world on disk.

use serde::Serialize;

use crate::error::Result;
use crate::imaging::{MosaicCost, RegionImager, SimulationRuns};
use crate::simulation::PlanReport;

/// The cost of the image before it can be recorded or cut into tiles.
#[derive(Debug, Clone, Serialize)]
pub struct ImagePlan {
    /// Pixels of each part: [rows, columns].
    pub part_px: [usize; 2],
    /// Number of parts.
    pub parts: usize,
    /// The library that is filled first, if the image needs one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub library: Option<MosaicCost>,
    /// The simulation of a part or of the library; memory, time and warnings of all parts together.
    #[serde(flatten)]
    pub plan: PlanReport,
}

impl ImagePlan {
    /// Plans `parts` parts of `part_px` pixels. The imager need not be prepared: nothing is simulated, only the speed of the machine is
    /// measured (0.2 s).
    ///
    /// # Errors
    /// Errors of the plan.
    pub fn new(imager: &dyn RegionImager, part_px: [usize; 2], parts: usize) -> Result<Self> {
        let cost = imager.cost(part_px, parts)?;
        let mut plan = report(&cost.main);
        plan.memory_bytes = cost.memory_bytes(plan.threads);
        if let Some(more) = &cost.more {
            plan.add_time(report(more).estimated_range_s);
        }
        Ok(ImagePlan { part_px, parts, library: cost.mosaic, plan })
    }
}

/// Reports simulations of one kind; each report with an estimate measures the speed of the machine.
pub(super) fn report(simulations: &SimulationRuns) -> PlanReport {
    PlanReport::new(&simulations.plan, &simulations.cost, simulations.runs)
}
