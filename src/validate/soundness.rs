//! Checks whether the contents of a world file agree with each other.
//!
//! The checks compare tiles with each other and with the overview, attributes with the recipe, the lists of the ground truth with each
//! other and with the field, and the noise with the noise-free image and the dose.

use std::path::Path;

use ndarray::{Array2, s};
use serde::Serialize;

use super::truth_soundness::{check_boundaries, check_columns, check_sites};
use crate::error::{Error, Result};
use crate::io::{WorldFile, WorldMetadata};
use crate::lengths;
use crate::progress::Progress;
use crate::recipe::OVERVIEW_FACTOR;
use crate::recipe::Recipe;

/// Largest difference of pixels of the overview from the mean of the pixels that they represent.
const OVERVIEW_ERROR: f64 = 1e-5;
/// Largest difference of counts from whole numbers, unless single precision is coarser.
const COUNT_ERROR: f64 = 0.02;
/// Counts agree with the noise-free image if their mean and their scatter differ by less than this many standard errors.
const STANDARD_ERRORS: f64 = 6.0;
/// Largest relative difference between numbers of a recipe and its attributes.
const SAME: f64 = 1e-9;
/// Pixels with fewer expected electrons are not used for the scatter.
const FEWEST_ELECTRONS: f64 = 0.5;

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckOutcome {
    /// The check found no fault.
    Sound,
    /// The check found a fault.
    Fault,
    /// The file lacks data that the check needs.
    Skipped,
}

/// One check of a world.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct WorldCheck {
    /// Subject of the check.
    pub what: &'static str,
    /// Result of the check.
    pub outcome: CheckOutcome,
    /// Description of the result.
    pub found: String,
}

/// Checks a world file; a file that cannot be opened as a world has that as its only fault.
///
/// # Errors
/// [`Error::Io`] for a missing file, [`Error::Interrupted`].
pub fn check_world(path: &Path, progress: &dyn Progress) -> Result<Vec<WorldCheck>> {
    let opened = match WorldFile::open(path) {
        Ok(world) => world,
        Err(error @ Error::Io { .. }) => return Err(error),
        Err(error) => return Ok(vec![checked("schema", Err(error))?]),
    };
    let m = opened.metadata();
    let schema =
        format!("{} x {} tiles of {} pixels", m.grid_shape[0], m.grid_shape[1], m.tile_size_px);
    let tiles = m.grid_shape[0] * m.grid_shape[1];
    progress.start("checking", "tile", tiles as u64);
    let types = opened.check_types().map(|n| Ok(format!("{schema}; {n} datasets of its types")));
    let mut checks = vec![checked("schema", types)?];
    checks.push(checked("tiles", check_tiles(&opened, progress))?);
    progress.finish();
    checks.push(checked("overview", check_overview(&opened, progress))?);
    checks.push(checked("attributes", check_attributes(&opened))?);
    checks.push(checked("sites", check_sites(&opened))?);
    checks.push(checked("columns", check_columns(&opened))?);
    checks.push(checked("boundaries", check_boundaries(&opened))?);
    checks.push(checked("counts", check_counts(&opened, progress))?);
    Ok(checks)
}

/// Result of a check: a sentence, or a fault.
pub(super) type FoundOrFault = std::result::Result<String, String>;

/// Prefix that marks the result of a skipped check; the reason follows.
pub(super) const SKIPPED: &str = "not checked: ";

fn checked(what: &'static str, found: Result<FoundOrFault>) -> Result<WorldCheck> {
    let (outcome, found) = match found {
        Ok(Ok(found)) if found.starts_with(SKIPPED) => {
            (CheckOutcome::Skipped, found[SKIPPED.len()..].to_owned())
        }
        Ok(Ok(found)) => (CheckOutcome::Sound, found),
        Ok(Err(fault)) => (CheckOutcome::Fault, fault),
        Err(Error::Interrupted) => return Err(Error::Interrupted),
        Err(error) => (CheckOutcome::Fault, error.to_string()),
    };
    Ok(WorldCheck { what, outcome, found })
}

