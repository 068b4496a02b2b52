//! Which imager makes a field, and whether it is as right as asked.

use std::sync::Arc;

use super::audit::region_audit::{Audit, AuditOptions, audit};
use super::direct::DirectImager;
use super::film::film_imager::FilmImager;
use super::imaging_cost::ImagingCost;
use super::mosaic::library_cache::Cache;
use super::mosaic::mosaic_imager::MosaicImager;
use super::region_imager::RegionImager;
use super::simulator::Simulator;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::recipe::CheckedRecipe;
use crate::specimen::Specimen;

/// Windows in Angstrom that are tried in turn for a requested error.
const WIDER: [f64; 1] = [11.7];

/// What may be made of a field besides simulating all of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MethodChoice {
    /// Films with particles by their parts, mosaics where they take less, else direct simulation.
    Auto,
    /// A mosaic wherever anything repeats, whether it pays or not.
    Mosaic,
    /// Direct simulation.
    Direct,
}

/// How images of a field are to be made.
#[derive(Debug, Clone)]
pub struct ImagingChoice {
    /// Simulates the library of a mosaic, the particles on a film, or all.
    pub simulator: Simulator,
    /// What else may be done.
    pub method: MethodChoice,
    /// Where images of the library are kept.
    pub cache: Cache,
}

/// How right an imager has to be before a world is made with it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImagingCheck {
    /// What is compared; nothing when `None`.
    pub audit: Option<AuditOptions>,
    /// Largest error that is accepted, in per cent: rms at bright columns of their intensity, and of all pixels of
    /// the brightest column.
    pub max_error_percent: Option<f64>,
    /// Audit fields that are simulated directly too.
    pub direct: bool,
}

impl ImagingChoice {
    /// The imager of a field, yet to be prepared.
    ///
    /// # Errors
    /// Those of the settings.
    pub fn imager(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<Box<dyn RegionImager>> {
        match self.sharing(recipe, specimen)? {
            Some(imager) => Ok(imager),
            None => Ok(Box::new(self.direct(recipe, specimen)?)),
        }
    }

    /// What making a field takes, of which each of `subtiles` parts has `subtile` (rows, columns) pixels.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn cost(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        subtile: [usize; 2],
        subtiles: usize,
    ) -> Result<ImagingCost> {
        let direct = || self.direct(recipe, specimen)?.cost(subtile, subtiles);
        if self.method == MethodChoice::Direct {
            return direct();
        }
        if let Some(film) = FilmImager::new(recipe, specimen, &self.simulator)? {
            return film.cost(subtile, subtiles);
        }
        let mosaic = self.mosaic(recipe, specimen)?;
        match self.worth(&mosaic) {
            true => mosaic.cost(subtile, subtiles),
            false => Ok(ImagingCost { mosaic: Some(mosaic.mosaic_cost()), ..direct()? }),
        }
    }

    fn mosaic(&self, recipe: &CheckedRecipe, specimen: &Arc<dyn Specimen>) -> Result<MosaicImager> {
        MosaicImager::new(recipe, specimen, self.simulator.clone(), self.cache.clone())
    }

    fn worth(&self, mosaic: &MosaicImager) -> bool {
        self.method == MethodChoice::Mosaic || mosaic.pays()
    }

    /// The imager that takes less than simulating the whole field, if there is one.
    fn sharing(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<Option<Box<dyn RegionImager>>> {
        if self.method == MethodChoice::Direct {
            return Ok(None);
        }
        if let Some(film) = FilmImager::new(recipe, specimen, &self.simulator)? {
            return Ok(Some(Box::new(film)));
        }
        let mosaic = self.mosaic(recipe, specimen)?;
        Ok(self.worth(&mosaic).then(|| Box::new(mosaic) as Box<dyn RegionImager>))
    }

    fn direct(&self, recipe: &CheckedRecipe, specimen: &Arc<dyn Specimen>) -> Result<DirectImager> {
        DirectImager::new(recipe, specimen, self.simulator.clone())
    }

    /// This, and if `more` the same with wider windows.
    fn widening(&self, more: bool) -> Vec<ImagingChoice> {
        let mut choices = vec![self.clone()];
        let Some(now) = self.simulator.window_angstrom() else { return choices };
        for width in WIDER.into_iter().filter(|w| more && *w > now) {
            let simulator = self.simulator.with_window(width);
            choices.push(ImagingChoice { simulator, ..self.clone() });
        }
        choices
    }

    /// Prepares the imager of a field; returns the audit of what was chosen, if one was asked for. Imagers that simulate the
    /// field itself are audited only where that or a largest error is asked for. Where the error is too large, wider windows are
    /// tried, and then direct simulation.
    ///
    /// # Errors
    /// [`Error::Invalid`] when nothing is as right as asked, those of the engine, and [`Error::Interrupted`].
    pub fn checked_imager(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        check: &ImagingCheck,
        progress: &dyn Progress,
    ) -> Result<(Box<dyn RegionImager>, Option<Audit>)> {
        let limit = check.max_error_percent;
        let audited = |imager: &dyn RegionImager| match &check.audit {
            Some(options) => audit(recipe, &**specimen, imager, options, progress).map(Some),
            None => Ok(None),
        };
        let mut widest = self.clone();
        for choice in self.widening(limit.is_some()) {
            let Some(mut imager) = choice.sharing(recipe, specimen)? else { break };
            imager.prepare(progress)?;
            let found = audited(&*imager)?;
            if accepted(found.as_ref(), limit, progress) {
                return Ok((imager, found));
            }
            widest = choice;
        }
        if check.audit.is_none() || limit.is_none() {
            let imager = widest.direct(recipe, specimen)?;
            let found = if check.direct { audited(&imager)? } else { None };
            return Ok((Box::new(imager), found));
        }
        for choice in widest.widening(true) {
            let imager = choice.direct(recipe, specimen)?;
            let found = audited(&imager)?;
            if accepted(found.as_ref(), limit, progress) {
                return Ok((Box::new(imager), found));
            }
        }
        let expected =
            "no window is as right here; use the engine multislice, or prism with interpolation 1";
        Err(Error::invalid(
            crate::Setting::LargestErrorPercent,
            limit.unwrap_or_default(),
            expected,
        ))
    }
}

fn accepted(found: Option<&Audit>, limit: Option<f64>, progress: &dyn Progress) -> bool {
    let (Some(found), Some(limit)) = (found, limit) else { return true };
    let error = found.bright_rms_percent.max(found.all_rms_percent);
    if error > limit {
        progress.warn(&format!(
            "{}: {:.2} % at bright columns, {:.2} % over all pixels, and at most {limit} % are asked for",
            found.engine, found.bright_rms_percent, found.all_rms_percent
        ));
    }
    error <= limit
}
