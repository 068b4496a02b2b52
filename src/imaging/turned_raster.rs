//! Rasters that may be turned against the pixels of the field, and images at their places.

use ndarray::Array2;

use super::pixels::{PixelBox, PixelRect};
use super::region_imager::{DetectorChoice, RasterDetail, RegionImager};
use crate::engine::Scan;
use crate::error::{Error, Result};
use crate::lengths;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Region};
use crate::resample::{HALF_WIDTH, Kernel, TAPS};
use crate::setting::Setting;

/// Places are accurate to this distance, in nm.
const ROUNDING_NM: f64 = 1e-9;

/// A square raster of any pixel size, turned by any angle. Places are (x, y) in nm of the full field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurnedRaster {
    /// Centre of the raster.
    pub centre_nm: [f64; 2],
    /// Edge of a pixel.
    pub pixel_nm: f64,
    /// Angle in rad from the field's x axis to the raster's, from +x towards +y.
    pub angle_rad: f64,
    /// Rows and columns.
    pub shape: [usize; 2],
}

impl TurnedRaster {
    /// The place of the centre of a pixel; row and column may lie between pixels.
    pub(crate) fn place_nm(&self, row: f64, column: f64) -> [f64; 2] {
        self.places_nm()(row, column)
    }

    /// Places of pixels, as [`TurnedRaster::place_nm`] returns them, for many pixels.
    pub(crate) fn places_nm(self) -> impl Fn(f64, f64) -> [f64; 2] + Sync {
        let [middle_row, middle_column] = self.middle();
        let (sine, cosine) = (libm::sin(self.angle_rad), libm::cos(self.angle_rad));
        let ([x, y], pixel_nm) = (self.centre_nm, self.pixel_nm);
        move |row, column| {
            let (across, down) =
                ((column - middle_column) * pixel_nm, (row - middle_row) * pixel_nm);
            [x + across * cosine - down * sine, y + across * sine + down * cosine]
        }
    }

    /// Row and column, in pixels, of a place.
    pub(crate) fn place_px(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [middle_row, middle_column] = self.middle();
        let (dx, dy) = (x - self.centre_nm[0], y - self.centre_nm[1]);
        let (sine, cosine) = (libm::sin(self.angle_rad), libm::cos(self.angle_rad));
        let (across, down) = (dx * cosine + dy * sine, dy * cosine - dx * sine);
        [middle_row + down / self.pixel_nm, middle_column + across / self.pixel_nm]
    }

    /// The smallest rectangle of the field around the raster's pixels.
    pub(crate) fn region(&self) -> Region {
        let [rows, columns] = self.shape.map(|n| n as f64 - 0.5);
        let corners = [[-0.5, -0.5], [-0.5, columns], [rows, -0.5], [rows, columns]];
        let corners = corners.map(|[row, column]| self.place_nm(row, column));
        let range = |k: usize| {
            let values = corners.iter().map(|corner| corner[k]);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
        };
        Region { x: range(0), y: range(1) }
    }

    fn middle(&self) -> [f64; 2] {
        self.shape.map(|n| 0.5 * (n as f64 - 1.0))
    }

    /// Edge of a pixel in Angstrom.
    pub(crate) fn pixel_angstrom(&self) -> f64 {
        lengths::angstrom(self.pixel_nm)
    }

    /// The places of all pixels in Angstrom, row by row.
    pub(super) fn places_angstrom(&self) -> Vec<[f64; 2]> {
        let [rows, columns] = self.shape;
        let place = self.places_nm();
        let pixels = 0..rows * columns;
        pixels
            .map(|n| lengths::angstrom(place((n / columns) as f64, (n % columns) as f64)))
            .collect()
    }
}

/// The noise-free image at the places of a raster, [row, column], as fraction of the beam: the mean over the recipe's phonon
/// configurations. The imager has to be prepared.
///
/// Mosaics and direct simulations are interpolated once, from the simulated probes. Other images are interpolated from the pixels of the
/// field, which are many times finer than the image's Nyquist distance. The errors of the interpolation are in `resample.rs`.
///
/// # Errors
/// [`Error::Invalid`] for a raster that reaches out of the full field, or a field of too coarse pixels; errors of the engine, and
/// [`Error::Interrupted`].
pub fn turned_image(
    recipe: &CheckedRecipe,
    imager: &dyn RegionImager,
    raster: &TurnedRaster,
    progress: &dyn Progress,
) -> Result<Array2<f64>> {
    check_within(recipe, raster)?;
    let configurations = recipe.phonons.configurations.max(1);
    main_image(recipe, imager, raster, RasterDetail::Full, (configurations, progress))
}

