//! A recording of a place in a world or a recipe: the request, and the job that makes it.

use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::made_world::{WorldEngine, imaging_of};
use super::noise_free::{refined, refinement};
use super::recorded_detectors::{
    RecordedDetector, check_carbon, recorded_detectors, recorded_recipe,
};
use super::{
    Electrons, FieldRecording, ImagePlan, ImagerSource, NoiseFree, RecordedField, RecordedPart,
    RecordingOptions, WorldSource,
};
use crate::acquisition::{AcquisitionTable, Profile};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::imaging::Cache;
use crate::io::WorldFile;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Recipe};
use crate::setting::Setting;
use crate::specimen::{Specimen, specimen};

/// The part and the settings of a recording; values of the microscope that are not given come from the recipe of the field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingRequest {
    /// Left, upper, right and lower edge of the part in nm.
    pub region_nm: Option<[f64; 4]>,
    /// Middle of the part in nm; the part then has as many pixels as a tile. `None` without a region records the middle of the field.
    pub at_nm: Option<[f64; 2]>,
    /// How many times finer the recorded pixels are than the pixels of the world.
    pub zoom: Option<f64>,
    /// Edge of a pixel in nm, in place of the zoom.
    pub pixel_nm: Option<f64>,
    /// Set of values for the microscope.
    pub profile: Option<Profile>,
    /// Electrons per square Angstrom, all frames together; `None`: the dose of the recipe.
    pub electrons_per_angstrom2: Option<f64>,
    /// Current of the beam in pA, in place of the dose.
    pub current_pa: Option<f64>,
    /// Time on each pixel in microseconds.
    pub dwell_us: Option<f64>,
    /// Number of frames.
    pub frames: Option<usize>,
    /// Keep each frame, in place of their sum.
    pub keep_frames: bool,
    /// Keep the stages between the noise-free image and the recording.
    pub keep_stages: bool,
    /// Seed of electrons, noise, jitter and random drift.
    pub seed: u64,
    /// Names of the detectors that record; `None`: all of the recipe.
    pub detectors: Option<Vec<String>>,
}

impl Default for RecordingRequest {
    fn default() -> Self {
        RecordingRequest {
            region_nm: None,
            at_nm: None,
            zoom: None,
            pixel_nm: None,
            profile: None,
            electrons_per_angstrom2: None,
            current_pa: None,
            dwell_us: None,
            frames: None,
            keep_frames: false,
            keep_stages: false,
            seed: 1,
            detectors: None,
        }
    }
}

impl RecordingRequest {
    /// Returns the part of the field of a recipe that is recorded.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an empty region, and for two values that set the same quantity.
    pub fn part(&self, recipe: &CheckedRecipe) -> Result<RecordedPart> {
        let own = recipe.field.pixel_nm();
        let refuse =
            |setting, value: String, expected: &str| Err(Error::invalid(setting, value, expected));
        let pixel_nm = match (self.zoom, self.pixel_nm) {
            (Some(zoom), Some(_)) => {
                let expected = "zoom and pixel both set it; give one";
                return refuse(Setting::RecordedPixelNm, format!("zoom {zoom}"), expected);
            }
            (Some(zoom), None) if zoom > 0.0 && zoom.is_finite() => own / zoom,
            (Some(zoom), None) => {
                return refuse(
                    Setting::RecordedPixelNm,
                    format!("zoom {zoom}"),
                    "expected above 0",
                );
            }
            (None, pixel_nm) => pixel_nm.unwrap_or(own),
        };
        let Some([x0, y0, x1, y1]) = self.region_nm else {
            return Ok(RecordedPart::tile_at(recipe, self.at_nm, pixel_nm));
        };
        let value = || format!("{x0}, {y0}, {x1}, {y1}");
        if self.at_nm.is_some() {
            let expected = "a region and a middle both set the place; give one";
            return refuse(Setting::RecordedRegionNm, value(), expected);
        }
        if !(x1 > x0 && y1 > y0) {
            let expected = "is empty; expected left, upper, right and lower edge in nm";
            return refuse(Setting::RecordedRegionNm, value(), expected);
        }
        let centre_nm = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
        Ok(RecordedPart { centre_nm, size_nm: [x1 - x0, y1 - y0], pixel_nm })
    }

