//! Labelled samples at random places, with random rotation and magnification. Each is made on request from its number.

use ndarray::{Array2, arr2};

use super::column_labels::{REACH_SIGMAS, class_of, draw_column, facts_of};
use super::region_truth::{list, phases_of_points};
use crate::detect::{ShownImage, shown_images};
use crate::error::{Error, Result};
use crate::imaging::{Noise, check_countable};
use crate::imaging::{RegionImager, TurnedRaster, turned_image, turned_images_of_others};
use crate::lengths;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Field};
use crate::rng::{self, Purpose};
use crate::setting::Setting;
use crate::specimen::{ParticleOutline, Specimen};

/// Distance of samples from the edge of the full field in nm, which interpolation and windows need.
const EDGE_NM: f64 = 0.5;
/// Numbers of the random draws of a sample; [`training_set`](super::training_set) uses 0 to 2.
const PLACE: [u32; 2] = [8, 9];
const ANGLE: u32 = 10;
const PIXEL: u32 = 11;
const DOSE: u32 = 12;

/// The ranges that samples are drawn from. Angles are drawn evenly between two limits, pixel and dose evenly in their logarithm.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleOptions {
    /// Edge of a sample in pixels.
    pub size_px: usize,
    /// Least and greatest edge of a pixel in nm.
    pub pixel_nm: [f64; 2],
    /// Least and greatest angle in rad by which the raster is turned against the field.
    pub angle_rad: [f64; 2],
    /// Least and greatest dose in electrons per square Angstrom.
    pub dose: [f64; 2],
    /// Standard deviation in pixels of a column in the heat maps.
    pub sigma_px: f64,
    /// Seed of places, angles, pixels, doses and noise.
    pub seed: u64,
    /// Whether samples have the images of all detectors of the recipe; otherwise they have the image of the main one.
    pub all_detectors: bool,
}

/// The image of a sample on a detector beside the main one. Each detector has its own shot noise. The images of a centre of mass hold mean
/// angles in mrad along the axes of the field.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DetectorImage {
    /// Name of the detector.
    pub name: String,
    /// Counted electrons.
    pub counts: Array2<u32>,
    /// The image without noise, as fraction of the beam or as angle.
    pub clean: Array2<f32>,
    /// The mean angle of the counted electrons, for a centre of mass.
    pub counted_mrad: Option<Array2<f32>>,
}

/// A labelled image. All arrays of images are [row, column] = [y, x].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrainingSample {
    /// Pixels and rotation of the sample in the field.
    pub raster: TurnedRaster,
    /// Dose in electrons per square Angstrom.
    pub dose: f64,
    /// Electrons that fell on a pixel.
    pub electrons_per_pixel: f64,
    /// Counted electrons.
    pub counts: Array2<u32>,
    /// The image without noise, as fraction of the beam.
    pub clean: Array2<f32>,
    /// The images on the other detectors, in the order of the recipe, if the options ask for them.
    pub others: Vec<DetectorImage>,
    /// Gaussians of height 1 about columns; the nearest column counts.
    pub heat_map: Array2<f32>,
    /// Index into [`COLUMN_CLASSES`](super::COLUMN_CLASSES): the class of the nearest column where its heat map is above one half.
    pub class_mask: Array2<u8>,
    /// Phase of each pixel, as an index into the phases of the specimen.
    pub phase_mask: Array2<i32>,
    /// (x, y) in pixels of each column in the sample: (column, 2).
    pub positions_px: Array2<f32>,
    /// Class, sites, vacancies, substitutions and atomic number of the heaviest atom of each column: (column, 5).
    pub columns: Array2<i32>,
    /// Particles that reach into the sample: x, y and radius of the outline in pixels.
    pub particles_px: Vec<[f64; 3]>,
    /// Shapes of the particles.
    pub morphologies: Vec<String>,
}