/// The noise-free images on all detectors but the main one at the places of a raster, each as [`turned_image`] makes the main one.
///
/// # Errors
/// Errors of [`turned_image`].
pub(crate) fn turned_images_of_others(
    recipe: &CheckedRecipe,
    imager: &dyn RegionImager,
    raster: &TurnedRaster,
    progress: &dyn Progress,
) -> Result<Vec<Array2<f64>>> {
    check_within(recipe, raster)?;
    let configurations = recipe.phonons.configurations.max(1);
    let (detail, all) = (RasterDetail::Full, DetectorChoice::All);
    let mut images = match imager.images_at(raster, detail, all, configurations, progress)? {
        Some(images) => images,
        None => from_pixels(recipe, imager, raster, all, (configurations, progress))?,
    };
    images.remove(0);
    Ok(images)
}

/// As [`turned_image`], with [`RasterDetail::Overview`].
///
/// # Errors
/// Errors of [`turned_image`].
pub(crate) fn overview_image(
    recipe: &CheckedRecipe,
    imager: &dyn RegionImager,
    raster: &TurnedRaster,
    progress: &dyn Progress,
) -> Result<Array2<f64>> {
    check_within(recipe, raster)?;
    let configurations = recipe.phonons.configurations.max(1);
    main_image(recipe, imager, raster, RasterDetail::Overview, (configurations, progress))
}

fn main_image(
    recipe: &CheckedRecipe,
    imager: &dyn RegionImager,
    raster: &TurnedRaster,
    detail: RasterDetail,
    (configurations, progress): (usize, &dyn Progress),
) -> Result<Array2<f64>> {
    let main = DetectorChoice::Main;
    let mut images = match imager.images_at(raster, detail, main, configurations, progress)? {
        Some(images) => images,
        None => from_pixels(recipe, imager, raster, main, (configurations, progress))?,
    };
    Ok(images.swap_remove(0))
}

fn check_within(recipe: &CheckedRecipe, raster: &TurnedRaster) -> Result<()> {
    let (inside, region) = (recipe.field.full_region(), raster.region());
    // Rounding must not place a raster outside the field.
    let within = region.grown(-ROUNDING_NM);
    if within.intersection(&inside) != within || raster.shape.contains(&0) {
        let ([x0, x1], [y0, y1]) = (region.x, region.y);
        let value = format!("x {x0:.2} to {x1:.2} nm, y {y0:.2} to {y1:.2} nm");
        let ([x0, x1], [y0, y1]) = (inside.x, inside.y);
        let expected =
            format!("the full field is x {x0:.2} to {x1:.2} nm, y {y0:.2} to {y1:.2} nm");
        return Err(Error::invalid(Setting::RecordedRegionNm, value, expected));
    }
    Ok(())
}

/// Interpolates the pixels of the field; the images of the chosen detectors, at least one.
fn from_pixels(
    recipe: &CheckedRecipe,
    imager: &dyn RegionImager,
    raster: &TurnedRaster,
    detectors: DetectorChoice,
    (configurations, progress): (usize, &dyn Progress),
) -> Result<Vec<Array2<f64>>> {
    let (pixel, full) = (recipe.field.pixel_nm(), recipe.field.pixels(recipe.field.grid));
    let kernel = Kernel::new(lengths::angstrom(pixel), recipe.optics.image_band_limit())?;
    let region = raster.region();
    let range = |[low, high]: [f64; 2], n: usize| {
        let last = ((high / pixel).ceil() as usize + HALF_WIDTH + 1).max(TAPS).min(n);
        let first = ((low / pixel).floor().max(0.0) as usize).saturating_sub(HALF_WIDTH);
        [first.min(last.saturating_sub(TAPS)), last]
    };
    let (rows, columns) = (range(region.y, full[0]), range(region.x, full[1]));
    let pixels =
        PixelRect::new([rows[0], columns[0]], [rows[1] - rows[0], columns[1] - columns[0]]);
    let all = imager.images_of(&pixels, detectors, configurations, progress)?;
    let first = [columns[0], rows[0]].map(|n| 10.0 * n as f64 * pixel);
    let places = raster.places_angstrom();
    let image = |values: Array2<f64>| {
        let samples = ScannedSamples { values, first, step: lengths::angstrom(pixel) };
        Array2::from_shape_vec(raster.shape, samples.at(&places, &kernel)).unwrap_or_default()
    };
    Ok(all.into_iter().map(image).collect())
}

