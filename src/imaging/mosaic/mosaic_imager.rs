//! The imager of a mosaic: library, assembly, and direct simulation of columns that do not repeat.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ndarray::Array2;

use super::assembly::{Assembly, NO_RAMPS, RAMPS};
use super::image_library::{ImageLibrary, RecomputedImage};
use super::library_cache::Cache;
use super::missing_blocks::{BLOCK_ANGSTROM, BLOCK_PX, blocks};
use super::mosaic_cost::MosaicCost;
use super::shared_cells::SharedCells;
use super::survey::{FieldSurvey, survey};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::imaging::direct::rectangle_plan;
use crate::imaging::displaced_atoms::{DisplacedAtoms, FrozenPhonons, displaced_atoms};
use crate::imaging::imaging_cost::{ImagingCost, SimulationRuns};
use crate::imaging::pixels::{PixelBox, PixelRect};
use crate::imaging::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
use crate::imaging::simulator::Simulator;
use crate::imaging::turned_raster::{SpecimenAround, TurnedRaster, between_probes};
use crate::lengths;
use crate::progress::{InterruptOnly, Progress, Silent};
use crate::recipe::{CheckedRecipe, Region};
use crate::resample::{Kernel, image_band_limit};
use crate::specimen::atom_columns::AtomColumn;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::units::patterns::UnitSeed;
use crate::specimen::units::unit_tag::TurnedFamily;

/// A mosaic is used where the missing images of its library need fewer probes than this share of the field's.
const WORTH: f64 = 0.8;
/// Time of a column that is simulated at its place beyond its time in a simulation of the whole field, in units of the latter: blocks of
/// single columns overlap.
const APART: f64 = 3.0;
/// Edge in Angstrom of the surroundings of a column that only direct simulation can show.
const UNIQUE_ANGSTROM: f64 = 3.0;

/// A field's library, and the images assembled from it.
pub struct MosaicImager {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    simulator: Simulator,
    cache: Cache,
    library: Arc<ImageLibrary>,
    kernel: Kernel,
    survey: FieldSurvey,
    /// Number of the library's images that were simulated instead of read; `None` before the library is filled.
    simulated: Option<usize>,
    growing: Option<GrowingLibrary>,
}

/// A library that adds library cells when an image first needs them.
struct GrowingLibrary {
    shared: Arc<SharedCells>,
    so_far: Mutex<Arc<ImageLibrary>>,
}

