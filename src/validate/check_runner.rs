//! Runs the simulations of the cases under one progress bar.

use crate::engine::{Images, Plan, Scan, Settings, Site, simulate};
use crate::error::Result;
use crate::progress::Progress;
use crate::progress::ProgressShare;

/// Runs simulations, and reports each as a share of the total progress.
pub(crate) struct CheckRunner<'a> {
    progress: &'a dyn Progress,
    /// Units of progress for one simulation.
    units: usize,
}

impl<'a> CheckRunner<'a> {
    /// Makes a runner whose simulations each count `units` towards `progress`.
    pub(crate) fn new(progress: &'a dyn Progress, units: usize) -> Self {
        CheckRunner { progress, units }
    }

    /// Returns the progress of one simulation; call [`ProgressShare::complete`] at its end.
    pub(crate) fn share(&self) -> ProgressShare<'a> {
        ProgressShare::new(self.progress, self.units)
    }

    /// Plans and runs a simulation.
    ///
    /// # Errors
    /// As [`Plan::new`] and [`simulate`].
    pub(crate) fn simulate(
        &self,
        settings: &Settings,
        sites: &[Site],
        cell_angstrom: [f64; 3],
        scan: &Scan,
    ) -> Result<Images> {
        self.execute(&plan(settings, sites, cell_angstrom)?, sites, scan)
    }

    /// Runs a planned simulation.
    ///
    /// # Errors
    /// As [`simulate`].
    pub(crate) fn execute(&self, plan: &Plan, sites: &[Site], scan: &Scan) -> Result<Images> {
        let share = self.share();
        let images = simulate(plan, sites, scan, &share)?;
        share.complete();
        Ok(images)
    }
}

/// Plans a simulation for the mean heights of the sites.
pub fn plan(settings: &Settings, sites: &[Site], cell_angstrom: [f64; 3]) -> Result<Plan> {
    let z: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
    Plan::new(settings, cell_angstrom, &z)
}
