//! A world that changes under the beam.

use std::collections::BTreeMap;
use std::sync::Arc;

use ndarray::Array2;

use super::block_imager::BlockImager;
use super::exposed_scan::{expose, lost};
use super::live_history::{LiveAcquisition, LiveSnapshot};
use crate::acquisition::{Acquisition, Exposure, ScanPath};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::imaging::region_imager::DetectorChoice;
use crate::imaging::{GrownCarbon, MOST_GROWN_ANGSTROM, MethodChoice, PixelRect, RegionImager};
use crate::lengths;
use crate::progress::{InterruptOnly, Progress, Silent};
use crate::recipe::{CheckedRecipe, Recipe, Region};
use crate::rng::{Purpose, words};
use crate::setting::Setting;
use crate::specimen::{DamagedSpecimen, DoseMap, ParticleTruth, SiteKind, Specimen, specimen};
use crate::world::noise_free::{refined, refinement};
use crate::world::recorded_detectors::{
    RecordedDetector, check_carbon, is_main_alone, recorded_detectors, recorded_recipe,
};
use crate::world::region_truth::list;
use crate::world::{
    BuildOptions, CarbonBefore, ColumnTruth, Electrons, FieldRecording, FieldTile, ImagePlan,
    ImagerSource, RecordedField, RecordedPart, RecordingOptions, SiteTruth, grown, record_over,
    scan_of, tile_of_image,
};

/// Default largest dose of a live world, in electrons per square Angstrom.
pub(crate) const MOST_DOSE: f64 = 1e6;
/// Doses that differ by less than this share are equal.
const ROUNDING: f64 = 1e-9;
/// Largest dose of a single place, in units of the largest mean dose.
const UNEVEN: f64 = 2.0;
/// Version of snapshots. Snapshots of version 1 have no digest.
const SNAPSHOT_VERSION: u32 = 2;

/// Options of a live world.
#[derive(Debug, Clone)]
pub struct LiveOptions {
    /// Options of imaging, as for worlds on disk.
    pub imaging: BuildOptions,
    /// The largest dose of any part, in electrons per square Angstrom. It decides how many vacancies the library of a mosaic shows.
    pub most_dose: f64,
    /// Size of the image cache in bytes.
    pub image_bytes: usize,
    /// Names of the detectors of its images and recordings; `None`: all of the recipe.
    pub detectors: Option<Vec<String>>,
}

impl Default for LiveOptions {
    fn default() -> Self {
        let imaging = BuildOptions::default();
        LiveOptions { imaging, most_dose: MOST_DOSE, image_bytes: 256 << 20, detectors: None }
    }
}

/// A recording to be made: part, dose, scan and detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveRequest {
    /// The part of the field, and its pixel.
    pub part: RecordedPart,
    /// The dose.
    pub electrons: Electrons,
    /// The scan and the detector.
    pub acquisition: Acquisition,
    /// Keep the frames separately; otherwise they are summed.
    pub keep_frames: bool,
}

/// The truth of a region. Places are (x, y) in nm from the centre of the first built pixel of the field.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LiveTruth {
    /// Sites of the columns in the region.
    pub sites: Vec<SiteTruth>,
    /// Columns whose position lies in the region.
    pub columns: Vec<ColumnTruth>,
    /// Particles whose centre lies in the region.
    pub particles: Vec<ParticleTruth>,
}

/// A world in memory. Recordings change its specimen by the table `[damage]` of the recipe. The same recipe, seed and recordings give the
/// same bytes, for any number of threads.
///
/// A recording shows the specimen as it was when the recording began. Its electrons change the specimen when it has ended. The dose of a
/// column is the dose of the pixels above it: tails of the probe are left out.
pub struct LiveWorld {
    recipe: CheckedRecipe,
    fine: CheckedRecipe,
    /// Pixels of `fine` in one of `recipe`, along each axis.
    parts: usize,
    specimen: Arc<DamagedSpecimen>,
    imager: BlockImager,
    most_dose: f64,
    /// The detectors of its images and recordings.
    detectors: Vec<RecordedDetector>,
    /// Thickness of the carbon in Angstrom at all exposed places.
    carbon: DoseMap,
    /// The film of carbon, made when carbon grows for the first time.
    carbon_film: Option<GrownCarbon>,
    history: Vec<LiveAcquisition>,
}

