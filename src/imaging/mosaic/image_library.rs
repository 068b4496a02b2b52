//! The library: an image of each library cell in each phonon configuration. Finds the missing images and their cost.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use ndarray::Array2;

use crate::detect::Detector;
use crate::engine::{Algorithm, Images, Plan, PlannedScan, Settings, Simulation};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::imaging::mosaic::cell_images::CellImages;
use crate::imaging::mosaic::image_note::{ImageNote, NewImages};
use crate::imaging::mosaic::library_cache::Cache;
use crate::imaging::mosaic::shared_cells::SharedCells;
use crate::imaging::mosaic::supplied_images::is_supplied;
use crate::imaging::simulator::POTENTIAL_REACH_ANGSTROM;
use crate::progress::{Progress, ProgressShare};
use crate::rng::{Purpose, words};
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::TurnedFamily;

/// An image that has to be simulated.
pub(crate) struct MissingImage {
    /// Number of probes.
    pub probes: usize,
    /// Bytes of the image's file.
    pub bytes: u64,
}

/// All library cells that a world needs.
#[derive(Clone)]
pub(crate) struct ImageLibrary {
    cells: BTreeMap<TurnedFamily, Arc<CellImages>>,
    settings: Settings,
    /// Whether optics and detectors are round. Then an image does not change when its cell is turned, and turned library cells share it.
    round: bool,
    configurations: usize,
    detectors: usize,
}

impl ImageLibrary {
    /// The library cells of some families of a specimen, still without images.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a family that the specimen lacks.
    pub(crate) fn new(
        specimen: &dyn Specimen,
        families: impl Iterator<Item = TurnedFamily>,
        settings: &Settings,
    ) -> Result<Self> {
        let mut library = Self::empty(settings);
        let families: BTreeSet<TurnedFamily> = families.map(|f| library.shared(f)).collect();
        for turned in families {
            let cell = library.cell(specimen, turned)?;
            library.cells.insert(turned, Arc::new(cell));
        }
        Ok(library)
    }

    /// A library without library cells.
    pub(crate) fn empty(settings: &Settings) -> Self {
        ImageLibrary {
            cells: BTreeMap::new(),
            settings: Settings { phonons: None, ..settings.clone() },
            round: settings.optics.is_round() && settings.detectors.iter().all(Detector::is_round),
            configurations: settings.configurations() as usize,
            detectors: settings.detectors.len(),
        }
    }

    /// The family whose library cells serve a turned family: without the turn if optics and detectors are round.
    fn shared(&self, turned: TurnedFamily) -> TurnedFamily {
        if self.round { turned.straight() } else { turned }
    }

    /// The library cells of a family, still without images.
    fn cell(&self, specimen: &dyn Specimen, turned: TurnedFamily) -> Result<CellImages> {
        let (library_cell, settings) = self.source(specimen, turned)?;
        Ok(CellImages::new(library_cell, turned.family, settings))
    }

    /// The library cells of a family, and the settings of their images.
    fn source(
        &self,
        specimen: &dyn Specimen,
        turned: TurnedFamily,
    ) -> Result<(LibraryCell, Settings)> {
        let family = turned.family;
        let library_cell = specimen.library_cell(family).ok_or_else(|| {
            let expected = "the specimen has no library cell of this family";
            Error::invalid(crate::Setting::Library, format!("{family:?}"), expected)
        })?;
        let settings = match self.round {
            true => self.settings.clone(),
            false => Settings {
                optics: self.settings.optics.seen_from(turned.frame()),
                detectors: turned_detectors(&self.settings, turned),
                ..self.settings.clone()
            },
        };
        let library_cell = match settings.algorithm {
            Algorithm::Window { width_angstrom } => {
                library_cell.cut(0.5 * width_angstrom + POTENTIAL_REACH_ANGSTROM)
            }
            _ => library_cell,
        };
        Ok((library_cell.rounded(), settings))
    }

    /// The families whose library cells are not in the library.
    pub(crate) fn unknown(&self, families: BTreeSet<TurnedFamily>) -> Vec<TurnedFamily> {
        let shared: BTreeSet<TurnedFamily> = families.into_iter().map(|f| self.shared(f)).collect();
        shared.into_iter().filter(|f| !self.cells.contains_key(f)).collect()
    }

