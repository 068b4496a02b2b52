//! Chooses the imager of a field, and checks that its error is as small as requested.

use std::sync::Arc;
use std::time::Duration;

use super::audit::kept_audits::KeptAudits;
use super::audit::region_audit::{Audit, AuditOptions};
use super::direct::{DirectImager, rectangle_plan};
use super::film::film_imager::FilmImager;
use super::film::surface_imager::SurfaceImager;
use super::imaging_cost::ImagingCost;
use super::mosaic::library_cache::Cache;
use super::mosaic::mosaic_cost::MosaicCost;
use super::mosaic::mosaic_imager::MosaicImager;
use super::mosaic::shared_cells::SharedCells;
use super::region_imager::RegionImager;
use super::simulator::Simulator;
use super::source_imager::SourceImager;
use crate::engine::measure_speed;
use crate::error::Result;
use crate::progress::{Progress, duration};
use crate::recipe::CheckedRecipe;
use crate::specimen::Specimen;

/// Widths of windows in Angstrom, tried in this order when the error is larger than requested.
const WIDER: [f64; 2] = [11.7, 15.6];
/// Duration of the measurement of the exact engine's speed, before this engine replaces windows.
const SPEED_MEASURED: Duration = Duration::from_millis(300);

/// Which imagers may replace the direct simulation of the whole field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MethodChoice {
    /// The film imager for particles on films, a mosaic where it is cheaper, else direct simulation.
    Auto,
    /// A mosaic wherever anything repeats, cheaper or not.
    Mosaic,
    /// Direct simulation.
    Direct,
}

/// How the images of a field are made.
#[derive(Debug, Clone)]
pub struct ImagingChoice {
    /// Simulates the library of a mosaic, the particles on a film, or the whole field.
    pub simulator: Simulator,
    /// The allowed alternatives to direct simulation.
    pub method: MethodChoice,
    /// The cache of the library's images.
    pub cache: Cache,
}

/// The imager of a field, not yet prepared.
pub(crate) struct ChosenImager {
    /// The imager.
    pub imager: Box<dyn RegionImager>,
    /// Whether the imager is cheaper than a simulation of the whole field.
    shares: bool,
    /// Whether the imager is a mosaic whose library was audited when it was made.
    known: bool,
    /// The cost of a mosaic that was not chosen because it would not be cheaper.
    declined: Option<MosaicCost>,
}

impl ChosenImager {
    /// Whether the imager is cheaper than a simulation of the whole field.
    pub(crate) fn shares(&self) -> bool {
        self.shares
    }

    /// Whether the imager is a mosaic whose library was audited when it was made.
    pub(crate) fn is_known(&self) -> bool {
        self.known
    }

    /// The cost of a field of `subtiles` parts, each of `subtile` (rows, columns) pixels.
    ///
    /// # Errors
    /// Errors of [`crate::engine::Plan::new`].
    pub(crate) fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        let cost = self.imager.cost(subtile, subtiles)?;
        Ok(ImagingCost { mosaic: cost.mosaic.or_else(|| self.declined.clone()), ..cost })
    }
}

/// How accurate an imager has to be before it makes a world.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImagingCheck {
    /// The audit; no audit when `None`.
    pub audit: Option<AuditOptions>,
    /// Largest accepted error in per cent. It limits both the rms error at bright columns, relative to their intensity, and the rms error
    /// of all pixels, relative to the brightest column.
    pub max_error_percent: Option<f64>,
    /// Largest accepted rms error of all pixels, in per cent of the mean image.
    pub accuracy_percent: Option<f64>,
    /// Whether fields that are simulated directly are audited too.
    pub direct: bool,
}

