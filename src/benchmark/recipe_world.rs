//! Worlds of a recipe without a file: a specimen for each seed, imaged only where an agent looks.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ndarray::{Array2, s};
use rayon::prelude::*;

use super::benchmark_world::{BenchmarkWorld, PhaseSamples, RegionTruth, TrueColumn, window};
use super::findings::{FoundParticle, PlacedDefect, type_name};
use super::in_use::InUse;
use super::overview_blocks::OverviewBlocks;
use super::view::{FieldFacts, TileView};
use crate::error::{Error, Result};
use crate::imaging::Noise;
use crate::imaging::{
    MethodChoice, PixelRect, RegionImager, SharedCells, TurnedRaster, overview_image, turned_image,
};
use crate::lengths;
use crate::plane;
use crate::progress::{InterruptOnly, Progress};
use crate::recipe::{CheckedRecipe, OVERVIEW_FACTOR, Recipe, Region, StructureKind};
use crate::rng::{Purpose, words};
use crate::setting::Setting;
use crate::specimen::{ParticleOutline, SiteKind, Specimen, outlines_in, specimen};
use crate::world::region_truth::{list, phases_of_points};
use crate::world::{BuildOptions, ColumnTruth, SiteTruth};

/// Above this share of its band limit an image has less than 0.01 % of its power (see [`crate::resample::Kernel`]).
const HIGHEST_SHARE: f64 = 0.9;
/// Number of images of views that a world keeps.
const KEPT_VIEWS: usize = 512;
/// Number of places of a field, or of particles, at which the brightest pixel is searched.
const SCALED_PLACES: usize = 5;
/// Edge in pixels of the part of a particle in which the brightest pixel is searched, in one phonon configuration: wider than the distance
/// of columns.
const PARTICLE_PX: usize = 24;
/// Factor between the brightest pixel of these places and the value at which tiles are clipped.
const HEADROOM: f64 = 1.2;

/// Two sets of seeds for specimens. No seed is in both, so that no agent is trained on specimens that are scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Split {
    /// For training: even seeds.
    #[default]
    Train,
    /// For scores: odd seeds.
    Test,
}

impl Split {
    /// Returns the seed of the specimen of an episode (seed, number) of a recipe.
    pub fn seed(self, recipe: &Recipe, (seed, number): (u64, u32)) -> u64 {
        let pair = |[low, high, ..]: [u32; 4]| u64::from(high) << 32 | u64::from(low);
        let episode = pair(words(seed, Purpose::HeldOut, EPISODE_DRAW, u64::from(number)));
        let drawn = pair(words(recipe.seed, Purpose::HeldOut, self as u32, episode));
        // Numbers in TOML are signed.
        drawn >> 2 << 1 | self as u64
    }
}

/// Number of the draw that combines seed and number of an episode.
const EPISODE_DRAW: u32 = 2;

/// Makes worlds of one recipe, which share the library of their images.
pub struct RecipeSource {
    recipe: CheckedRecipe,
    options: BuildOptions,
    shared: Arc<SharedCells>,
    facts: FieldFacts,
    in_use: InUse<u64, RecipeWorld>,
}

impl RecipeSource {
    /// Fills the library, from the cache or by simulations, which take minutes. Then the brightness of a few places sets the scale of
    /// tiles, which is equal for all seeds.
    ///
    /// # Errors
    /// Errors of the specimen and the engine, [`Error::Interrupted`].
    pub fn new(
        recipe: &CheckedRecipe,
        options: &BuildOptions,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let field = &recipe.field;
        let facts = FieldFacts {
            name: name_of(recipe),
            material: recipe.id.clone(),
            grid: field.built_grid(),
            tile_px: field.tile_px,
            overlap_px: field.overlap_px,
            pixel_nm: field.pixel_nm(),
            dose: recipe.dose.electrons_per_angstrom2,
            scaling: [1.0, 0.0],
            phases: Vec::new(),
            target: target(recipe),
            recorded: false,
            margin_px: 0,
        };
        let (recipe, options) = (recipe.clone(), options.clone());
        let shared = Arc::new(SharedCells::default());
        let mut source = RecipeSource { recipe, options, shared, facts, in_use: InUse::new() };
        let mut first = source.world_of(source.recipe.clone())?;
        first.imager.prepare(progress)?;
        source.facts.phases = first.specimen.facts().phases.clone();
        source.facts.scaling = source.scaling(&first, &InterruptOnly(progress))?;
        Ok(source)
    }

