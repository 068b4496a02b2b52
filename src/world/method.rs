//! How the image of a world is made: by a mosaic, or sub-tile by sub-tile.

use super::audit::{Audit, AuditOptions, Source, audit};
use super::build::SubTileEngine;
use super::field_image::FieldImage;
use super::film::FilmImage;
use super::mosaic::{Mosaic, MosaicEngine};
use super::recipe::Recipe;
use super::simulator::Simulator;
use super::specimen::Specimen;
use crate::engine::Algorithm;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Windows in Angstrom that are tried in turn for a requested error.
const WIDER: [f64; 1] = [11.7];

/// What a mosaic's errors are checked with before a world is made of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Check {
    /// What is compared; nothing when `None`.
    pub audit: Option<AuditOptions>,
    /// Largest error that is accepted, in per cent: rms at bright columns of their intensity, and of all pixels of
    /// the brightest column.
    pub max_error_percent: Option<f64>,
}

/// The method that makes the image.
pub enum Method<'a> {
    /// A mosaic, or film and particles each in their own way.
    Field(Box<dyn FieldImage + 'a>),
    /// Every sub-tile is simulated.
    SubTiles(&'a dyn SubTileEngine),
    /// Every sub-tile is simulated, since a mosaic would not pay or not be right enough.
    Instead(Box<Simulator>),
}

impl<'a> Method<'a> {
    /// Chooses the method and prepares it; returns the audit of what was chosen, if one was asked for.
    ///
    /// # Errors
    /// [`Error::Invalid`] when nothing is as right as asked, those of the engine, and [`Error::Interrupted`].
    pub fn prepare(
        engine: &'a dyn SubTileEngine,
        specimen: &'a dyn Specimen,
        recipe: &'a Recipe,
        check: &Check,
        progress: &dyn Progress,
    ) -> Result<(Self, Option<Audit>)> {
        let Some(mosaic) = engine.mosaic() else { return Ok((Method::SubTiles(engine), None)) };
        let mut widest = mosaic.simulator.clone();
        for engine in widening(mosaic, check.max_error_percent.is_some()) {
            let Some(prepared) = field_image(&engine, specimen, recipe, progress)? else { break };
            let found = match &check.audit {
                Some(options) => {
                    let source = Source::Field(&*prepared);
                    Some(audit(recipe, specimen, &source, options, progress)?)
                }
                None => None,
            };
            if accepted(found.as_ref(), check.max_error_percent, progress) {
                return Ok((Method::Field(prepared), found));
            }
            widest = engine.simulator;
        }
        let audited = (&check.audit, check.max_error_percent);
        let (Some(options), Some(limit)) = audited else {
            return Ok((Method::Instead(Box::new(widest)), None));
        };
        for engine in widening(&MosaicEngine { simulator: widest, ..mosaic.clone() }, true) {
            let simulator = engine.simulator;
            let found = audit(recipe, specimen, &Source::Direct(&simulator), options, progress)?;
            if accepted(Some(&found), Some(limit), progress) {
                return Ok((Method::Instead(Box::new(simulator)), Some(found)));
            }
        }
        let expected =
            "no window is as right here; use the engine multislice, or prism with interpolation 1";
        Err(Error::invalid(crate::Setting::LargestErrorPercent, limit, expected))
    }

    /// Its name.
    pub fn name(&self) -> String {
        match self {
            Method::Field(field) => field.name().into(),
            Method::SubTiles(engine) => engine.name(),
            Method::Instead(simulator) => simulator.name(),
        }
    }

    /// Settings that decide the image.
    pub fn parameters(&self) -> serde_json::Value {
        match self {
            Method::Field(field) => field.parameters(),
            Method::SubTiles(engine) => engine.parameters(),
            Method::Instead(simulator) => simulator.parameters(),
        }
    }
}

/// The method for a specimen, prepared; `None` where simulating the field itself takes less.
///
/// # Errors
/// Those of the engine, and [`Error::Interrupted`].
pub fn field_image<'a>(
    engine: &MosaicEngine,
    specimen: &'a dyn Specimen,
    recipe: &'a Recipe,
    progress: &dyn Progress,
) -> Result<Option<Box<dyn FieldImage + 'a>>> {
    if let Some(film) = FilmImage::prepare(engine, specimen, recipe)? {
        return Ok(Some(Box::new(film)));
    }
    let mosaic = Mosaic::prepare(engine, specimen, recipe, progress)?;
    Ok(mosaic.map(|m| Box::new(m) as Box<dyn FieldImage>))
}

/// The engine, and with wider windows those that follow.
fn widening(engine: &MosaicEngine, more: bool) -> Vec<MosaicEngine> {
    let mut engines = vec![engine.clone()];
    let Algorithm::Window { width_angstrom } = engine.simulator.settings().algorithm else {
        return engines;
    };
    for width in WIDER.into_iter().filter(|w| more && *w > width_angstrom) {
        let simulator = engine.simulator.with_window(width);
        engines.push(MosaicEngine { simulator, ..engine.clone() });
    }
    engines
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