impl ImagingChoice {
    /// The imager of a field, not yet prepared.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn imager(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<Box<dyn RegionImager>> {
        Ok(self.chosen(recipe, specimen)?.imager)
    }

    /// The imager of one of many specimens that differ in little but their seed. It shares the library of a mosaic with the others and need
    /// not be prepared: a library cell is read from the cache, or simulated, when an image first needs it.
    ///
    /// # Errors
    /// Invalid settings.
    pub(crate) fn imager_of_many(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        shared: &Arc<SharedCells>,
    ) -> Result<Box<dyn RegionImager>> {
        if self.method == MethodChoice::Direct || !SurfaceImager::can_cover(recipe) {
            return self.blurred_direct(recipe, specimen);
        }
        let imager: Box<dyn RegionImager> =
            match FilmImager::new(recipe, specimen, &self.simulator)? {
                Some(film) => Box::new(film),
                None => {
                    let (simulator, cache) = (self.simulator.clone(), self.cache.clone());
                    Box::new(MosaicImager::growing(recipe, specimen, simulator, cache, shared)?)
                }
            };
        self.finished(imager, recipe, &**specimen)
    }

    /// The imager of a field, not yet prepared, with the facts that led to its choice.
    ///
    /// # Errors
    /// Invalid settings.
    pub(crate) fn chosen(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<ChosenImager> {
        let mut declined = None;
        if self.method != MethodChoice::Direct && SurfaceImager::can_cover(recipe) {
            let shares = true;
            if let Some(film) = FilmImager::new(recipe, specimen, &self.simulator)? {
                let imager = self.finished(Box::new(film), recipe, &**specimen)?;
                return Ok(ChosenImager { imager, shares, known: false, declined });
            }
            let (simulator, cache) = (self.simulator.clone(), self.cache.clone());
            let mosaic = MosaicImager::new(recipe, specimen, simulator, cache)?;
            if self.method == MethodChoice::Mosaic || mosaic.pays() {
                let known = mosaic.is_known();
                let imager = self.finished(Box::new(mosaic), recipe, &**specimen)?;
                return Ok(ChosenImager { imager, shares, known, declined });
            }
            declined = Some(mosaic.mosaic_cost());
        }
        let imager = self.blurred_direct(recipe, specimen)?;
        Ok(ChosenImager { imager, shares: false, known: false, declined })
    }

    /// The mosaic of a field, or `None` if its images are made otherwise.
    ///
    /// # Errors
    /// Invalid settings.
    pub(crate) fn mosaic(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<Option<MosaicImager>> {
        if self.method == MethodChoice::Direct
            || !SurfaceImager::can_cover(recipe)
            || FilmImager::new(recipe, specimen, &self.simulator)?.is_some()
        {
            return Ok(None);
        }
        let (simulator, cache) = (self.simulator.clone(), self.cache.clone());
        let mosaic = MosaicImager::new(recipe, specimen, simulator, cache)?;
        Ok(Some(mosaic).filter(|m| self.method == MethodChoice::Mosaic || m.pays()))
    }

    /// Adds the layers on the faces, and then the blur of the source, to an imager of the bare specimen for a point source.
    fn finished(
        &self,
        imager: Box<dyn RegionImager>,
        recipe: &CheckedRecipe,
        specimen: &dyn Specimen,
    ) -> Result<Box<dyn RegionImager>> {
        let settings = self.simulator.settings();
        let imager = SurfaceImager::covering(imager, recipe, specimen, settings)?;
        Ok(SourceImager::blurring(imager, recipe))
    }

    fn blurred_direct(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
    ) -> Result<Box<dyn RegionImager>> {
        Ok(SourceImager::blurring(Box::new(self.direct(recipe, specimen)?), recipe))
    }

    fn direct(&self, recipe: &CheckedRecipe, specimen: &Arc<dyn Specimen>) -> Result<DirectImager> {
        DirectImager::new(recipe, specimen, self.simulator.clone())
    }

    /// This choice, and if `more`, copies of it with wider windows.
    fn widening(&self, more: bool) -> Vec<ImagingChoice> {
        let mut choices = vec![self.clone()];
        let Some(now) = self.simulator.window_angstrom() else { return choices };
        for width in WIDER.into_iter().filter(|w| more && *w > now) {
            let simulator = self.simulator.with_window(width);
            choices.push(ImagingChoice { simulator, ..self.clone() });
        }
        choices
    }

    /// Prepares the imager of a field and audits it. Takes `first` if its error is accepted. Otherwise tries wider windows, then direct
    /// simulation in windows, then the exact engine. Returns the imager and its audit, if one was requested. Imagers that simulate the
    /// field directly, and mosaics made from the supplied library alone, are audited only where [`ImagingCheck`] asks for it or limits the
    /// error.
    ///
    /// # Errors
    /// Errors of the engine, and [`crate::Error::Interrupted`].
    pub(crate) fn checked_imager(
        &self,
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        first: ChosenImager,
        (check, kept): (&ImagingCheck, &KeptAudits),
        progress: &dyn Progress,
    ) -> Result<(Box<dyn RegionImager>, Option<Audit>)> {
        let audited = |imager: &dyn RegionImager| match &check.audit {
            Some(options) => kept.audit(recipe, &**specimen, imager, options, progress).map(Some),
            None => Ok(None),
        };
        let mut widest = self.clone();
        let mut first = Some(first);
        for choice in self.widening(check.limited()) {
            let chosen = first.take().map_or_else(|| choice.chosen(recipe, specimen), Ok)?;
            if !chosen.shares {
                break;
            }
            let mut imager = chosen.imager;
            imager.prepare(progress)?;
            let needless = chosen.known && !check.asked();
            let found = if needless { None } else { audited(&*imager)? };
            if check.accepts(found.as_ref(), progress) {
                return Ok((imager, found));
            }
            widest = choice;
        }
        if check.audit.is_none() || !check.limited() {
            let imager = widest.blurred_direct(recipe, specimen)?;
            let found = if check.direct { audited(&*imager)? } else { None };
            return Ok((imager, found));
        }
        for choice in widest.widening(true) {
            if choice.simulator.is_exact() {
                break;
            }
            let imager = choice.blurred_direct(recipe, specimen)?;
            let found = audited(&*imager)?;
            if check.accepts(found.as_ref(), progress) {
                return Ok((imager, found));
            }
        }
        let exact = ImagingChoice { simulator: self.simulator.exact(), ..self.clone() };
        progress.warn(&format!(
            "the exact engine simulates the whole field, which needs {} on this machine",
            exact.time(recipe, specimen)?
        ));
        Ok((exact.blurred_direct(recipe, specimen)?, None))
    }

    /// Estimates the time of a simulation of the whole field, from a short measurement.
    fn time(&self, recipe: &CheckedRecipe, specimen: &Arc<dyn Specimen>) -> Result<String> {
        let shape = recipe.field.pixels(recipe.field.built_grid());
        let block = self.direct(recipe, specimen)?.block(shape);
        let blocks = (shape[0] * shape[1]) as f64 / (block[0] * block[1]) as f64;
        let (run, _) = rectangle_plan(recipe, &**specimen, &self.simulator, block, 1)?;
        let speed = measure_speed(&run.plan, SPEED_MEASURED).steps_per_s;
        let steps = run.cost.waves() * run.cost.steps_per_wave;
        let seconds = blocks * steps * f64::from(run.plan.settings.configurations()) / speed;
        Ok(format!("about {}", duration(seconds)))
    }
}

impl ImagingCheck {
    /// Whether the error is limited.
    pub(crate) fn limited(&self) -> bool {
        self.max_error_percent.is_some() || self.accuracy_percent.is_some()
    }

    /// Whether an audit is requested for any kind of imager.
    pub(crate) fn asked(&self) -> bool {
        self.direct || self.limited()
    }

    /// Whether the errors in an audit are within the limits, on all detectors.
    fn accepts(&self, found: Option<&Audit>, progress: &dyn Progress) -> bool {
        let Some(found) = found else { return true };
        found.all().all(|found| self.accepts_one(found, progress))
    }

    /// Whether the errors on one detector are within the limits.
    fn accepts_one(&self, found: &Audit, progress: &dyn Progress) -> bool {
        let asked = [
            (found.error_percent(), self.max_error_percent),
            (found.mean_rms_percent, self.accuracy_percent),
        ];
        let over =
            asked.into_iter().find(|(error, limit)| limit.is_some_and(|limit| *error > limit));
        let Some((_, Some(limit))) = over else { return true };
        let window = found.window_angstrom.map_or(String::new(), |w| format!(" of {w:.1} A"));
        let of = found.detector.as_ref().map_or(String::new(), |name| format!(", {name}"));
        progress.warn(&format!(
            "{}{window}{of}: the error is {:.2} % at bright columns, {:.2} % over all pixels and {:.2} % of the mean image, but at most \
             {limit} % was asked for",
            found.engine, found.bright_rms_percent, found.all_rms_percent, found.mean_rms_percent
        ));
        false
    }
}