    /// Returns facts of the field of all worlds.
    pub fn facts(&self) -> &FieldFacts {
        &self.facts
    }

    /// Returns the recipe.
    pub fn recipe(&self) -> &CheckedRecipe {
        &self.recipe
    }

    /// Returns the options by which images are made.
    pub(crate) fn options(&self) -> &BuildOptions {
        &self.options
    }

    /// Returns the recipe with another seed.
    ///
    /// # Errors
    /// Errors of the recipe's limits.
    pub fn recipe_of(&self, seed: u64) -> Result<CheckedRecipe> {
        self.recipe.with_seed(seed)
    }

    /// Makes the world of a seed.
    ///
    /// # Errors
    /// Errors of the specimen.
    pub fn world(&self, seed: u64) -> Result<RecipeWorld> {
        self.world_of(self.recipe_of(seed)?)
    }

    /// Returns the world of a seed. A world that somebody already uses is shared, with its images, so that episodes of many agents and
    /// tasks in one specimen simulate a place once.
    ///
    /// # Errors
    /// Errors of the specimen.
    pub fn shared_world(&self, seed: u64) -> Result<Arc<RecipeWorld>> {
        self.in_use.get(seed, || self.world(seed))
    }

    /// Returns scale and offset of tiles. The scale is the brightest pixel of a few places of a world, or of its largest particles, with
    /// its noise and [`HEADROOM`].
    fn scaling(&self, world: &RecipeWorld, progress: &dyn Progress) -> Result<[f64; 2]> {
        let brightest = match self.brightest_of_particles(world, progress)? {
            Some(brightest) => brightest,
            None => self.brightest_of_places(world, progress)?,
        };
        let electrons = self.facts.dose * lengths::square_angstrom2(self.facts.pixel_nm);
        let noise = if electrons > 0.0 { (brightest / electrons).sqrt() } else { 0.0 };
        Ok([(HEADROOM * brightest + 5.0 * noise).max(f64::MIN_POSITIVE), 0.0])
    }

    fn brightest_of_places(&self, world: &RecipeWorld, progress: &dyn Progress) -> Result<f64> {
        let even = |n: usize| (n as f64 + 0.5) / SCALED_PLACES as f64;
        let mut brightest = 0.0f64;
        for place in (0..SCALED_PLACES).map(|n| [even(n), even(n)]) {
            let image = world.image(&self.facts.view_at(place, 1.0), progress)?;
            brightest = image.iter().fold(brightest, |m, v| m.max(f64::from(*v)));
        }
        Ok(brightest)
    }

    /// Returns the brightest pixel in squares of [`PARTICLE_PX`] pixels about the centres of the largest particles, if there are any. Only
    /// these pixels are simulated, in one phonon configuration.
    fn brightest_of_particles(
        &self,
        world: &RecipeWorld,
        progress: &dyn Progress,
    ) -> Result<Option<f64>> {
        let RecipeWorld { recipe, specimen, .. } = world;
        let mut particles = outlines_in(&**specimen, &recipe.field.built_region());
        if particles.is_empty() {
            return Ok(None);
        }
        particles.sort_by(|a, b| b.diameter_nm.total_cmp(&a.diameter_nm));
        particles.truncate(SCALED_PLACES);
        let mut imaging = self.options.policy(recipe)?.imaging;
        imaging.method = MethodChoice::Direct;
        let imager = imaging.imager_of_many(recipe, specimen, &self.shared)?;
        let mut brightest = 0.0f64;
        for ParticleOutline { centre_nm, .. } in particles {
            let middle =
                plane::swapped(centre_nm).map(|nm| (nm / self.facts.pixel_nm).round() as usize);
            let first = middle.map(|n| n.saturating_sub(PARTICLE_PX / 2));
            let image = imager.mean_of(&PixelRect::new(first, [PARTICLE_PX; 2]), 1, progress)?;
            brightest = image.iter().fold(brightest, |m, v| m.max(*v));
        }
        Ok(Some(brightest))
    }