    /// Adds the library cells of some families with their images: shared ones, else from the cache, else simulated.
    ///
    /// # Errors
    /// As [`ImageLibrary::new`] and [`ImageLibrary::fill`].
    pub(crate) fn add(
        &mut self,
        (specimen, families): (&dyn Specimen, &[TurnedFamily]),
        shared: &SharedCells,
        (material, sigma, cache): (&str, &dyn Fn(u8) -> f64, &Cache),
        progress: &dyn Progress,
    ) -> Result<()> {
        let configurations = self.configurations;
        let with = (sigma, configurations);
        let mut cells = Vec::new();
        for turned in families {
            let (library_cell, settings) = self.source(specimen, *turned)?;
            match shared.of_family(*turned, (&library_cell, &settings), with) {
                Some(filled) => drop(self.cells.insert(*turned, filled)),
                None => {
                    cells.push((*turned, CellImages::new(library_cell, turned.family, settings)))
                }
            }
        }
        let probes = |(_, cell): &(_, CellImages)| cell.probes() * cell.library_cell.count;
        let all = configurations * cells.iter().map(probes).sum::<usize>();
        progress.start("library", "probe", all as u64);
        for (turned, mut cell) in cells {
            let name = cell.name(sigma, configurations);
            let filled = shared.get(name, || {
                let images = (material, sigma, cache);
                fill_cell(&mut cell, configurations, images, progress)?;
                Ok(cell)
            })?;
            shared.keep(turned, &filled, with);
            self.cells.insert(turned, filled);
        }
        progress.finish();
        Ok(())
    }

