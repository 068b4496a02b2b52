//! A tile with its truth, simulated on request: what a world file would hold of a rectangle of the field.

use ndarray::Array2;

use super::region_truth::{ColumnTruth, SiteTruth, boundary_parts, list, phase_map};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::imaging::{Noise, check_countable};
use crate::imaging::{PixelRect, RegionImager};
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Recipe};
use crate::specimen::{BoundaryKind, ParticleTruth, Specimen};

/// A rectangle of a field: its image and its ground truth. Positions are in nm from the centre of the first built pixel, as in world files.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FieldTile {
    /// The pixels.
    pub pixels: PixelRect,
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Position (x, y) in nm of the centre of the tile's first pixel.
    pub origin_nm: [f64; 2],
    /// The noise-free image, [row, column] = [y, x], in fractions of the beam.
    pub clean: Array2<f32>,
    /// Images on other detectors than the first, in live worlds; a centre of mass is in mrad.
    pub others: Vec<(Detector, Array2<f32>)>,
    /// Counted electrons, [row, column], if a dose was given.
    pub counts: Option<Array2<u32>>,
    /// Lattice sites of the columns in the tile.
    pub sites: Vec<SiteTruth>,
    /// Columns whose position lies in the tile.
    pub columns: Vec<ColumnTruth>,
    /// Phase of each pixel, [row, column], as an index into `phase_names`; `None` for a specimen of one phase.
    pub phase_map: Option<Array2<i32>>,
    /// Names of the phases.
    pub phase_names: Vec<String>,
    /// Parts of boundaries in the tile: corners (x, y), and the kind of the boundary.
    pub boundaries: Vec<(Vec<[f64; 2]>, BoundaryKind)>,
    /// Particles that reach into the tile.
    pub particles: Vec<ParticleTruth>,
}

impl FieldTile {
    /// Converts a position (x, y) in nm to (row, column) in pixels of the tile.
    pub fn place_px(&self, position_nm: [f64; 2]) -> [f64; 2] {
        plane::swapped(plane::sub(position_nm, self.origin_nm)).map(|d| d / self.pixel_nm)
    }
}

/// Makes a tile of the field of a recipe from all its phonon configurations. The imager must be prepared. `dose` in electrons per square
/// Angstrom adds counts, which equal the counts of a world of this recipe and dose pixel by pixel.
///
/// # Errors
/// [`Error::Invalid`] for an empty rectangle, a rectangle that skips pixels or reaches beyond the full field, or a dose out of limits;
/// errors of the engine, and [`Error::Interrupted`].
pub fn field_tile(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    imager: &dyn RegionImager,
    pixels: &PixelRect,
    dose: Option<f64>,
    progress: &dyn Progress,
) -> Result<FieldTile> {
    check(recipe, pixels, dose)?;
    let configurations = recipe.phonons.configurations.max(1);
    let clean = imager.mean_of(pixels, configurations, progress)?.mapv(|v| v as f32);
    tile_of_image(recipe, specimen, pixels, clean, dose)
}

/// Makes a tile from its noise-free image `clean`.
///
/// # Errors
/// [`Error::Invalid`] as for [`field_tile`].
pub(crate) fn tile_of_image(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    pixels: &PixelRect,
    clean: Array2<f32>,
    dose: Option<f64>,
) -> Result<FieldTile> {
    check(recipe, pixels, dose)?;
    let field = &recipe.field;
    let (pixel, built) = (field.pixel_nm(), field.origin_nm());
    let region = pixels.region(pixel);
    let counts = dose.map(|dose| Noise::new(recipe, dose, pixels.first).counted(&clean));
    let (sites, columns) = list(&specimen.query(&region), built, 0);
    let phase_names = specimen.facts().phases.clone();
    let relative = |[x, y]: [f64; 2]| [x - built[0], y - built[1]];
    let boundaries = specimen.boundaries().into_iter().flat_map(|boundary| {
        let parts = boundary_parts(&boundary, &region).into_iter();
        let kind = boundary.kind;
        parts.map(move |line| (line.into_iter().map(relative).collect(), kind.clone()))
    });
    let particle = |p: ParticleTruth| {
        let [x, y, z] = p.centre_nm;
        ParticleTruth { centre_nm: [x - built[0], y - built[1], z], ..p }
    };
    Ok(FieldTile {
        pixels: *pixels,
        pixel_nm: pixel,
        origin_nm: plane::sub(plane::swapped(pixels.first).map(|n| n as f64 * pixel), built),
        clean,
        others: Vec::new(),
        counts,
        sites,
        columns,
        phase_map: (phase_names.len() > 1).then(|| phase_map(specimen, pixels, pixel)),
        phase_names,
        boundaries: boundaries.collect(),
        particles: specimen.particles_reaching(&region).into_iter().map(particle).collect(),
    })
}

fn check(recipe: &Recipe, pixels: &PixelRect, dose: Option<f64>) -> Result<()> {
    let full = recipe.field.pixels(recipe.field.grid);
    let PixelRect { first, shape, stride } = *pixels;
    let inside = (0..2)
        .all(|k| shape[k] > 0 && first[k].checked_add(shape[k]).is_some_and(|end| end <= full[k]));
    if !inside || stride != 1 {
        let value = format!("{} x {} from {}, {}", shape[0], shape[1], first[0], first[1]);
        let expected = format!(
            "expected all pixels of a rectangle in the full field of {} x {}",
            full[0], full[1]
        );
        return Err(Error::invalid(crate::Setting::TilePixels, value, expected));
    }
    match dose.filter(|dose| !(1e-3..=1e12).contains(dose)) {
        Some(dose) => {
            let expected = "expected 0.001 to 1e12 electrons per square Angstrom";
            Err(Error::invalid(crate::Setting::Dose, dose, expected))
        }
        None => {
            let pixel = recipe.field.pixel_angstrom();
            dose.map_or(Ok(()), |dose| check_countable(dose, pixel * pixel))
        }
    }
}