/// Checks that values lie between 0 and 1 (fractions of the beam in the noise-free image), and that neighbouring tiles agree in the pixels
/// that they share.
fn check_tiles(world: &WorldFile, progress: &dyn Progress) -> Result<FoundOrFault> {
    let WorldMetadata { grid_shape: [rows, columns], overlap_px, tile_size_px, .. } =
        *world.metadata();
    let rest = tile_size_px - overlap_px;
    let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
    for clean in [false, true].into_iter().filter(|clean| !clean || world.has_clean()) {
        let group = if clean { "clean" } else { "tiles" };
        let mut above: Vec<Array2<f32>> = Vec::new();
        for row in 0..rows {
            let mut strips = Vec::with_capacity(columns);
            let mut left: Option<Array2<f32>> = None;
            for column in 0..columns {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                let tile = match clean {
                    true => world.clean_tile(row, column)?,
                    false => world.tile(row, column)?,
                };
                world.check_finite(&tile, [row * rest, column * rest], clean)?;
                let low = tile.iter().fold(f32::INFINITY, |a, b| a.min(*b));
                let high = tile.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
                if low < 0.0 || high > 1.0 {
                    return Ok(Err(format!(
                        "/{group}/{row}_{column} has values from {low} to {high}, expected 0 to 1"
                    )));
                }
                if !clean {
                    (least, most) = (least.min(low), most.max(high));
                    progress.advance(1);
                }
                let same = |other: Option<&Array2<f32>>, part: Array2<f32>| {
                    other.is_none_or(|o| *o == part)
                };
                if !same(left.as_ref(), tile.slice(s![.., ..overlap_px]).to_owned())
                    || !same(above.get(column), tile.slice(s![..overlap_px, ..]).to_owned())
                {
                    return Ok(Err(format!(
                        "/{group}/{row}_{column} differs from a neighbour in the {overlap_px} pixels that they share"
                    )));
                }
                left = Some(tile.slice(s![.., rest..]).to_owned());
                strips.push(tile.slice(s![rest.., ..]).to_owned());
            }
            above = strips;
        }
    }
    let clean = if world.has_clean() { ", the noise-free ones too" } else { "" };
    Ok(Ok(format!("values from {least} to {most}; shared pixels are equal{clean}")))
}

/// Checks that each pixel of the overview is the mean of the pixels that it represents.
fn check_overview(world: &WorldFile, progress: &dyn Progress) -> Result<FoundOrFault> {
    let overview = world.overview()?;
    let [height, width] = world.shape();
    let mut worst = 0.0_f64;
    for (row, line) in overview.outer_iter().enumerate() {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let first = row * OVERVIEW_FACTOR;
        let band = world.stitched(first..(first + OVERVIEW_FACTOR).min(height), 0..width)?;
        for (column, value) in line.iter().enumerate() {
            let first = column * OVERVIEW_FACTOR;
            let part = band.slice(s![.., first..(first + OVERVIEW_FACTOR).min(width)]);
            let mean = part.iter().map(|v| f64::from(*v)).sum::<f64>() / part.len() as f64;
            let off = (mean - f64::from(*value)).abs();
            // A maximum would ignore NaN.
            worst = if off.is_nan() { f64::INFINITY } else { worst.max(off) };
        }
    }
    Ok(match worst <= OVERVIEW_ERROR {
        true => Ok(format!("the mean of the image to within {worst:.1e}")),
        false => Err(format!("differs by up to {worst:.2e} from the mean of the image")),
    })
}

/// Checks that the attributes agree with the recipe.
fn check_attributes(world: &WorldFile) -> Result<FoundOrFault> {
    let m = world.metadata();
    let Some(text) = &m.recipe else {
        return Ok(Ok(format!("{SKIPPED}the file holds no recipe")));
    };
    let Ok(recipe) = Recipe::from_toml_str("world", text, None) else {
        return Ok(Ok(format!("{SKIPPED}this version of stemgen cannot read its recipe")));
    };
    let field = &recipe.field;
    let dose = recipe.dose.electrons_per_angstrom2;
    let near = |a: f64, b: f64| (a - b).abs() <= SAME * b.abs();
    let rules = [
        ("material", m.material.as_ref() == Some(&recipe.id)),
        ("seed", m.seed == Some(recipe.seed)),
        (
            "dose_electrons_per_angstrom2",
            m.dose_electrons_per_angstrom2.is_some_and(|d| near(d, dose)),
        ),
        ("source", m.source == recipe.source),
        ("grid_shape", m.grid_shape == field.built_grid()),
        ("tile_size_px", m.tile_size_px == field.tile_px),
        ("overlap_px", m.overlap_px == field.overlap_px),
        ("pixel_size_nm", near(m.pixel_size_nm, field.pixel_nm())),
        (
            "origin_px_in_full_field",
            world.origin_px() == Some(field.crop_origin_px().map(|n| n as f64)),
        ),
        ("factor of /overview", world.overview_factor() == Some(OVERVIEW_FACTOR as u64)),
    ];
    Ok(match rules.iter().find(|(_, same)| !same) {
        Some((name, _)) => Err(format!("`{name}` is missing, or differs from the recipe")),
        None => Ok("as in the recipe".to_owned()),
    })
}