    fn world_of(&self, recipe: CheckedRecipe) -> Result<RecipeWorld> {
        let specimen = specimen(&recipe)?;
        let mut imaging = self.options.policy(&recipe)?.imaging;
        if imaging.method == MethodChoice::Auto {
            // The library is used for many specimens, so a mosaic always pays.
            imaging.method = MethodChoice::Mosaic;
        }
        let imager = imaging.imager_of_many(&recipe, &specimen, &self.shared)?;
        let name = format!("{}, seed {}", self.facts.name, recipe.seed);
        let facts = FieldFacts { name, ..self.facts.clone() };
        let kept = Mutex::default();
        Ok(RecipeWorld { recipe, specimen, imager, facts, kept })
    }
}

fn name_of(recipe: &Recipe) -> String {
    let tier = recipe.tier.map_or(String::new(), |tier| format!(" {}", tier.name()));
    format!("{}{tier}", recipe.id)
}

/// Returns the type of defect that [`FieldFacts::target`] names for a recipe: vacancies if it has any, else substitutions.
fn target(recipe: &Recipe) -> Option<String> {
    let further = |vacant: bool| recipe.defects.iter().any(|d| d.by.is_none() == vacant);
    let substituted = recipe.alloy.is_some() || recipe.substitutions.is_some() || further(false);
    match (recipe.structure, recipe.vacancies.is_some() || further(true), substituted) {
        (StructureKind::Particles, ..) => None,
        (_, true, _) => type_name(SiteKind::Vacancy).map(str::to_owned),
        (_, false, true) => type_name(SiteKind::Substitution).map(str::to_owned),
        (_, false, false) => None,
    }
}

/// Images and maps that a world has made.
#[derive(Default)]
struct Made {
    views: HashMap<([usize; 2], u64), Arc<Array2<f32>>>,
    blocks: HashMap<[usize; 2], Arc<Array2<f32>>>,
    phases: HashMap<usize, Arc<PhaseSamples>>,
}

/// A specimen of a recipe, with images of the places that agents have looked at.
pub struct RecipeWorld {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    imager: Box<dyn RegionImager>,
    facts: FieldFacts,
    kept: Mutex<Made>,
}

impl RecipeWorld {
    /// Returns the specimen.
    pub fn specimen(&self) -> &Arc<dyn Specimen> {
        &self.specimen
    }

