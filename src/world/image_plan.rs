//! What the noise-free image of some pixels takes, for recordings and tiles that need no world on disk.

use serde::Serialize;

use crate::error::Result;
use crate::imaging::{MosaicCost, RegionImager, SimulationRuns};
use crate::simulation::PlanReport;

/// What the image takes before it can be recorded or cut into tiles.
#[derive(Debug, Clone, Serialize)]
pub struct ImagePlan {
    /// Rows and columns of pixels of each part.
    pub part_px: [usize; 2],
    /// Number of parts.
    pub parts: usize,
    /// The library that is filled first, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub library: Option<MosaicCost>,
    /// The simulation of a part, or of the library; memory, time and warnings of all.
    #[serde(flatten)]
    pub plan: PlanReport,
}

impl ImagePlan {
    /// Plans so many parts of some pixels with an imager that need not be prepared. Nothing is simulated; the speed of the machine is
    /// measured, in 0.2 s.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn new(imager: &dyn RegionImager, part_px: [usize; 2], parts: usize) -> Result<Self> {
        let cost = imager.cost(part_px, parts)?;
        let mut plan = report(&cost.main);
        plan.memory_bytes = cost.memory_bytes(plan.threads);
        if let Some(more) = &cost.more {
            plan.add_time(report(more).estimated_range_s);
        }
        Ok(ImagePlan { part_px, parts, library: cost.mosaic, plan })
    }

    /// Images that have to be simulated for the library first.
    pub fn missing(&self) -> usize {
        self.library.as_ref().map_or(0, |library| library.missing)
    }
}

/// Like simulations as a report; each with an estimate measures the speed.
pub(super) fn report(simulations: &SimulationRuns) -> PlanReport {
    PlanReport::new(&simulations.plan, &simulations.cost, simulations.runs)
}
