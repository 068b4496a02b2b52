//! The sources of the noise-free image of a field, for recordings.

use ndarray::Array2;

use crate::acquisition::SourceImage;
use crate::error::{Error, Result};
use crate::imaging::region_imager::DetectorChoice;
use crate::imaging::{PixelRect, RegionImager};
use crate::lengths;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Recipe};
use crate::resample::{MARGIN, nyquist_step, samples_around};
use crate::setting::Setting;

/// Largest edge of a pixel of the source as a fraction of the inverse band limit. Finer pixels are interpolated with an error of about 0.01
/// % of the contrast (see [`crate::resample::Kernel`]).
const FINE_ENOUGH: f64 = 0.42;

/// Returns the number of parts along each axis into which the pixels of a recipe must be divided for its image to be recorded.
pub fn refinement(recipe: &Recipe) -> usize {
    let product = recipe.field.pixel_angstrom() * recipe.optics.image_band_limit();
    ((product / FINE_ENOUGH).ceil() as usize).max(1)
}

/// Returns the reason why a field cannot be recorded at its own pixel; `None` if it can.
pub(crate) fn too_coarse(recipe: &Recipe) -> Option<Error> {
    let pixel = recipe.field.pixel_nm();
    let needed = lengths::nm(nyquist_step(recipe.optics.image_band_limit()));
    (pixel > needed).then(|| {
        let (tile, overlap) = (2 * recipe.field.tile_px, 2 * recipe.field.overlap_px);
        let expected = format!(
            "a recording needs pixels of at most {needed:.4} nm: tile_px = {tile} and overlap_px = {overlap} halve them"
        );
        Error::invalid(Setting::RecordedPixelNm, format!("{pixel:.4}"), expected)
    })
}

/// Returns the recipe with every pixel divided into `parts` x `parts`. An imager made of it images the specimen of the original recipe at
/// that finer pixel: pixel (0, 0) stays where it was.
///
/// # Errors
/// Errors of the recipe's limits.
pub fn refined(recipe: &CheckedRecipe, parts: usize) -> Result<CheckedRecipe> {
    if parts == 1 {
        return Ok(recipe.clone());
    }
    let mut fine = recipe.recipe().clone();
    fine.field.tile_px *= parts;
    fine.field.overlap_px *= parts;
    if let Some(domains) = &mut fine.domains {
        domains.sharpness_sigma_px *= parts as f64;
    }
    fine.checked()
}

/// The noise-free image of a field, from an imager or from a file. Pixel (0, 0) of the full field lies at 0 nm.
pub trait NoiseFree {
    /// Returns the recipe whose pixels the image has.
    fn recipe(&self) -> &CheckedRecipe;

    /// Returns the first row and column that are available, and the row and column behind the last, in pixels of the full field.
    fn extent_px(&self) -> [[usize; 2]; 2];

    /// Returns images of some of these pixels, [row, column] = [y, x], as fraction of the beam: those with these numbers among the measured
    /// detectors of the recipe. Number 0 is the main detector.
    ///
    /// # Errors
    /// Errors of the engine or of the file, and [`Error::Interrupted`].
    fn pixels(
        &self,
        pixels: &PixelRect,
        measured: &[usize],
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f32>>>;

    /// Returns the least and greatest (x, y) in nm of the full field at which the image is available.
    fn inside_nm(&self) -> [[f64; 2]; 2] {
        let pixel = self.recipe().field.pixel_nm();
        let [first, end] = self.extent_px();
        [1, 0].map(|k| {
            let low = first[k] + MARGIN;
            [low as f64 * pixel, (end[k] as f64 - 1.0 - MARGIN as f64).max(0.0) * pixel]
        })
    }

    /// Returns images around all places that a beam reaches: `reach_nm` is the least and greatest x and y in nm of the full field, `measured`
    /// are numbers of detectors as for [`NoiseFree::pixels`].
    ///
    /// # Errors
    /// [`Error::Invalid`] if the beam leaves the field, or the pixels are too coarse; errors of the engine or of the file.
    fn images(
        &self,
        reach_nm: [[f64; 2]; 2],
        measured: &[usize],
        progress: &dyn Progress,
    ) -> Result<Vec<SourceImage>> {
        let inside = self.inside_nm();
        let outside = |k: usize| reach_nm[k][0] < inside[k][0] || reach_nm[k][1] > inside[k][1];
        if outside(0) || outside(1) {
            return Err(beyond(self.recipe(), reach_nm, inside));
        }
        let pixel = self.recipe().field.pixel_nm();
        let [low, end] = self.extent_px();
        // Lengths in nm are (x, y), pixels are (row, column).
        let range = |k: usize| {
            let around = samples_around(reach_nm[1 - k].map(|nm| nm / pixel), low[k]..end[k]);
            [around.start, around.len()]
        };
        let [[row, rows], [column, columns]] = [range(0), range(1)];
        let pixels = PixelRect::new([row, column], [rows, columns]);
        let origin = [column, row].map(|p| p as f64 * pixel);
        let limit = self.recipe().optics.image_band_limit();
        let image = |values| SourceImage::new(values, pixel, origin, limit);
        self.pixels(&pixels, measured, progress)?.into_iter().map(image).collect()
    }
}

/// A prepared imager as the source of recordings.
pub struct ImagerSource<'a> {
    /// The imager.
    pub imager: &'a dyn RegionImager,
    /// The recipe of the imager, which may be [`refined`].
    pub recipe: &'a CheckedRecipe,
}

impl NoiseFree for ImagerSource<'_> {
    fn recipe(&self) -> &CheckedRecipe {
        self.recipe
    }

    fn extent_px(&self) -> [[usize; 2]; 2] {
        [[0; 2], self.recipe.field.pixels(self.recipe.field.grid)]
    }

    fn pixels(
        &self,
        pixels: &PixelRect,
        measured: &[usize],
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f32>>> {
        let [stage, unit] = self.imager.facts().stage;
        progress.start(stage, unit, self.imager.work(pixels) as u64);
        let configurations = self.recipe.phonons.configurations.max(1);
        let choice = if measured == [0] { DetectorChoice::Main } else { DetectorChoice::All };
        let images = self.imager.images_of(pixels, choice, configurations, progress)?;
        progress.finish();
        Ok(measured.iter().map(|n| images[*n].mapv(|v| v as f32)).collect())
    }
}

/// The error for a beam that leaves the field.
fn beyond(recipe: &Recipe, reach: [[f64; 2]; 2], inside: [[f64; 2]; 2]) -> Error {
    let origin = recipe.field.origin_nm();
    let own = |r: [[f64; 2]; 2]| plane::per_axis(r, origin, |ends, zero| ends.map(|nm| nm - zero));
    let (reach, inside) = (own(reach), own(inside));
    let text = |r: [[f64; 2]; 2]| {
        let [[x0, x1], [y0, y1]] = r;
        format!("x {x0:.2} to {x1:.2} nm, y {y0:.2} to {y1:.2} nm")
    };
    let expected = format!(
        "the beam would leave the field, drift and margin included; the region that can be recorded is {}",
        text(inside)
    );
    Error::invalid(Setting::RecordedRegionNm, text(reach), expected)
}