impl SampleOptions {
    /// Checks all options that do not depend on a sample's number.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values out of limits, and for samples that do not fit into the field.
    pub fn check(&self, field: &Field) -> Result<()> {
        let refuse = |setting, value: String, expected: String| {
            Err(Error::invalid(setting, value, expected))
        };
        let rises = |[low, high]: [f64; 2]| low <= high && low.is_finite() && high.is_finite();
        let [low, high] = self.pixel_nm;
        if !rises(self.pixel_nm) || low < 1e-4 || high > 10.0 {
            let expected = "expected 0.0001 to 10 nm, the lower first".into();
            return refuse(Setting::RecordedPixelNm, format!("{low}, {high}"), expected);
        }
        let [low, high] = self.dose;
        if !rises(self.dose) || low < 1e-3 || high > 1e12 {
            let expected = "expected 0.001 to 1e12 electrons per square Angstrom, the lower first";
            return refuse(Setting::Dose, format!("{low}, {high}"), expected.into());
        }
        check_countable(high, lengths::square_angstrom2(self.pixel_nm[1]))?;
        if !rises(self.angle_rad) {
            let expected = "expected two angles, the lower first".into();
            return refuse(Setting::RecordedRegionNm, format!("{:?}", self.angle_rad), expected);
        }
        if !(0.3..=50.0).contains(&self.sigma_px) || !(8..=8192).contains(&self.size_px) {
            let value = format!("{} pixels, sigma {}", self.size_px, self.sigma_px);
            let expected = "samples have 8 to 8192 pixels, a column in heat maps 0.3 to 50".into();
            return refuse(Setting::TilePixels, value, expected);
        }
        let room = self.room_nm(field, self.pixel_nm[1]);
        if room.iter().any(|[low, high]| low > high) {
            let value = format!("{} pixels of {} nm", self.size_px, self.pixel_nm[1]);
            let [height, width] =
                field.pixels(field.built_grid()).map(|n| n as f64 * field.pixel_nm());
            let expected = format!(
                "does not fit into the field of {height:.2} x {width:.2} nm when it is rotated; use fewer or smaller pixels"
            );
            return refuse(Setting::TilePixels, value, expected);
        }
        Ok(())
    }

    /// Returns the range of centres (x, y) in nm of the full field for which all corners of a sample lie in the built field at any angle.
    fn room_nm(&self, field: &Field, pixel_nm: f64) -> [[f64; 2]; 2] {
        let turned = self.angle_rad != [0.0; 2];
        let half =
            0.5 * self.size_px as f64 * pixel_nm * if turned { libm::sqrt(2.0) } else { 1.0 };
        let built = field.built_region();
        [built.x, built.y].map(|[low, high]| [low + half + EDGE_NM, high - half - EDGE_NM])
    }

    /// Draws the place of sample `index` and its dose in electrons per square Angstrom.
    pub(crate) fn draw(&self, field: &Field, index: u64) -> (TurnedRaster, f64) {
        let uniform = |draw: u32| rng::uniform(self.seed, Purpose::Tile, draw, index);
        let even = |[low, high]: [f64; 2], draw: u32| low + uniform(draw) * (high - low);
        let log = |range: [f64; 2], draw: u32| match range {
            [low, high] if low == high => low,
            range => libm::exp(even(range.map(libm::log), draw)),
        };
        let pixel_nm = log(self.pixel_nm, PIXEL);
        let room = self.room_nm(field, pixel_nm);
        let raster = TurnedRaster {
            centre_nm: plane::per_axis(room, PLACE, even),
            pixel_nm,
            angle_rad: even(self.angle_rad, ANGLE),
            shape: [self.size_px; 2],
        };
        (raster, log(self.dose, DOSE))
    }
}

