//! An audit of a world, or of a world that has not been built yet.

use std::sync::Arc;

use super::made_world::{WorldEngine, imaging_of, planned_imaging};
use crate::error::{Error, Result};
use crate::imaging::{AUDIT_REMEDY, Audit, AuditOptions, Cache, ImagingChoice, audit, audit_cost};
use crate::progress::Progress;
use crate::recipe::CheckedRecipe;
use crate::setting::Setting;
use crate::specimen::{Specimen, specimen};

/// An audit that is ready to run: it simulates regions of a field with the exact engine and the same atoms, and compares them.
pub struct AuditJob {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    imaging: ImagingChoice,
    options: AuditOptions,
}

impl AuditJob {
    /// Prepares an audit of a recipe's field. `made` describes how its world was made. Without a world the field is imaged as a build would
    /// image it, with windows of `window_angstrom` if a width is given.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a world of the exact engine, and for a window that a world does not have; errors of the specimen.
    pub fn new(
        recipe: CheckedRecipe,
        made: Option<&WorldEngine>,
        options: AuditOptions,
        cache: Cache,
        window_angstrom: Option<f64>,
    ) -> Result<Self> {
        if let Some(made) = made.filter(|made| made.engine == "multislice") {
            let expected = "the world was made by the exact engine, which is the reference of audits; it needs no audit";
            return Err(Error::invalid(Setting::Algorithm, &made.engine, expected));
        }
        let imaging = match (made, window_angstrom) {
            (Some(_), Some(window)) => {
                let expected = "the world file contains the settings of its engine; name its recipe instead to choose a window";
                return Err(Error::invalid(Setting::WindowAngstrom, window, expected));
            }
            (Some(_), None) => imaging_of(&recipe, made, cache)?,
            (None, window) => planned_imaging(&recipe, cache, window)?,
        };
        Ok(AuditJob { specimen: specimen(&recipe)?, recipe, imaging, options })
    }

    /// Estimates the memory in bytes that the audit takes on `threads` threads; also returns advice on how to need less.
    ///
    /// # Errors
    /// Errors of the plan.
    pub fn memory(&self, threads: usize) -> Result<(u64, &'static str)> {
        let cost = audit_cost(&self.recipe, &*self.specimen, &self.options)?.cost;
        Ok((cost.memory_bytes(threads), AUDIT_REMEDY))
    }

    /// Simulates the regions with the exact engine and compares them.
    ///
    /// # Errors
    /// Errors of the imaging, and [`Error::Interrupted`].
    pub fn run(&self, progress: &dyn Progress) -> Result<Audit> {
        let mut imager = self.imaging.imager(&self.recipe, &self.specimen)?;
        imager.prepare(progress)?;
        audit(&self.recipe, &*self.specimen, &*imager, &self.options, progress)
    }
}