/// A world whose library is not yet filled.
struct Unprepared {
    recipe: CheckedRecipe,
    fine: CheckedRecipe,
    parts: usize,
    damaged: Arc<DamagedSpecimen>,
    imager: Box<dyn RegionImager>,
    detectors: Vec<RecordedDetector>,
}

impl Unprepared {
    fn new(recipe: &CheckedRecipe, seed: u64, options: &LiveOptions) -> Result<Self> {
        let detectors = recorded_detectors(recipe, options.detectors.as_deref())?;
        let recipe = recorded_recipe(Recipe { seed, ..recipe.recipe().clone() }, &detectors)?;
        if !(1e-3..=1e12).contains(&options.most_dose) {
            let expected = "expected 0.001 to 1e12 electrons per square Angstrom";
            return Err(Error::invalid(Setting::MostDose, options.most_dose, expected));
        }
        let parts = refinement(&recipe);
        let fine = refined(&recipe, parts)?;
        let whole = specimen(&recipe)?;
        let damaged = Arc::new(DamagedSpecimen::new(whole, &recipe, options.most_dose));
        let seen: Arc<dyn Specimen> = Arc::clone(&damaged) as Arc<dyn Specimen>;
        let mut imaging = options.imaging.policy(&fine)?.imaging;
        if imaging.method == MethodChoice::Auto {
            // A library pays off, since it serves the changing specimen many times.
            imaging.method = MethodChoice::Mosaic;
        }
        let imager = imaging.imager(&fine, &seen)?;
        Ok(Unprepared { recipe, fine, parts, damaged, imager, detectors })
    }
}

impl LiveWorld {
    /// The cost of filling the library, and of the image of a part. Nothing is simulated.
    ///
    /// # Errors
    /// Errors of [`LiveWorld::new`] and of the plan.
    pub fn plan(
        recipe: &CheckedRecipe,
        seed: u64,
        options: &LiveOptions,
        part: &RecordedPart,
    ) -> Result<ImagePlan> {
        let made = Unprepared::new(recipe, seed, options)?;
        ImagePlan::new(&*made.imager, part.pixels_of(made.fine.field.pixel_nm()), 1)
    }

    /// Lays out the specimen of a recipe with this seed, and fills the library of its mosaic: from the cache, or by
    /// simulations, which take minutes.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a largest dose out of limits; errors of the specimen and the engine; [`Error::Interrupted`].
    pub fn new(
        recipe: &CheckedRecipe,
        seed: u64,
        options: &LiveOptions,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let Unprepared { recipe, fine, parts, damaged, mut imager, detectors } =
            Unprepared::new(recipe, seed, options)?;
        imager.prepare(progress)?;
        let imager = BlockImager::new(imager, &fine, &damaged, options.image_bytes)?;
        let most_dose = options.most_dose;
        Ok(LiveWorld {
            recipe,
            fine,
            parts,
            specimen: damaged,
            imager,
            most_dose,
            detectors,
            carbon: DoseMap::default(),
            carbon_film: None,
            history: vec![],
        })
    }

    /// The recipe, with the seed.
    pub fn recipe(&self) -> &CheckedRecipe {
        &self.recipe
    }

    /// The current specimen.
    pub fn specimen(&self) -> &DamagedSpecimen {
        &self.specimen
    }

    /// The imager of the current specimen without the carbon on it, at pixels of [`LiveWorld::imaged_recipe`]; for audits.
    pub fn imager(&self) -> &dyn RegionImager {
        &self.imager
    }

    /// The recipe with pixels fine enough for recordings.
    pub fn imaged_recipe(&self) -> &CheckedRecipe {
        &self.fine
    }

    /// All recordings so far.
    pub fn history(&self) -> &[LiveAcquisition] {
        &self.history
    }

    /// Number of cached blocks of the image.
    pub fn kept_blocks(&self) -> usize {
        self.imager.block_count()
    }