impl MosaicImager {
    /// Surveys the field and lays out the library. [`SharedLibrary::prepare`] fills it from the cache, and by simulations with `simulator`.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn new(
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        simulator: Simulator,
        cache: Cache,
    ) -> Result<Self> {
        simulator.check_margin()?;
        let survey = survey(&**specimen, &recipe.field);
        let settings = simulator.settings();
        let library = ImageLibrary::new(&**specimen, survey.families.iter().copied(), settings)?;
        let band_limit = image_band_limit(&settings.optics);
        let kernel = Kernel::new(Kernel::default_step(band_limit), band_limit)?;
        let (recipe, specimen) = (recipe.clone(), Arc::clone(specimen));
        let (library, simulated, growing) = (Arc::new(library), None, None);
        Ok(MosaicImager {
            recipe,
            specimen,
            simulator,
            cache,
            library,
            kernel,
            survey,
            simulated,
            growing,
        })
    }

    /// Skips the survey: library cells are taken from `shared`, the cache or a simulation when an image first needs them. Images are equal
    /// to the images of [`MosaicImager::new`].
    ///
    /// # Errors
    /// Invalid settings.
    pub(crate) fn growing(
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        simulator: Simulator,
        cache: Cache,
        shared: &Arc<SharedCells>,
    ) -> Result<Self> {
        simulator.check_margin()?;
        let settings = simulator.settings();
        let library = Arc::new(ImageLibrary::empty(settings));
        let band_limit = image_band_limit(&settings.optics);
        let kernel = Kernel::new(Kernel::default_step(band_limit), band_limit)?;
        let growing =
            GrowingLibrary { shared: Arc::clone(shared), so_far: Mutex::new(Arc::clone(&library)) };
        Ok(MosaicImager {
            recipe: recipe.clone(),
            specimen: Arc::clone(specimen),
            simulator,
            cache,
            library,
            kernel,
            survey: FieldSurvey::default(),
            simulated: Some(0),
            growing: Some(growing),
        })
    }

    /// The library, with the library cells of these families. Simulates missing images without reporting progress.
    fn library_with(
        &self,
        families: BTreeSet<TurnedFamily>,
        progress: &dyn Progress,
    ) -> Result<Arc<ImageLibrary>> {
        self.library_of(families, &InterruptOnly(progress))
    }

    fn library_of(
        &self,
        families: BTreeSet<TurnedFamily>,
        progress: &dyn Progress,
    ) -> Result<Arc<ImageLibrary>> {
        let Some(growing) = &self.growing else { return Ok(Arc::clone(&self.library)) };
        let so_far = || growing.so_far.lock().unwrap_or_else(PoisonError::into_inner);
        let known = Arc::clone(&so_far());
        let unknown = known.unknown(families);
        if unknown.is_empty() {
            return Ok(known);
        }
        let sigma = self.sigma();
        let images = (self.recipe.id.as_str(), &sigma as &dyn Fn(u8) -> f64, &self.cache);
        let mut more = ImageLibrary::clone(&known);
        more.add((&*self.specimen, &unknown), &growing.shared, images, progress)?;
        let mut so_far = so_far();
        // Cells that other threads have added meanwhile stay.
        more.merge(&so_far);
        *so_far = Arc::new(more);
        Ok(Arc::clone(&so_far))
    }

    /// The columns and families that the survey of the field found.
    pub fn survey(&self) -> &FieldSurvey {
        &self.survey
    }

    /// Whether the images that the supplied library lacks need clearly fewer probes than the field.
    pub(crate) fn pays(&self) -> bool {
        let field = &self.recipe.field;
        let [rows, columns] = field.pixels(field.built_grid());
        let (tagged, untagged) = (self.survey.tagged, self.survey.untagged);
        let all = (tagged + untagged).max(1) as f64;
        // Beside a specimen, most pixels show no column.
        let most = self.specimen.facts().shown_within_angstrom.map_or(f64::INFINITY, |reach| {
            std::f64::consts::PI * (reach / field.pixel_angstrom()).powi(2)
        });
        let of_column =
            ((rows * columns) as f64 / all).min(most) * self.library.configurations() as f64;
        let apart = if most.is_finite() { APART * of_column * untagged as f64 } else { 0.0 };
        let needed = self.probes_not_supplied() as f64 + apart;
        tagged > 0 && needed < WORTH * of_column * tagged as f64
    }

    /// Whether all images of the library are supplied.
    fn is_supplied(&self) -> bool {
        self.survey.tagged > 0 && self.probes_not_supplied() == 0
    }

    /// As [`MosaicCost::is_known`].
    pub(crate) fn is_known(&self) -> bool {
        self.is_supplied() && self.recipe.surface.is_none()
    }

    fn probes_not_supplied(&self) -> usize {
        self.library.probes_not_supplied(&self.recipe.id, &self.sigma())
    }

    /// The cost of filling the library.
    pub fn mosaic_cost(&self) -> MosaicCost {
        let missing = self.library.missing(&self.recipe.id, &self.sigma(), &self.cache);
        MosaicCost {
            pays: self.pays(),
            supplied: self.is_supplied(),
            images: self.library.image_count(),
            missing: missing.len(),
            new: self.library.new_images(&self.recipe.id, &self.sigma(), &self.cache),
            missing_probes: missing.iter().map(|m| m.probes).sum(),
            missing_bytes: missing.iter().map(|m| m.bytes).sum(),
            columns: self.survey.tagged,
            unique_columns: self.survey.untagged,
            image_bytes: self.library.image_bytes(),
        }
    }

    /// Simulates the images of one of several processes that the cache lacks, and writes them to the cache. Returns their number.
    ///
    /// # Errors
    /// Errors of the engine and of the cache, [`Error::Interrupted`].
    pub fn fill_part(&self, shard: Shard, progress: &dyn Progress) -> Result<usize> {
        self.library.fill_part(shard, &self.recipe.id, &self.sigma(), &self.cache, progress)
    }

    /// The names in a cache of all images of the library.
    pub fn image_keys(&self) -> Vec<String> {
        self.library.keys(&self.sigma())
    }

    /// Simulates up to `count` images of the cache again, drawn with `seed`, and compares them.
    ///
    /// # Errors
    /// Errors of the engine, [`Error::Interrupted`].
    pub fn recomputed(
        &self,
        count: usize,
        seed: u64,
        progress: &dyn Progress,
    ) -> Result<Vec<RecomputedImage>> {
        let draw = (count, seed);
        self.library.recomputed(draw, &self.recipe.id, &self.sigma(), &self.cache, progress)
    }

    /// Standard deviation of an element's displacements in Angstrom.
    fn sigma(&self) -> impl Fn(u8) -> f64 + use<'_> {
        |number| self.recipe.phonons.sigma_angstrom(number)
    }

    /// Simulates the pixels of a rectangle with the atoms of the mosaic.
    fn direct(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f32>>> {
        let (margin, thickness) =
            (self.simulator.margin_angstrom(), self.specimen.facts().thickness_nm);
        let pixels = PixelBox::new(pixels, self.recipe.field.pixel_nm(), margin, thickness);
        let atoms = |configuration| self.atoms(&pixels.area, configuration);
        let quiet = InterruptOnly(progress);
        let means = self.simulator.means(&pixels, configurations, atoms, &quiet)?;
        Ok(means.into_iter().map(|mean| mean.mapv(|v| v as f32)).collect())
    }

    /// Simulates probes around places (x, y) in Angstrom with the atoms of the mosaic, and interpolates.
    fn direct_at(
        &self,
        places: &[[f64; 2]],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f64>>> {
        let around = SpecimenAround {
            margin_angstrom: self.simulator.margin_angstrom(),
            thickness_nm: self.specimen.facts().thickness_nm,
        };
        let band_limit = image_band_limit(&self.simulator.settings().optics);
        between_probes(places, band_limit, around, |pixels| {
            let atoms = |configuration| self.atoms(&pixels.area, configuration);
            let quiet = InterruptOnly(progress);
            self.simulator.means(pixels, configurations, atoms, &quiet)
        })
    }

    /// The assembly of the image at the places of a raster, with ramps of this width between units.
    fn assembly_at(&self, raster: &TurnedRaster, ramps: f64) -> Assembly {
        let (places, region) = (raster.places_angstrom(), raster.region());
        let how = (self.way(), ramps);
        Assembly::of_places(&*self.specimen, &region, raster.shape, places, how)
    }

    /// Completes images at the places of a raster, of the first detectors, with direct simulations of the units that the library lacks.
    fn with_missing(
        &self,
        mut images: Vec<Array2<f64>>,
        (assembly, library): (&Assembly, &ImageLibrary),
        raster: &TurnedRaster,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let edge = (lengths::nm(BLOCK_ANGSTROM) / raster.pixel_nm).ceil() as usize;
        let missing = assembly.missing(library);
        for (_, members) in blocks(&missing, [0, 0], raster.shape, edge.clamp(1, BLOCK_PX)) {
            let place = |(pixel, _): &(usize, f64)| assembly.places()[*pixel];
            let there: Vec<[f64; 2]> = members.iter().map(place).collect();
            let all = self.direct_at(&there, configurations, progress)?;
            let columns = raster.shape[1];
            for (image, values) in images.iter_mut().zip(all) {
                for ((pixel, weight), value) in members.iter().zip(values) {
                    image[[pixel / columns, pixel % columns]] += weight * value;
                }
            }
        }
        Ok(images)
    }

    /// Displacement (x, y) of a tilted beam at half thickness, in Angstrom.
    fn way(&self) -> [f64; 2] {
        let half = 5.0 * self.specimen.facts().thickness_nm;
        self.simulator.settings().optics.slope().map(|s| s * half)
    }

    fn check_prepared(&self, progress: &dyn Progress) -> Result<()> {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        if self.simulated.is_none() {
            let expected = "the imager has to be prepared before it makes images";
            return Err(Error::invalid(crate::Setting::Library, "empty", expected));
        }
        Ok(())
    }

    fn count(&self, detectors: DetectorChoice) -> usize {
        match detectors {
            DetectorChoice::Main => 1,
            DetectorChoice::All => self.simulator.detectors(),
        }
    }

    /// The images on the first `detectors` detectors.
    fn images(
        &self,
        detectors: usize,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        self.check_prepared(progress)?;
        let PixelRect { first, shape, .. } = *pixels;
        let pixel = self.recipe.field.pixel_nm();
        let assembly = Assembly::new(&*self.specimen, first, shape, pixel, self.way());
        let library = self.library_with(assembly.families(), progress)?;
        let (kernel, seed) = (&self.kernel, self.recipe.seed);
        let image = |n: usize| assembly.image((&library, n), kernel, seed, configurations);
        let mut images: Vec<Array2<f64>> = (0..detectors).map(image).collect();
        let missing = assembly.missing(&library);
        let blocks = blocks(&missing, first, shape, BLOCK_PX);
        let area = |block: &PixelRect| (block.shape[0] * block.shape[1]) as u64;
        progress.start("assembling", "pixel", blocks.iter().map(|(block, _)| area(block)).sum());
        for (block, members) in blocks {
            let direct = self.direct(&block, configurations, progress)?;
            progress.advance(area(&block));
            for (pixel, weight) in members {
                let [row, column] = [pixel / shape[1], pixel % shape[1]];
                let at = [first[0] + row - block.first[0], first[1] + column - block.first[1]];
                for (image, direct) in images.iter_mut().zip(&direct) {
                    image[[row, column]] += weight * f64::from(direct[at]);
                }
            }
        }
        Ok(images.into_iter().map(|image| pixels.sampled(image)).collect())
    }

    /// The image for [`RasterDetail::Overview`].
    fn overview_at(
        &self,
        raster: &TurnedRaster,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        self.check_prepared(progress)?;
        let assembly = self.assembly_at(raster, NO_RAMPS);
        let library = self.library_with(assembly.families(), progress)?;
        let assembly = assembly.with_stand_ins(&*self.specimen, &library);
        let image = assembly.overview(&library, &self.kernel);
        // If no column can stand in for others, all are missing.
        let made = (&assembly, &*library);
        self.with_missing(vec![image], made, raster, configurations, progress)
    }

    fn rectangle(&self, edge: usize, runs: usize) -> Result<SimulationRuns> {
        let shape = [edge; 2];
        Ok(rectangle_plan(&self.recipe, &*self.specimen, &self.simulator, shape, runs)?.0)
    }
}

impl SharedLibrary for MosaicImager {
    fn keep_in(&mut self, folder: &Path) {
        self.cache = self.cache.clone().with_fallback(folder.to_owned());
    }

    fn prepare(&mut self, progress: &dyn Progress) -> Result<()> {
        if self.growing.is_some() {
            let found = survey(&*self.specimen, &self.recipe.field).families;
            return self.library_of(found, progress).map(drop);
        }
        if self.simulated.is_some() {
            return Ok(());
        }
        let recipe = self.recipe.clone();
        let sigma = |number| recipe.phonons.sigma_angstrom(number);
        if let Some(library) = Arc::get_mut(&mut self.library) {
            self.simulated = Some(library.fill(&recipe.id, &sigma, &self.cache, progress)?);
        }
        Ok(())
    }

    fn prepare_part(&mut self, shard: Shard, progress: &dyn Progress) -> Result<usize> {
        self.fill_part(shard, progress)?;
        Ok(self.library.missing(&self.recipe.id, &self.sigma(), &self.cache).len())
    }
}

impl RegionImager for MosaicImager {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts {
            detectors: self.simulator.detectors(),
            window_angstrom: self.simulator.window_angstrom(),
            side_by_side: true,
            library: self.simulated.map(|simulated| [self.library.image_count(), simulated]),
            ..ImagerFacts::new("mosaic", self.simulator.parameters())
        }
    }

    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        Some(self)
    }

    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        None
    }

    fn images_of(
        &self,
        pixels: &PixelRect,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        self.images(self.count(detectors), pixels, configurations, progress)
    }

    fn images_at(
        &self,
        raster: &TurnedRaster,
        detail: RasterDetail,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>> {
        if detail == RasterDetail::Overview {
            return self.overview_at(raster, configurations, progress).map(Some);
        }
        self.check_prepared(progress)?;
        let assembly = self.assembly_at(raster, RAMPS);
        let library = self.library_with(assembly.families(), progress)?;
        let seed = self.recipe.seed;
        let image = |n| assembly.image((&library, n), &self.kernel, seed, configurations);
        let images = (0..self.count(detectors)).map(image).collect();
        let made = (&assembly, &*library);
        self.with_missing(images, made, raster, configurations, progress).map(Some)
    }

    /// Displaces the atoms. Atoms of units with a place in the library move as in the simulations of their images; other atoms move by the
    /// recipe's seed, as in all engines.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        let library = match &self.growing {
            None => Arc::clone(&self.library),
            // Displacements come from the library, even where no image has needed its cells yet.
            Some(_) => {
                let columns = self.specimen.columns(area);
                let tags = columns.iter().filter_map(|column| column.unit.as_ref());
                let families = tags.map(TurnedFamily::of).collect();
                self.library_with(families, &Silent).unwrap_or_else(|_| Arc::clone(&self.library))
            }
        };
        let seed = self.recipe.seed;
        let of_column = |column: &AtomColumn| {
            let tag = column.unit?;
            let cell = library.cell_images(TurnedFamily::of(&tag))?;
            let unit = UnitSeed { seed, id: tag.id };
            let of_unit = cell.realisations(tag.entry, unit, library.configurations());
            let realisation = of_unit[configuration];
            Some(move |n: usize| {
                let [a, b, c] = cell.displacement(realisation, tag.member, n);
                let [u, v] = tag.frame;
                [u[0] * a + u[1] * b, v[0] * a + v[1] * b, c]
            })
        };
        let which = FrozenPhonons { seed, configuration };
        displaced_atoms(&*self.specimen, area, which, &self.recipe.phonons, of_column)
    }

    /// The cost of the images that the library lacks, and of the columns like no other, each in a block of its own.
    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        let (direct, probe_step_angstrom) =
            rectangle_plan(&self.recipe, &*self.specimen, &self.simulator, subtile, subtiles)?;
        let mosaic = self.mosaic_cost();
        let main = match self.library.largest_plan()? {
            Some(planned) => {
                let probes = mosaic.missing_probes.div_ceil(mosaic.missing.max(1));
                SimulationRuns::new(planned, mosaic.missing).for_probes(probes)
            }
            None => direct,
        };
        let (mut more, mut largest_block) = (None, None);
        if mosaic.unique_columns > 0 {
            let pixel = self.recipe.field.pixel_angstrom();
            let edge = (UNIQUE_ANGSTROM / pixel).ceil() as usize;
            more = Some(self.rectangle(edge, mosaic.unique_columns as usize)?);
            largest_block = Some(self.rectangle(BLOCK_PX, 0)?);
        }
        Ok(ImagingCost {
            main,
            more,
            largest_block,
            probe_step_angstrom,
            image_bytes: mosaic.image_bytes,
            mosaic: Some(mosaic),
            particle_probes: None,
        })
    }
}