/// Samples of an image, [row, column], in Angstrom of the full field.
pub(super) struct ScannedSamples {
    pub(super) values: Array2<f64>,
    /// Place (x, y) of the first sample in Angstrom.
    pub(super) first: [f64; 2],
    /// Distance of the samples in Angstrom.
    pub(super) step: f64,
}

impl ScannedSamples {
    /// Interpolates values at places (x, y) in Angstrom. There are at least [`TAPS`] samples along each axis.
    pub(super) fn at(&self, places: &[[f64; 2]], kernel: &Kernel) -> Vec<f64> {
        let (rows, columns) = self.values.dim();
        let value = |place: &[f64; 2]| {
            let [x, y] = plane::sub(*place, self.first).map(|d| d / self.step);
            let (across, down) =
                (kernel.weights_within(x, columns), kernel.weights_within(y, rows));
            let (row, column) = (down.first as usize, across.first as usize);
            let line = |i: usize| {
                let samples = (0..TAPS).map(|k| self.values[[row + i, column + k]]);
                samples.zip(&across.values).map(|(s, w)| s * w).sum::<f64>()
            };
            down.values.iter().enumerate().map(|(i, w)| w * line(i)).sum()
        };
        places.iter().map(value).collect()
    }
}

/// The specimen around a scan that is simulated.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpecimenAround {
    /// Width of the specimen on each side of the scan.
    pub margin_angstrom: f64,
    /// Thickness of the specimen.
    pub thickness_nm: f64,
}

/// The values of images at places (x, y) in Angstrom of the full field, interpolated from probes that `simulate` propagates around them. The
/// scan is as fine as the image's band limit (1/Angstrom) needs.
///
/// # Errors
/// Errors of `simulate`.
pub(super) fn between_probes(
    places: &[[f64; 2]],
    band_limit: f64,
    around: SpecimenAround,
    simulate: impl FnOnce(&PixelBox) -> Result<Vec<Array2<f64>>>,
) -> Result<Vec<Vec<f64>>> {
    let SpecimenAround { margin_angstrom, thickness_nm } = around;
    let step = Kernel::default_step(band_limit);
    let kernel = Kernel::new(step, band_limit)?;
    let range = |k: usize| {
        let values = places.iter().map(|place| place[k] / step);
        let [low, high] =
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]);
        let first = low.floor() - HALF_WIDTH as f64;
        (first * step, (high.ceil() - first) as usize + HALF_WIDTH + 1)
    };
    if places.is_empty() {
        return Ok(Vec::new());
    }
    let ((x, columns), (y, rows)) = (range(0), range(1));
    let edges = |first: f64, n: usize| {
        let last = first + (n as f64 - 1.0) * step;
        lengths::nm([first - margin_angstrom, last + margin_angstrom])
    };
    let area = Region { x: edges(x, columns), y: edges(y, rows) };
    let scan = Scan {
        origin_angstrom: [margin_angstrom; 2],
        step_angstrom: [step; 2],
        shape: [rows, columns],
    };
    let images = simulate(&PixelBox::of_area(area, scan, lengths::angstrom(thickness_nm)))?;
    let at = |values| ScannedSamples { values, first: [x, y], step }.at(places, &kernel);
    Ok(images.into_iter().map(at).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_pixels_are_inverse_and_within_the_region() {
        let raster =
            TurnedRaster { centre_nm: [3.0, 5.0], pixel_nm: 0.02, angle_rad: 0.7, shape: [64, 48] };
        let middle = raster.place_nm(31.5, 23.5);
        assert!((middle[0] - 3.0).abs() < 1e-12 && (middle[1] - 5.0).abs() < 1e-12);
        let place = raster.place_nm(7.0, 40.5);
        let [row, column] = raster.place_px(place);
        assert!((row - 7.0).abs() < 1e-9 && (column - 40.5).abs() < 1e-9);
        assert!(raster.region().contains(place));
        let straight = TurnedRaster { angle_rad: 0.0, ..raster };
        let [a, b] = [straight.place_nm(0.0, 0.0), straight.place_nm(1.0, 2.0)];
        assert!((b[0] - a[0] - 0.04).abs() < 1e-12 && (b[1] - a[1] - 0.02).abs() < 1e-12);
    }
}