    /// The noise-free images of some pixels of the field on all detectors, and their truth, without exposure.
    ///
    /// # Errors
    /// Errors of [`crate::world::field_tile`].
    pub fn look(&self, pixels: &PixelRect) -> Result<FieldTile> {
        let finer = |p: [usize; 2]| p.map(|n| n.saturating_mul(self.parts));
        let full = self.recipe.field.pixels(self.recipe.field.grid);
        let inside = (0..2).all(|k| {
            let end = pixels.first[k].checked_add(pixels.shape[k]);
            pixels.shape[k] > 0 && end.is_some_and(|end| end <= full[k])
        });
        if !inside {
            // `tile_of_image` refuses these pixels.
            let none = Array2::zeros([0, 0]);
            return tile_of_image(&self.recipe, &*self.specimen, pixels, none, None);
        }
        let fine = PixelRect::new(finer(pixels.first), finer(pixels.shape));
        let all = self.recipe.phonons.configurations.max(1);
        let choice = match is_main_alone(&self.detectors) {
            true => DetectorChoice::Main,
            false => DetectorChoice::All,
        };
        let images = self.imager.images_of(&fine.every(self.parts), choice, all, &Silent)?;
        let images: Vec<_> = images.iter().map(|image| image.mapv(|v| v as f32)).collect();
        let shown = self.detectors.iter().map(|one| one.shown.image_of(&images));
        let mut shown = shown.collect::<Vec<_>>().into_iter();
        let clean = self.with_carbon(pixels, shown.next().unwrap_or_default())?;
        let tile = tile_of_image(&self.recipe, &*self.specimen, pixels, clean, None)?;
        let others = self.detectors.iter().skip(1).map(|one| one.shown.detector.clone());
        Ok(FieldTile { others: others.zip(shown).collect(), ..tile })
    }

    /// The detectors of the images and recordings of this world, in their order.
    pub fn detectors(&self) -> impl Iterator<Item = &Detector> {
        self.detectors.iter().map(|one| &one.shown.detector)
    }

    /// Adds the grown carbon to an image of some pixels.
    fn with_carbon(&self, pixels: &PixelRect, mut image: Array2<f32>) -> Result<Array2<f32>> {
        let Some(film) = &self.carbon_film else { return Ok(image) };
        let pixel = self.recipe.field.pixel_nm();
        let mut patch = film.patch(&pixels.region(pixel));
        patch.grow(&self.carbon)?;
        let carbon = patch.image();
        for ((row, column), value) in image.indexed_iter_mut() {
            let at = [pixels.first[1] + column, pixels.first[0] + row];
            *value += carbon.at(at.map(|p| p as f64 * pixel)).max(0.0) as f32;
        }
        Ok(image)
    }

    /// Makes the film that the carbon grows from, if there is carbon or electrons add some.
    fn make_carbon_film(&mut self, per_electron: f64) -> Result<()> {
        if self.carbon_film.is_none() && (per_electron > 0.0 || self.carbon.greatest() > 0.0) {
            check_carbon(&self.detectors, &self.recipe)?;
            self.carbon_film =
                Some(GrownCarbon::on(&self.recipe, self.specimen.layout().facts().thickness_nm)?);
        }
        Ok(())
    }

    /// Whether carbon has grown anywhere.
    pub(super) fn has_carbon(&self) -> bool {
        self.carbon.greatest() > 0.0
    }

    /// Mean thickness in nm of the carbon that has grown on a region (nm from the centre of the first built pixel).
    pub fn mean_carbon_nm(&self, region: &Region) -> f64 {
        lengths::nm(self.carbon.mean(&self.in_full_field(region)))
    }

    /// The current truth of a region (nm from the centre of the first built pixel of the field).
    pub fn truth(&self, region: &Region) -> LiveTruth {
        let [x, y] = self.recipe.field.origin_nm();
        let region = region.moved([x, y]);
        let (sites, columns) = list(&self.specimen.query(&region), [x, y], 0);
        let particle = |p: ParticleTruth| {
            let [u, v, z] = p.centre_nm;
            ParticleTruth { centre_nm: [u - x, v - y, z], ..p }
        };
        let mut particles = self.specimen.layout().particles_reaching(&region);
        particles.retain(|p| region.contains(p.outline().centre_nm));
        LiveTruth { sites, columns, particles: particles.into_iter().map(particle).collect() }
    }

    /// The mean dose of a region (nm from the centre of the first built pixel), in electrons per square Angstrom. Electrons are counted in
    /// cells of 0.05 nm, so the outermost cells of an exposed area reach beyond it.
    pub fn mean_dose(&self, region: &Region) -> f64 {
        self.specimen.dose().mean(&self.in_full_field(region))
    }