    fn kept(&self) -> MutexGuard<'_, Made> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn configurations(&self) -> usize {
        self.recipe.phonons.configurations.max(1)
    }

    /// Images a view: pixels of the field without zoom, or places between them.
    fn image(&self, view: &TileView, progress: &dyn Progress) -> Result<Array2<f32>> {
        let field = &self.recipe.field;
        let image = if view.zoom == 1.0 {
            let first = field.crop_origin_px();
            let mut pixels = view.pixels();
            pixels.first = plane::add(pixels.first, first);
            self.imager.mean_of(&pixels, self.configurations(), progress)?
        } else {
            let raster = view.raster(field.pixel_nm(), field.origin_nm());
            turned_image(&self.recipe, &*self.imager, &raster, progress)?
        };
        Ok(image.mapv(|v| v as f32))
    }

    /// Returns the shape of the overview: its whole pixels.
    fn overview_shape(&self) -> [usize; 2] {
        self.facts.shape_px().map(|n| n / OVERVIEW_FACTOR)
    }

    fn overview_blocks(&self) -> OverviewBlocks {
        let start = self.facts.position_of(&self.facts.view_at([0.5; 2], 1.0));
        OverviewBlocks::new(self.overview_shape(), start)
    }

    /// Makes a block of the overview. Each pixel is the mean over a raster that is finer than any detail of the image, with the noise of
    /// the electrons on its area.
    fn block(&self, at: [usize; 2], progress: &dyn Progress) -> Result<Arc<Array2<f32>>> {
        if let Some(found) = self.kept().blocks.get(&at) {
            return Ok(Arc::clone(found));
        }
        let pixel = self.facts.pixel_nm;
        let of_block = self.overview_blocks().pixels(at);
        let first = of_block.each_ref().map(|range| range.start);
        let size = of_block.each_ref().map(ExactSizeIterator::len);
        let edge_nm = OVERVIEW_FACTOR as f64 * pixel;
        // The raster's spacing is chosen so that frequencies that alias to zero are above this share of the band limit.
        let highest = HIGHEST_SHARE * self.recipe.optics.image_band_limit();
        let places = (lengths::angstrom(edge_nm) * highest).ceil().max(1.0) as usize;
        let origin = self.recipe.field.origin_nm();
        let middle = |k: usize| {
            let from_edge = first[k] as f64 + 0.5 * size[k] as f64;
            from_edge * edge_nm - 0.5 * pixel
        };
        let raster = TurnedRaster {
            centre_nm: [middle(1) + origin[0], middle(0) + origin[1]],
            pixel_nm: edge_nm / places as f64,
            angle_rad: 0.0,
            shape: size.map(|n| n * places),
        };
        let fine = overview_image(&self.recipe, &*self.imager, &raster, progress)?;
        let mean = Array2::from_shape_fn(size, |(i, j)| {
            let part = s![i * places..(i + 1) * places, j * places..(j + 1) * places];
            fine.slice(part).mean().unwrap_or_default() as f32
        });
        let noise = Noise {
            seed: self.recipe.seed ^ OVERVIEW_STREAM,
            electrons_per_pixel: self.facts.dose * lengths::square_angstrom2(edge_nm),
            origin_px: first,
            full_width_px: self.overview_shape()[1],
            detector: 0,
        };
        let [scale, offset] = self.facts.scaling;
        let mut block = mean;
        if noise.electrons_per_pixel > 0.0 {
            noise.apply(&mut block, 0);
        }
        block.mapv_inplace(|v| ((f64::from(v) - offset) / scale).clamp(0.0, 1.0) as f32);
        let block = Arc::new(block);
        self.kept().blocks.insert(at, Arc::clone(&block));
        Ok(block)
    }
}

/// Overviews take other random numbers than tiles.
const OVERVIEW_STREAM: u64 = 0x6F76_6572_7669_6577;

impl BenchmarkWorld for RecipeWorld {
    fn facts(&self) -> &FieldFacts {
        &self.facts
    }

    fn clean(&self, view: &TileView, progress: &dyn Progress) -> Result<Arc<Array2<f32>>> {
        let key = (view.first_px, view.zoom.to_bits());
        if let Some(found) = self.kept().views.get(&key) {
            return Ok(Arc::clone(found));
        }
        let image = Arc::new(self.image(view, &InterruptOnly(progress))?);
        let mut kept = self.kept();
        if kept.views.len() >= KEPT_VIEWS {
            kept.views.clear();
        }
        kept.views.insert(key, Arc::clone(&image));
        Ok(image)
    }

    fn stored(&self, _view: &TileView) -> Result<Array2<f32>> {
        let expected = "a world of a recipe has no stored tiles; count electrons, or build the world as a file";
        Err(Error::invalid(Setting::Episode, "stored tiles", expected))
    }