/// Makes sample `index`, which depends on recipe, options and index alone. The imager must be prepared.
///
/// # Errors
/// Errors of [`SampleOptions::check`] and of the engine, [`Error::Interrupted`].
pub fn training_sample(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    imager: &dyn RegionImager,
    options: &SampleOptions,
    index: u64,
    progress: &dyn Progress,
) -> Result<TrainingSample> {
    options.check(&recipe.field)?;
    let (raster, dose) = options.draw(&recipe.field, index);
    let clean = turned_image(recipe, imager, &raster, progress)?.mapv(|v| v as f32);
    let electrons_per_pixel = dose * (raster.pixel_angstrom()).powi(2);
    let size = options.size_px;
    let place_nm = raster.places_nm();
    // Each sample takes its noise from other rows of an endless field of noise.
    let origin_px = [(index as usize).wrapping_mul(size), 0];
    let noise = |detector: u16| Noise {
        seed: options.seed,
        electrons_per_pixel,
        origin_px,
        full_width_px: size,
        detector,
    };
    let others = match options.all_detectors && recipe.detector.count() > 1 {
        true => turned_images_of_others(recipe, imager, &raster, progress)?,
        false => Vec::new(),
    };
    let others: Vec<_> = others.iter().map(|image| image.mapv(|v| v.max(0.0) as f32)).collect();
    let shown = shown_images(&recipe.detector.measured()).into_iter().skip(1);
    let shown = shown.filter(|_| !others.is_empty());
    let mut sample = TrainingSample {
        raster,
        dose,
        electrons_per_pixel,
        counts: noise(0).counted(&clean),
        clean,
        others: shown.map(|s| detector_image(&s, &others, &noise(s.number as u16))).collect(),
        heat_map: Array2::zeros((size, size)),
        class_mask: Array2::zeros((size, size)),
        phase_mask: phases_of_points(specimen, [size; 2], |row, column| {
            place_nm(row as f64, column as f64)
        }),
        positions_px: Array2::zeros((0, 2)),
        columns: Array2::zeros((0, 5)),
        particles_px: Vec::new(),
        morphologies: Vec::new(),
    };
    sample.label(specimen, options.sigma_px);
    Ok(sample)
}

/// The image on a detector, from the measured images after the main one.
fn detector_image(shown: &ShownImage, measured: &[Array2<f32>], noise: &Noise) -> DetectorImage {
    let name = shown.detector.name.clone();
    let electrons = &measured[shown.number - 1];
    let counts = noise.counted(electrons);
    let (Some(parts), Some(axis)) = (shown.parts(), shown.axis) else {
        return DetectorImage { name, counts, clean: electrons.clone(), counted_mrad: None };
    };
    let [clean, deviation] = shown.angles(parts.map(|number| measured[number - 1].view()));
    let mut counted = clean.clone();
    noise.deflect(&mut counted, 0, (electrons, &deviation), axis);
    DetectorImage { name, counts, clean, counted_mrad: Some(counted) }
}

impl TrainingSample {
    /// Draws the heat map and the masks, and lists the columns and particles.
    fn label(&mut self, specimen: &dyn Specimen, sigma_px: f64) {
        let raster = self.raster;
        let region = raster.region();
        let around = region.grown(REACH_SIGMAS * sigma_px * raster.pixel_nm);
        let centre = raster.centre_nm;
        let (_, columns) = list(&specimen.query(&around), centre, 0);
        let [rows, width] = raster.shape.map(|n| n as f64 - 0.5);
        let (mut heat, mut mask) = (self.heat_map.view_mut(), self.class_mask.view_mut());
        let (mut positions, mut facts) = (Vec::new(), Vec::new());
        for column in &columns {
            let place = plane::add(centre, column.position_nm.map(f64::from));
            let at = raster.place_px(place);
            draw_column(at, class_of(column), sigma_px, &mut heat, &mut mask);
            if (-0.5..rows).contains(&at[0]) && (-0.5..width).contains(&at[1]) {
                positions.push([at[1] as f32, at[0] as f32]);
                facts.push(facts_of(column));
            }
        }
        self.positions_px = arr2(&positions);
        self.columns = arr2(&facts);
        let all = specimen.facts().particle_outlines.iter();
        for particle in all.filter(|p| p.reaches(&region)) {
            let ParticleOutline { centre_nm, diameter_nm, morphology } = particle.clone();
            let [row, column] = raster.place_px(centre_nm);
            let radius = 0.5 * diameter_nm / raster.pixel_nm;
            let beyond = |at: f64, size: f64| at < -0.5 - radius || at > size + radius;
            if !beyond(row, rows) && !beyond(column, width) {
                self.particles_px.push([column, row, radius]);
                self.morphologies.push(morphology);
            }
        }
    }
}