    /// Returns the detectors that record, the first one first.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown name.
    pub fn detectors_of(&self, recipe: &CheckedRecipe) -> Result<Vec<Detector>> {
        let found = recorded_detectors(recipe, self.detectors.as_deref())?;
        Ok(found.into_iter().map(|one| one.shown.detector).collect())
    }

    /// Returns the table `[acquisition]` of a recipe, with the values of the request.
    pub fn table(&self, recipe: &CheckedRecipe) -> AcquisitionTable {
        let mut table = recipe.acquisition.unwrap_or_default();
        table.profile = self.profile.or(table.profile);
        table.dwell_us = self.dwell_us.or(table.dwell_us);
        table.frames = self.frames.or(table.frames);
        table
    }

    /// Returns the dose or the current of the request, or else the dose of the recipe.
    ///
    /// # Errors
    /// [`Error::Invalid`] if both are given.
    pub fn electrons(&self, recipe: &CheckedRecipe) -> Result<Electrons> {
        if let (Some(_), Some(current)) = (self.electrons_per_angstrom2, self.current_pa) {
            let expected = "dose and current both set the electrons; give one";
            return Err(Error::invalid(Setting::BeamCurrentPa, current, expected));
        }
        let dose = self.electrons_per_angstrom2.unwrap_or(recipe.dose.electrons_per_angstrom2);
        Ok(self.current_pa.map_or(Electrons::Dose(dose), Electrons::CurrentPa))
    }

    /// Returns the settings of the recording.
    ///
    /// # Errors
    /// Errors of [`RecordingRequest::electrons`].
    pub(crate) fn options(&self, recipe: &CheckedRecipe) -> Result<RecordingOptions> {
        Ok(RecordingOptions {
            acquisition: self.table(recipe).resolved(),
            electrons: self.electrons(recipe)?,
            seed: self.seed,
            keep_frames: self.keep_frames,
            keep_stages: self.keep_stages,
        })
    }
}

/// The origin of the noise-free image of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordedFrom {
    /// The world holds it.
    World,
    /// It is simulated from the recipe.
    Recipe,
}

/// A recording that is ready to be made.
pub struct RecordingJob {
    recipe: CheckedRecipe,
    made: Option<WorldEngine>,
    world: Option<PathBuf>,
    specimen: Arc<dyn Specimen>,
    part: RecordedPart,
    options: RecordingOptions,
    detectors: Vec<RecordedDetector>,
}

impl RecordingJob {
    /// Prepares a recording of a recipe's field; `world` is a file with that field, and `made` describes how it was made.
    ///
    /// # Errors
    /// Errors of recipe, request and specimen.
    pub fn new(
        recipe: &CheckedRecipe,
        (world, made): (Option<PathBuf>, Option<WorldEngine>),
        request: &RecordingRequest,
    ) -> Result<Self> {
        let table = request.table(recipe);
        let detectors = recorded_detectors(recipe, request.detectors.as_deref())?;
        let changed = Recipe { acquisition: Some(table), ..recipe.recipe().clone() };
        let recipe = match &world {
            Some(_) => changed.checked()?,
            None => recorded_recipe(changed, &detectors)?,
        };
        let (part, options) = (request.part(&recipe)?, request.options(&recipe)?);
        if options.acquisition.contamination_angstrom3_per_electron > 0.0 {
            check_carbon(&detectors, &recipe)?;
        }
        let specimen = specimen(&recipe)?;
        Ok(RecordingJob { specimen, recipe, made, world, part, options, detectors })
    }

    /// Returns the recipe with the values of the request.
    pub fn recipe(&self) -> &CheckedRecipe {
        &self.recipe
    }

    /// The specimen that is recorded.
    pub fn specimen(&self) -> &dyn Specimen {
        &*self.specimen
    }

    /// Plans the noise-free image of the part; `None` where the world holds it.
    ///
    /// # Errors
    /// Errors of the file and of the plan.
    pub fn plan(&self, cache: Cache) -> Result<Option<ImagePlan>> {
        let RecordingJob { recipe, specimen, part, .. } = self;
        let parts = refinement(recipe);
        if parts == 1 && self.world_with_images()?.is_some() {
            return Ok(None);
        }
        let fine = refined(recipe, parts)?;
        let imager = imaging_of(&fine, self.made.as_ref(), cache)?.imager(&fine, specimen)?;
        Ok(Some(ImagePlan::new(&*imager, part.pixels_of(fine.field.pixel_nm()), 1)?))
    }