    /// Adds the library cells of another library of this specimen.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (family, cell) in &other.cells {
            self.cells.entry(*family).or_insert_with(|| Arc::clone(cell));
        }
    }

    /// The library cells of a family.
    pub(crate) fn cell_images(&self, family: TurnedFamily) -> Option<&CellImages> {
        self.cells.get(&self.shared(family)).map(|cell| &**cell)
    }

    /// Phonon configurations of each library cell.
    pub(crate) fn configurations(&self) -> usize {
        self.configurations
    }

    /// Number of probes of all images.
    pub(crate) fn probes(&self) -> usize {
        let of = |s: &Arc<CellImages>| s.probes() * s.library_cell.count * self.configurations;
        self.cells.values().map(of).sum()
    }

    /// Number of probes of the images that the supplied library lacks.
    pub(crate) fn probes_not_supplied(&self, material: &str, sigma: &dyn Fn(u8) -> f64) -> usize {
        let of = |cell: &Arc<CellImages>| {
            let new = |image: &[usize; 2]| !is_supplied(material, &cell.key(sigma, *image));
            cell.probes() * images_of(cell, self.configurations).filter(new).count()
        };
        self.cells.values().map(of).sum()
    }

    /// The plan for the image with the most probes; `None` for a library without library cells.
    ///
    /// # Errors
    /// Errors of [`Plan::new`].
    pub(crate) fn largest_plan(&self) -> Result<Option<PlannedScan>> {
        let largest = self.cells.values().max_by_key(|s| s.probes());
        let plan = |s: &Arc<CellImages>| Ok(PlannedScan::new(s.plan()?, s.scan, None));
        largest.map(plan).transpose()
    }

    /// Memory of all images and their means in bytes.
    pub(crate) fn image_bytes(&self) -> u64 {
        let of = |s: &Arc<CellImages>| {
            let images = s.library_cell.count * (self.configurations + 1) * self.detectors;
            s.shape[0] * s.shape[1] * images * 4
        };
        self.cells.values().map(of).sum::<usize>() as u64
    }

    /// Number of images.
    pub(crate) fn image_count(&self) -> usize {
        self.cells.values().map(|s| s.library_cell.count * self.configurations).sum()
    }

    /// The images that the cache lacks: the cells of their family, and their numbers (library cell, configuration).
    fn lacking<'a>(
        &'a self,
        material: &'a str,
        sigma: &'a dyn Fn(u8) -> f64,
        cache: &'a Cache,
    ) -> impl Iterator<Item = (&'a CellImages, [usize; 2])> {
        let all = self.cells.values().flat_map(move |cell| {
            images_of(cell, self.configurations).map(move |image| (&**cell, image))
        });
        all.filter(move |(cell, image)| !cache.has(material, &cell.key(sigma, *image)))
    }

    /// The images that the cache lacks.
    pub(crate) fn missing(
        &self,
        material: &str,
        sigma: &dyn Fn(u8) -> f64,
        cache: &Cache,
    ) -> Vec<MissingImage> {
        let missing = |cell: &CellImages| MissingImage {
            probes: cell.probes(),
            bytes: Cache::file_bytes(cell.probe_shape()),
        };
        self.lacking(material, sigma, cache).map(|(cell, _)| missing(cell)).collect()
    }

    /// The number of images that the cache lacks, grouped by their difference from the images that it has.
    pub(crate) fn new_images(
        &self,
        material: &str,
        sigma: &dyn Fn(u8) -> f64,
        cache: &Cache,
    ) -> Vec<NewImages> {
        let notes = cache.notes(material);
        let kept: Vec<ImageNote> =
            notes.iter().filter_map(|n| serde_json::from_str(n).ok()).collect();
        let mut new: BTreeMap<String, usize> = BTreeMap::new();
        for (cell, image) in self.lacking(material, sigma, cache) {
            let why = cell.note(sigma, image).difference(&kept);
            *new.entry(why).or_default() += 1;
        }
        new.into_iter().map(|(why, images)| NewImages::new(images, why)).collect()
    }

    /// Reads the images from the cache, and simulates the images that it lacks. Returns how many it lacked.
    ///
    /// # Errors
    /// Errors of the engine, [`Error::Interrupted`]. A cache that cannot be written is a warning.
    pub(crate) fn fill(
        &mut self,
        material: &str,
        sigma: &dyn Fn(u8) -> f64,
        cache: &Cache,
        progress: &dyn Progress,
    ) -> Result<usize> {
        let mut missing = 0;
        let mut keep: Option<Error> = None;
        progress.start("library", "probe", self.probes() as u64);
        for cell in self.cells.values_mut() {
            // No other library shares the cell yet.
            let Some(cell) = Arc::get_mut(cell) else { continue };
            let found = fill_cell(cell, self.configurations, (material, sigma, cache), progress)?;
            missing += found.0;
            keep = keep.or(found.1);
        }
        progress.finish();
        if let Some(why) = keep {
            progress.warn(&format!("simulations were not kept for later builds: {why}"));
        }
        Ok(missing)
    }

    /// Simulates the images of one of several processes that the cache lacks, and writes them to the cache. Returns their number.
    ///
    /// # Errors
    /// Errors of the engine and of the cache, [`Error::Interrupted`].
    pub(crate) fn fill_part(
        &self,
        shard: Shard,
        material: &str,
        sigma: &dyn Fn(u8) -> f64,
        cache: &Cache,
        progress: &dyn Progress,
    ) -> Result<usize> {
        let mut simulated = 0;
        let mut number = 0;
        progress.start("library", "probe", self.probes().div_ceil(shard.count()) as u64);
        for cell in self.cells.values() {
            let plan = cell.plan()?;
            let mut simulator = CellSimulator::new(&plan, sigma);
            for image in images_of(cell, self.configurations) {
                number += 1;
                if !shard.does(number - 1) {
                    continue;
                }
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                let key = cell.key(sigma, image);
                let share = ProgressShare::new(progress, cell.probes());
                if cache.load(material, &key, cell.probe_shape(), progress).is_some() {
                    share.found();
                    continue;
                }
                simulated += 1;
                let values = simulator.simulated(cell, image, &share)?;
                let kept = cache.save(material, &key, &simulator.note(cell, image), &values);
                // The image may be in the cache's other folder.
                kept.or_else(|e| if cache.has(material, &key) { Ok(()) } else { Err(e) })?;
                share.complete();
            }
        }
        progress.finish();
        Ok(simulated)
    }

    /// The names of all images in a cache.
    pub(crate) fn keys(&self, sigma: &dyn Fn(u8) -> f64) -> Vec<String> {
        let of = |cell: &Arc<CellImages>| {
            let images = images_of(cell, self.configurations);
            images.map(|image| cell.key(sigma, image)).collect::<Vec<_>>()
        };
        self.cells.values().flat_map(of).collect()
    }

    /// Simulates `count` images of the cache again, drawn with `seed`, and compares them.
    ///
    /// # Errors
    /// Errors of the engine, [`Error::Interrupted`].
    pub(crate) fn recomputed(
        &self,
        (count, seed): (usize, u64),
        material: &str,
        sigma: &dyn Fn(u8) -> f64,
        cache: &Cache,
        progress: &dyn Progress,
    ) -> Result<Vec<RecomputedImage>> {
        let all = self
            .cells
            .values()
            .flat_map(|cell| images_of(cell, self.configurations).map(move |image| (cell, image)));
        let mut drawn: Vec<_> = all
            .filter(|(cell, image)| cache.has(material, &cell.key(sigma, *image)))
            .enumerate()
            .map(|(n, held)| (words(seed, Purpose::Library, RECOMPUTED_DRAW, n as u64), held))
            .collect();
        drawn.sort_by_key(|(word, _)| *word);
        drawn.truncate(count);
        let probes: usize = drawn.iter().map(|(_, (cell, _))| cell.probes()).sum();
        progress.start("simulating again", "probe", probes as u64);
        let mut found = Vec::new();
        for (_, (cell, image)) in drawn {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let (key, plan) = (cell.key(sigma, image), cell.plan()?);
            let share = ProgressShare::new(progress, cell.probes());
            // The cache has already warned of a damaged image.
            let Some(kept) = cache.load(material, &key, cell.probe_shape(), progress) else {
                continue;
            };
            let now = CellSimulator::new(&plan, sigma).simulated(cell, image, &share)?;
            share.complete();
            let brightest = now.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let greatest = kept.iter().zip(&now).fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
            found.push(RecomputedImage { key, difference: f64::from(greatest / brightest) });
        }
        progress.finish();
        Ok(found)
    }
}

