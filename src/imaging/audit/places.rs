//! The regions of an audit.

use super::options::AuditOptions;
use crate::error::{Error, Result};
use crate::imaging::pixels::PixelRect;
use crate::plane;
use crate::recipe::Recipe;
use crate::rng::{self, Purpose};
use crate::specimen::{Specimen, outlines_in};

/// A region of the field.
pub struct AuditPlace {
    /// The pixels of the region; some of them are compared.
    pub pixels: PixelRect,
    /// Centre (x, y) of the region in nm of the built field.
    pub centre_nm: [f64; 2],
}

/// Places the regions: at the given centres or at random. Where there are particles, every other random region lies on one. Every
/// `stride`-th pixel of a region is compared.
///
/// # Errors
/// [`Error::Invalid`] for regions that do not lie in the field.
pub fn places(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    options: &AuditOptions,
    stride: usize,
) -> Result<Vec<AuditPlace>> {
    let field = &recipe.field;
    let (shape, pixel) = (field.pixels(field.built_grid()), field.pixel_nm());
    let edge = (options.size_nm / pixel).round() as usize;
    if stride == 0 || edge < 8 || edge > shape[0].min(shape[1]) {
        let expected = format!("must be from {:.2} to the field's height and width", 8.0 * pixel);
        return Err(Error::invalid(crate::Setting::AuditedRegionNm, options.size_nm, expected));
    }
    let corners = match options.at_nm.is_empty() {
        true => random_corners(recipe, specimen, options, edge),
        false => given_corners(recipe, options, edge)?,
    };
    let origin = field.crop_origin_px();
    let place = |corner: [usize; 2]| AuditPlace {
        pixels: PixelRect::new(plane::add(origin, corner), [edge; 2]).every(stride),
        centre_nm: plane::swapped(corner).map(|n| (n as f64 + 0.5 * (edge - 1) as f64) * pixel),
    };
    Ok(corners.into_iter().map(place).collect())
}

/// First pixels (row, column) in the built field of random regions.
fn random_corners(
    recipe: &Recipe,
    specimen: &dyn Specimen,
    options: &AuditOptions,
    edge: usize,
) -> Vec<[usize; 2]> {
    let field = &recipe.field;
    let (shape, pixel) = (field.pixels(field.built_grid()), field.pixel_nm());
    let origin = field.crop_origin_px();
    let particles = outlines_in(specimen, &field.built_region());
    let uniform = |n: u64, k: u32| rng::uniform(options.seed, Purpose::Audit, k, n);
    let anywhere =
        |n: u64| [0, 1].map(|k| (uniform(n, k) * (shape[k as usize] - edge + 1) as f64) as usize);
    let on_particle = |n: u64| {
        let chosen = &particles[(uniform(n, 2) * particles.len() as f64) as usize];
        [0, 1].map(|k: usize| {
            let off = (uniform(n, k as u32) - 0.5) * chosen.diameter_nm;
            let centre = (chosen.centre_nm[1 - k] + off) / pixel - origin[k] as f64;
            let corner = (centre - 0.5 * edge as f64).round();
            corner.clamp(0.0, (shape[k] - edge) as f64) as usize
        })
    };
    let corner = |n: u64| match n.is_multiple_of(2) && !particles.is_empty() {
        true => on_particle(n),
        false => anywhere(n),
    };
    (0..options.regions as u64).map(corner).collect()
}

/// First pixels (row, column) in the built field of the requested regions.
fn given_corners(recipe: &Recipe, options: &AuditOptions, edge: usize) -> Result<Vec<[usize; 2]>> {
    let (shape, pixel) = (recipe.field.pixels(recipe.field.built_grid()), recipe.field.pixel_nm());
    let corner = |at: &[f64; 2]| {
        let corner = plane::swapped(*at).map(|nm| (nm / pixel - 0.5 * edge as f64).round());
        let inside = |k: usize| corner[k] >= 0.0 && corner[k] as usize + edge <= shape[k];
        if inside(0) && inside(1) {
            return Ok(corner.map(|c| c as usize));
        }
        let extent = shape.map(|n| n as f64 * pixel);
        let expected = format!(
            "the region must lie in the field of {:.2} x {:.2} nm (x, y)",
            extent[1], extent[0]
        );
        Err(Error::invalid(crate::Setting::AuditCentreNm, format!("{at:?}"), expected))
    };
    options.at_nm.iter().map(corner).collect()
}