    /// The part that is recorded.
    pub fn part(&self) -> &RecordedPart {
        &self.part
    }

    /// Makes the recording, from the noise-free image in the world or from an image that is simulated now.
    ///
    /// # Errors
    /// Errors of the file, of the imaging and of the recording.
    pub fn run(
        &self,
        cache: Cache,
        progress: &dyn Progress,
    ) -> Result<(FieldRecording, RecordedFrom)> {
        let RecordingJob { recipe, specimen, part, options, detectors, .. } = self;
        let recorded = |source: &dyn NoiseFree| {
            let specimen = self.specimen();
            let field = RecordedField { recipe, specimen, source, detectors, carbon: None };
            field.record_clean(part, options, progress)
        };
        let parts = refinement(recipe);
        if parts == 1
            && let Some(world) = self.world_with_images()?
        {
            let source = WorldSource { world: &world, recipe };
            return Ok((recorded(&source)?, RecordedFrom::World));
        }
        let fine = refined(recipe, parts)?;
        let mut imager = imaging_of(&fine, self.made.as_ref(), cache)?.imager(&fine, specimen)?;
        imager.prepare(progress)?;
        let source = ImagerSource { imager: &*imager, recipe: &fine };
        Ok((recorded(&source)?, RecordedFrom::Recipe))
    }

    /// Opens the world if it holds the noise-free images of all detectors. No world holds those that a centre of mass is made of.
    fn world_with_images(&self) -> Result<Option<WorldFile>> {
        let Some(path) = &self.world else { return Ok(None) };
        let world = WorldFile::open(path)?;
        let mut all = world.has_clean();
        for one in self.detectors.iter().filter(|one| one.shown.number > 0) {
            let name = &one.shown.detector.name;
            all = all && one.shown.axis.is_none() && world.on_detector(name)?.has_clean();
        }
        Ok(all.then_some(world))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_set_twice_or_empty_is_refused() {
        let recipe = Recipe::load("test", None).unwrap().checked().unwrap();
        let none = RecordingRequest::default;
        let refused = [
            (
                RecordingRequest { zoom: Some(2.0), pixel_nm: Some(0.01), ..none() },
                Setting::RecordedPixelNm,
            ),
            (RecordingRequest { zoom: Some(f64::NAN), ..none() }, Setting::RecordedPixelNm),
            (
                RecordingRequest { region_nm: Some([1.0, 1.0, 1.0, 2.0]), ..none() },
                Setting::RecordedRegionNm,
            ),
            (
                RecordingRequest {
                    region_nm: Some([0.0, 0.0, 1.0, 1.0]),
                    at_nm: Some([1.0; 2]),
                    ..none()
                },
                Setting::RecordedRegionNm,
            ),
            (
                RecordingRequest {
                    electrons_per_angstrom2: Some(1e3),
                    current_pa: Some(1.0),
                    ..none()
                },
                Setting::BeamCurrentPa,
            ),
        ];
        for (request, expected) in refused {
            match RecordingJob::new(&recipe, (None, None), &request).map(drop).unwrap_err() {
                Error::Invalid { setting, .. } => assert_eq!(setting, expected, "{request:?}"),
                other => panic!("{other}"),
            }
        }
    }

    #[test]
    fn values_of_the_recipe_stand_where_none_are_given() {
        let recipe = Recipe::load("test", None).unwrap().checked().unwrap();
        let request = RecordingRequest { frames: Some(3), ..RecordingRequest::default() };
        let options = request.options(&recipe).unwrap();
        assert_eq!(options.electrons, Electrons::Dose(recipe.dose.electrons_per_angstrom2));
        assert_eq!(options.acquisition.frames, 3);
        let zoomed = RecordingRequest { zoom: Some(4.0), ..RecordingRequest::default() };
        let part = zoomed.part(&recipe).unwrap();
        assert!((part.pixel_nm - 0.25 * recipe.field.pixel_nm()).abs() < 1e-15);
    }
}