/// An image of the cache that was simulated again.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct RecomputedImage {
    /// Name of the image in the cache.
    pub key: String,
    /// Greatest difference of the two images' values, as fraction of the brightest value.
    pub difference: f64,
}

impl RecomputedImage {
    /// Whether the two images differ by rounding only, which depends on the processor.
    pub fn agrees(&self) -> bool {
        self.difference <= SAME
    }
}

/// Largest difference between images from different processors, as fraction of the brightest value.
const SAME: f64 = 1e-5;
/// Number of the draw of [`Purpose::Library`] for the images that are simulated again.
const RECOMPUTED_DRAW: u32 = 1 << 21;

/// Reads the images of a cell from the cache, and simulates the images that it lacks. Returns their number, and why they could not be
/// written.
fn fill_cell(
    cell: &mut CellImages,
    configurations: usize,
    (material, sigma, cache): (&str, &dyn Fn(u8) -> f64, &Cache),
    progress: &dyn Progress,
) -> Result<(usize, Option<Error>)> {
    let mut missing = 0;
    let mut keep: Option<Error> = None;
    let plan = cell.plan()?;
    let mut simulator = CellSimulator::new(&plan, sigma);
    for image in images_of(cell, configurations) {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let key = cell.key(sigma, image);
        let share = ProgressShare::new(progress, cell.probes());
        let values = match cache.load(material, &key, cell.probe_shape(), progress) {
            Some(values) => {
                share.found();
                values
            }
            None => {
                missing += 1;
                let values = simulator.simulated(cell, image, &share)?;
                let kept = cache.save(material, &key, &simulator.note(cell, image), &values);
                keep = keep.or(kept.err());
                share.complete();
                values
            }
        };
        cell.add(image[0], &values);
    }
    cell.average();
    Ok((missing, keep))
}

/// All images (library cell, configuration) of a family.
fn images_of(cell: &CellImages, configurations: usize) -> impl Iterator<Item = [usize; 2]> + use<> {
    (0..cell.library_cell.count).flat_map(move |s| (0..configurations).map(move |c| [s, c]))
}

/// Simulates images of one cell; the first image prepares the simulation.
struct CellSimulator<'a> {
    plan: &'a Plan,
    sigma: &'a dyn Fn(u8) -> f64,
    ready: Option<Simulation<'a>>,
}

impl<'a> CellSimulator<'a> {
    fn new(plan: &'a Plan, sigma: &'a dyn Fn(u8) -> f64) -> Self {
        CellSimulator { plan, sigma, ready: None }
    }

    /// The values of the probes of an image (library cell, configuration), as the cache stores them.
    fn simulated(
        &mut self,
        cell: &CellImages,
        image: [usize; 2],
        progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        let simulation = match &mut self.ready {
            Some(ready) => ready,
            none => none.insert(Simulation::new(self.plan, &cell.elements())?),
        };
        let atoms = cell.atoms(image[0], image[1], self.sigma);
        Ok(stacked(&simulation.images(&atoms, &cell.scan, progress)?))
    }

    /// The note that the cache stores with the image.
    fn note(&self, cell: &CellImages, image: [usize; 2]) -> String {
        serde_json::to_string(&cell.note(self.sigma, image)).unwrap_or_default()
    }
}

/// The detectors as seen from the library cells of a turned family.
fn turned_detectors(settings: &Settings, turned: TurnedFamily) -> Vec<Detector> {
    settings.detectors.iter().map(|d| d.seen_from(turned.frame())).collect()
}

/// The images of all detectors, one below the other.
fn stacked(images: &Images) -> Array2<f32> {
    let (_, detectors, rows, columns) = images.data.dim();
    let values = (0..detectors).flat_map(|n| images.image(0, n).into_iter().copied()).collect();
    Array2::from_shape_vec((detectors * rows, columns), values).unwrap_or_default()
}