    /// The mean dose of a region that was exposed as a whole, without its outermost cells.
    pub(super) fn mean_dose_within(&self, region: &Region) -> f64 {
        self.specimen.dose().mean_within(&self.in_full_field(region))
    }

    fn in_full_field(&self, region: &Region) -> Region {
        region.moved(self.recipe.field.origin_nm())
    }

    /// Records a part of the field on all detectors. Afterwards the specimen has the damage of the electrons, which are the same for all
    /// detectors.
    ///
    /// # Errors
    /// Errors of [`record`](crate::world::record); [`Error::Invalid`] for a dose above the world's largest. After an error the world is
    /// unchanged.
    pub fn acquire(
        &mut self,
        request: &LiveRequest,
        progress: &dyn Progress,
    ) -> Result<FieldRecording> {
        let options = RecordingOptions {
            acquisition: request.acquisition,
            electrons: request.electrons,
            seed: self.recording_seed(),
            keep_frames: request.keep_frames,
            keep_stages: false,
        };
        let (path, exposure) = scan_of(&self.recipe, &request.part, &options)?;
        let mut spent = DoseMap::default();
        let area = expose(&mut spent, &path, &exposure);
        self.check_dose(&request.part, exposure.dose(), &spent)?;
        let rate = request.acquisition.contamination_angstrom3_per_electron;
        self.make_carbon_film(rate)?;
        let source = ImagerSource { imager: &self.imager, recipe: &self.fine };
        let film = self.carbon_film.as_ref();
        let field = RecordedField {
            recipe: &self.recipe,
            specimen: &*self.specimen,
            source: &source,
            detectors: &self.detectors,
            carbon: film.map(|film| CarbonBefore { film, angstrom: &self.carbon }),
        };
        let recording = record_over(&field, &request.part, &options, &InterruptOnly(progress))?;
        self.carbon.add_all(&grown(&path, &exposure, rate));
        let carbon_nm = recording.carbon_nm.first().copied().unwrap_or(0.0);
        self.change((&request.part, carbon_nm), (&path, &exposure), (&spent, area));
        Ok(recording)
    }

    /// Refuses a scan whose dose is above the world's largest.
    pub(super) fn check_scan(
        &self,
        part: &RecordedPart,
        path: &ScanPath,
        exposure: &Exposure,
    ) -> Result<()> {
        let mut spent = DoseMap::default();
        expose(&mut spent, path, exposure);
        self.check_dose(part, exposure.dose(), &spent)
    }

    /// Changes the specimen by the electrons of a scan that no image was made of.
    pub(super) fn change_by_scan(
        &mut self,
        part: &RecordedPart,
        path: &ScanPath,
        exposure: &Exposure,
    ) {
        let mut spent = DoseMap::default();
        let area = expose(&mut spent, path, exposure);
        self.change((part, 0.0), (path, exposure), (&spent, area));
    }

    /// Changes the specimen by the electrons of a scan, which fell into an area, and adds the scan to the history.
    fn change(
        &mut self,
        (part, carbon_nm): (&RecordedPart, f64),
        (path, exposure): (&ScanPath, &Exposure),
        (spent, area): (&DoseMap, Region),
    ) {
        let before = self.atoms(&area);
        self.specimen.expose(|dose| dose.add_all(spent));
        self.imager.changed(area);
        let lost = lost(&before, &self.atoms(&area));
        let begun_s = self.history.last().map_or(0.0, |last| last.begun_s + last.duration_s);
        self.history.push(LiveAcquisition {
            number: self.history.len(),
            begun_s,
            duration_s: path.duration_s(),
            centre_nm: part.centre_nm,
            size_nm: part.size_nm,
            shape: path.frame().shape,
            dose: exposure.dose(),
            current_pa: exposure.current_pa(),
            electrons: spent.electrons(),
            carbon_nm,
            lost,
        });
    }

    /// Seed of the next recording.
    pub(super) fn recording_seed(&self) -> u64 {
        let [low, high, ..] =
            words(self.recipe.seed, Purpose::LiveRecording, 0, self.history.len() as u64);
        u64::from(high) << 32 | u64::from(low)
    }