    fn overview(
        &self,
        position: [f64; 2],
        size: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        let shape = self.overview_shape();
        let first = window(position, shape, size);
        let mut out = Array2::zeros([size; 2]);
        let end = plane::min(first.map(|n| n + size), shape);
        let blocks = self.overview_blocks();
        let places = blocks.covering(plane::per_axis(first, end, |first, end| first..end));
        let quiet = InterruptOnly(progress);
        let made: Vec<Arc<Array2<f32>>> =
            places.par_iter().map(|at| self.block(*at, &quiet)).collect::<Result<_>>()?;
        for (place, block) in places.into_iter().zip(made) {
            let of_block = blocks.pixels(place);
            let start = of_block.each_ref().map(|range| range.start);
            let low = plane::max(start, first);
            let high = plane::min(of_block.map(|range| range.end), end);
            let part = |from: [usize; 2]| {
                s![low[0] - from[0]..high[0] - from[0], low[1] - from[1]..high[1] - from[1]]
            };
            out.slice_mut(part(first)).assign(&block.slice(part(start)));
        }
        Ok(out)
    }

    fn truth(&self, region: &Region, columns: bool) -> Result<RegionTruth> {
        let origin = self.recipe.field.origin_nm();
        Ok(truth_of(&*self.specimen, region, origin, columns))
    }

    fn phases(&self, stride_px: usize) -> Result<Arc<PhaseSamples>> {
        if let Some(found) = self.kept().phases.get(&stride_px) {
            return Ok(Arc::clone(found));
        }
        let (origin, pixel) = (self.recipe.field.origin_nm(), self.facts.pixel_nm);
        let shape = PhaseSamples::shape(self.facts.shape_px(), stride_px);
        let phases = phases_of_points(&*self.specimen, shape, |row, column| {
            let at = [column, row].map(|n| (n * stride_px + stride_px / 2) as f64 * pixel);
            [at[0] + origin[0], at[1] + origin[1]]
        });
        let samples = Arc::new(PhaseSamples { phases, stride_px });
        self.kept().phases.insert(stride_px, Arc::clone(&samples));
        Ok(samples)
    }
}

/// Largest distance of a site from the place of its column, in nm.
const BESIDE_NM: f64 = 0.3;

/// Returns the truth of a region of a specimen. The region counts from the field's first pixel, at `origin` (x, y) in nm of the full field.
pub(super) fn truth_of(
    specimen: &dyn Specimen,
    region: &Region,
    origin: [f64; 2],
    columns: bool,
) -> RegionTruth {
    let there = region.moved(origin);
    let (sites, found) = list(&specimen.query(&there.grown(BESIDE_NM)), origin, 0);
    let placed = |s: &SiteTruth| {
        let kind = type_name(s.kind)?;
        let [x, y, _] = s.position_nm.map(f64::from);
        let inside = region.contains([x, y]);
        inside.then(|| PlacedDefect { kind: kind.to_owned(), position_nm: [x, y] })
    };
    let column = |c: &ColumnTruth| {
        let position_nm = c.position_nm.map(f64::from);
        let defective = c.vacancies + c.substitutions > 0;
        region.contains(position_nm).then_some(TrueColumn { position_nm, defective })
    };
    RegionTruth {
        defects: sites.iter().filter_map(placed).collect(),
        columns: if columns { found.iter().filter_map(column).collect() } else { Vec::new() },
        particles: particles_of(specimen, region, origin),
    }
}

/// Returns the particles that reach into the region.
fn particles_of(specimen: &dyn Specimen, region: &Region, origin: [f64; 2]) -> Vec<FoundParticle> {
    let particle = |p: &ParticleOutline| FoundParticle {
        position_nm: plane::sub(p.centre_nm, origin),
        diameter_nm: p.diameter_nm,
        morphology: p.morphology.clone(),
    };
    let there = region.moved(origin);
    let particles = specimen.facts().particle_outlines.iter();
    particles.filter(|p| p.reaches(&there)).map(particle).collect()
}