/// Checks that tiles hold whole numbers of electrons, whose mean and scatter fit the noise-free image at the dose.
fn check_counts(world: &WorldFile, progress: &dyn Progress) -> Result<FoundOrFault> {
    let m = world.metadata();
    let recipe = m.recipe.as_ref().and_then(|toml| Recipe::from_toml_str("world", toml, None).ok());
    let skipped = |why: &str| Ok(Ok(format!("{SKIPPED}{why}")));
    if recipe.is_some_and(|recipe| recipe.acquisition.is_some()) {
        return skipped("a recording holds what a detector makes of electrons");
    }
    let (Some([scale, offset]), Some(dose), Some(true)) =
        (m.scaling, m.dose_electrons_per_angstrom2, m.noise)
    else {
        return skipped("the file does not state that it holds counted electrons, or their dose");
    };
    let electrons = dose * lengths::square_angstrom2(m.pixel_size_nm);
    let mut noise = NoiseStatistics::default();
    for row in 0..m.grid_shape[0] {
        for column in 0..m.grid_shape[1] {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let tile = world.tile(row, column)?;
            let counts = tile.mapv(|v| (f64::from(v) * scale + offset) * electrons);
            // A value is accurate to half a step of single precision at the largest value.
            let error = COUNT_ERROR.max(2.0 * f64::from(f32::EPSILON) * scale * electrons);
            if let Some((at, n)) =
                counts.indexed_iter().find(|(_, n)| (*n - n.round()).abs() > error)
            {
                return Ok(Err(format!(
                    "/tiles/{row}_{column} holds {n:.3} electrons at pixel {at:?}"
                )));
            }
            if world.has_clean() {
                let clean = world.clean_tile(row, column)?;
                noise.add(&counts, &clean.mapv(|v| f64::from(v) * electrons));
            }
        }
    }
    if !world.has_clean() {
        return Ok(Ok("whole numbers of electrons".into()));
    }
    let [mean, scatter] = noise.standard_errors();
    let message = format!(
        "mean and scatter differ by {mean:+.1} and {scatter:+.1} standard errors from the noise-free image"
    );
    Ok(match mean.abs().max(scatter.abs()) <= STANDARD_ERRORS {
        true => Ok(format!("whole numbers of electrons; {message}")),
        false => Err(message),
    })
}

/// Sums over pixels of counts n, whose expectation and variance are e.
#[derive(Default)]
struct NoiseStatistics {
    /// Sums of n - e, and of e.
    difference: [f64; 2],
    /// Sums of (n - e)^2 / e - 1, and of its variance 2 + 1 / e.
    scatter: [f64; 2],
}

impl NoiseStatistics {
    fn add(&mut self, counts: &Array2<f64>, expected: &Array2<f64>) {
        for (n, e) in counts.iter().zip(expected) {
            let d = n.round() - e;
            self.difference[0] += d;
            self.difference[1] += e;
            if *e >= FEWEST_ELECTRONS {
                self.scatter[0] += d * d / e - 1.0;
                self.scatter[1] += 2.0 + 1.0 / e;
            }
        }
    }

    /// Returns the distances of the sums from 0 in standard errors.
    fn standard_errors(&self) -> [f64; 2] {
        [self.difference, self.scatter]
            .map(|[sum, variance]| if variance > 0.0 { sum / variance.sqrt() } else { 0.0 })
    }
}