    /// Jitter and drift distribute a dose unevenly, so single places may have more than the mean. Columns with a dose above the library's
    /// are simulated at their place.
    fn check_dose(&self, part: &RecordedPart, dose: f64, spent: &DoseMap) -> Result<()> {
        if self.specimen.is_lasting() {
            return Ok(());
        }
        let mean = self.mean_dose(&Region::centred(part.centre_nm, part.size_nm)) + dose;
        let greatest = self.specimen.dose().greatest_with(spent);
        if mean <= self.most_dose * (1.0 + ROUNDING) && greatest <= UNEVEN * self.most_dose {
            return Ok(());
        }
        let expected = format!(
            "the world was made for up to {} electrons per square Angstrom at any place, earlier recordings included; make the world for a \
             higher dose",
            self.most_dose
        );
        let value = if greatest > UNEVEN * self.most_dose { greatest } else { mean };
        Err(Error::invalid(Setting::Dose, format!("{value:.4}"), expected))
    }

    /// Number of atoms in a region (nm of the full field), by element; empty for a specimen that no dose changes.
    fn atoms(&self, area: &Region) -> BTreeMap<u8, u64> {
        let mut atoms = BTreeMap::new();
        if self.specimen.is_lasting() {
            return atoms;
        }
        // The dose of a unit is the dose at its centre.
        for site in self.specimen.query(&area.grown(0.3)).sites {
            if site.kind != SiteKind::Vacancy {
                *atoms.entry(site.number).or_default() += 1;
            }
        }
        atoms
    }

    /// Whether a recipe is this world's except for its detectors, which doses do not depend on.
    fn differs_in_detectors(&self, recipe: &str) -> bool {
        let Ok(other) = Recipe::from_toml_str("snapshot", recipe, None) else { return false };
        Recipe { detector: self.recipe.detector.clone(), ..other } == *self.recipe.recipe()
    }

    /// The current state of the world.
    pub fn snapshot(&self) -> LiveSnapshot {
        LiveSnapshot {
            version: SNAPSHOT_VERSION,
            recipe: self.recipe.to_toml(),
            most_dose: self.most_dose,
            dose: self.specimen.dose().clone(),
            carbon_angstrom: self.carbon.clone(),
            history: self.history.clone(),
            digest: String::new(),
        }
        .sealed()
    }

    /// Returns to an earlier (or later) state of a world of the same recipe and seed.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a snapshot of another world, or a damaged one.
    pub fn restore(&mut self, snapshot: &LiveSnapshot) -> Result<()> {
        let refuse = |value: &str, expected: &str| {
            Err(Error::invalid(Setting::Snapshot, value.to_owned(), expected))
        };
        if !(1..=SNAPSHOT_VERSION).contains(&snapshot.version) {
            let value = format!("version {}", snapshot.version);
            return refuse(&value, "this program reads snapshots of version 1 and 2");
        }
        if snapshot.recipe != self.recipe.to_toml() && !self.differs_in_detectors(&snapshot.recipe)
        {
            return refuse("another recipe or seed", "expected a snapshot of this world");
        }
        if let Some(fault) = snapshot.fault() {
            return refuse("the text", &format!("{fault}; take another snapshot, or record again"));
        }
        let most = UNEVEN * self.most_dose * (1.0 + ROUNDING);
        if !snapshot.dose.is_sound() || snapshot.dose.greatest() > most {
            return refuse("its doses", "expected doses from 0 to the greatest dose of the world");
        }
        let carbon = &snapshot.carbon_angstrom;
        if !carbon.is_sound() || carbon.greatest() > MOST_GROWN_ANGSTROM * (1.0 + ROUNDING) {
            return refuse("its carbon", "expected thicknesses from 0 to 60 Angstrom");
        }
        let before = std::mem::replace(&mut self.carbon, carbon.clone());
        if let Err(fault) = self.make_carbon_film(0.0) {
            self.carbon = before;
            return Err(fault);
        }
        self.specimen.expose(|dose| dose.clone_from(&snapshot.dose));
        self.imager.changed(Region { x: [-1e9, 1e9], y: [-1e9, 1e9] });
        self.history.clone_from(&snapshot.history);
        Ok(())
    }
}
