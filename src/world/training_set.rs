//! Tiles at random places of a field with labels, for training: images with noise, heat maps, masks, columns.

use std::collections::HashMap;

use ndarray::{Array1, Array2, Array3, Axis, s};

use super::column_labels::{REACH_SIGMAS, class_of, draw_column, facts_of};
use super::region_truth::{list, phase_map};
use crate::error::{Error, Result};
use crate::imaging::Noise;
use crate::imaging::{PixelRect, RegionImager};
use crate::plane;
use crate::progress::{InterruptOnly, Progress};
use crate::recipe::CheckedRecipe;
use crate::rng::{self, Purpose};
use crate::specimen::Specimen;

/// Edge in pixels of the blocks that images are cut from; each block is made once.
const BLOCK_PX: usize = 128;

/// The options of a training set.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingOptions {
    /// Number of tiles.
    pub tiles: usize,
    /// Edge of a tile in pixels.
    pub size_px: usize,
    /// Least and greatest dose in electrons per square Angstrom; drawn for each tile, evenly in its logarithm.
    pub dose: [f64; 2],
    /// Standard deviation in pixels of a column in the heat maps.
    pub sigma_px: f64,
    /// Seed of places, doses and noise.
    pub seed: u64,
}

impl TrainingOptions {
    /// Warns where tiles of a field of `shape` [rows, columns] have to overlap.
    pub fn crowding(&self, shape: [usize; 2]) -> Option<String> {
        let room: usize = shape.map(|n| n / self.size_px.max(1)).iter().product();
        let shown = self.tiles as f64 * (self.size_px as f64).powi(2);
        let times = shown / (shape[0] as f64 * shape[1] as f64);
        (self.tiles > room && times > 1.0).then(|| {
            format!(
                "{} tiles are asked for, and the field of {} x {} pixels has room for {room} of {size} x {size} side by side: each pixel \
                 is in {times:.1} tiles on average; a larger field shows more",
                self.tiles,
                shape[0],
                shape[1],
                size = self.size_px
            )
        })
    }
}

/// The classes of columns in class masks and lists; 0 is background.
pub const COLUMN_CLASSES: [&str; 5] =
    ["background", "pristine", "vacancies", "substitutions", "vacancies and substitutions"];

/// Labelled tiles. All arrays of images are (tile, row, column).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrainingSet {
    /// Images with noise, as fractions of the beam: counted electrons divided by the electrons that fell on a pixel.
    pub images: Array3<f32>,
    /// The images without noise; no tiles where the noise comes from a recording.
    pub clean: Array3<f32>,
    /// Gaussians of height 1 about columns; the nearest column counts.
    pub heat_maps: Array3<f32>,
    /// Index into [`COLUMN_CLASSES`]: the class of the nearest column where its heat map is above one half.
    pub class_masks: Array3<u8>,
    /// Phase of each pixel, as an index into the phases of the specimen.
    pub phase_masks: Array3<i32>,
    /// Dose of each tile in electrons per square Angstrom; NaN where it is not known.
    pub dose: Array1<f64>,
    /// Middle of each tile, (x, y) in nm of the full field.
    pub centres_nm: Array2<f64>,
    /// Tile of each column.
    pub column_tiles: Array1<i32>,
    /// (x, y) of each column in its tile, in pixels from the centre of the first.
    pub column_positions_px: Array2<f32>,
    /// Class, sites, vacancies, substitutions and atomic number of the heaviest atom of each column.
    pub columns: Array2<i32>,
    /// Edge of a pixel in Angstrom.
    pub pixel_angstrom: f64,
}

/// Makes the tiles. The imager must be prepared.
///
/// # Errors
/// [`Error::Invalid`] for tiles larger than the field and options out of limits; errors of the engine,
/// [`Error::Interrupted`].
pub fn training_set(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    imager: &dyn RegionImager,
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<TrainingSet> {
    check(recipe, options)?;
    let (n, size) = (options.tiles, options.size_px);
    let mut set = TrainingSet::empty(n, size, recipe.field.pixel_angstrom());
    let mut blocks = TileBlocks { recipe, imager, made: HashMap::new() };
    let mut lists = ColumnLists::default();
    progress.start("tiles", "tile", n as u64);
    for tile in 0..n {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let (corner, dose) = draw(recipe, options, tile as u64);
        let origin = recipe.field.crop_origin_px();
        let pixels = PixelRect::new(plane::add(origin, corner), [size; 2]);
        let clean = blocks.image(&pixels, &InterruptOnly(progress))?;
        let noise = Noise {
            seed: options.seed,
            electrons_per_pixel: dose * set.pixel_angstrom.powi(2),
            origin_px: [tile * size, 0],
            full_width_px: size,
            detector: 0,
        };
        let mut noisy = clean.clone();
        noise.apply(&mut noisy, 0);
        set.images.index_axis_mut(Axis(0), tile).assign(&noisy);
        set.clean.index_axis_mut(Axis(0), tile).assign(&clean);
        set.dose[tile] = dose;
        set.place(tile, pixels.first);
        let phases = phase_map(specimen, &pixels, recipe.field.pixel_nm());
        set.phase_masks.index_axis_mut(Axis(0), tile).assign(&phases);
        set.label(tile, recipe, specimen, &pixels, options.sigma_px, &mut lists);
        progress.advance(1);
    }
    progress.finish();
    Ok(lists.into_set(set))
}

fn check(recipe: &CheckedRecipe, options: &TrainingOptions) -> Result<()> {
    check_sizes(recipe.field.pixels(recipe.field.built_grid()), options)?;
    let [low, high] = options.dose;
    if !(1e-3..=1e12).contains(&low) || !(low..=1e12).contains(&high) {
        let expected = "expected 0.001 to 1e12 electrons per square Angstrom, the lower first";
        return Err(Error::invalid(crate::Setting::Dose, format!("{low},{high}"), expected));
    }
    Ok(())
}

/// Checks the lengths in pixels for a field of `shape` [rows, columns].
pub(crate) fn check_sizes(shape: [usize; 2], options: &TrainingOptions) -> Result<()> {
    let least = shape[0].min(shape[1]);
    let refuse =
        |setting, value: String, expected: String| Err(Error::invalid(setting, value, expected));
    if !(8..=least).contains(&options.size_px) {
        let expected = format!("expected 8 to {least} pixels, the shorter side of the field");
        return refuse(crate::Setting::TilePixels, options.size_px.to_string(), expected);
    }
    if !(0.3..=50.0).contains(&options.sigma_px) {
        let expected = "a column in heat maps is 0.3 to 50 pixels wide".into();
        return refuse(crate::Setting::TilePixels, options.sigma_px.to_string(), expected);
    }
    Ok(())
}

/// Draws the first pixel (row, column) of a tile in the built field, and its dose.
fn draw(recipe: &CheckedRecipe, options: &TrainingOptions, tile: u64) -> ([usize; 2], f64) {
    let shape = recipe.field.pixels(recipe.field.built_grid());
    let share = rng::uniform(options.seed, Purpose::Tile, 2, tile);
    let [low, high] = options.dose.map(libm::log);
    (corner(shape, options, tile), libm::exp(low + share * (high - low)))
}

/// Draws the first pixel (row, column) of a tile in a field of `shape` [rows, columns].
pub(crate) fn corner(shape: [usize; 2], options: &TrainingOptions, tile: u64) -> [usize; 2] {
    [0, 1].map(|k| {
        let room = shape[k] - options.size_px + 1;
        let share = rng::uniform(options.seed, Purpose::Tile, k as u32, tile);
        ((share * room as f64) as usize).min(room - 1)
    })
}

/// Images of tiles, cut from blocks of the built field. No block reaches beyond the field, so every pixel of a small world is simulated
/// once.
struct TileBlocks<'a> {
    recipe: &'a CheckedRecipe,
    imager: &'a dyn RegionImager,
    made: HashMap<[usize; 2], Array2<f32>>,
}

impl TileBlocks<'_> {
    fn image(&mut self, pixels: &PixelRect, progress: &dyn Progress) -> Result<Array2<f32>> {
        let PixelRect { first, shape, .. } = *pixels;
        let mut image = Array2::zeros(shape);
        let origin = self.recipe.field.crop_origin_px();
        let range = |k: usize| {
            let at = first[k] - origin[k];
            at / BLOCK_PX..=(at + shape[k] - 1) / BLOCK_PX
        };
        for (row, column) in range(0).flat_map(|r| range(1).map(move |c| (r, c))) {
            let start = [origin[0] + row * BLOCK_PX, origin[1] + column * BLOCK_PX];
            let block = self.block([row, column], start, progress)?;
            let low = plane::max(first, start);
            let high = plane::min(plane::add(first, shape), start.map(|n| n + BLOCK_PX));
            let part = |from: [usize; 2]| {
                s![low[0] - from[0]..high[0] - from[0], low[1] - from[1]..high[1] - from[1]]
            };
            image.slice_mut(part(first)).assign(&block.slice(part(start)));
        }
        Ok(image)
    }

    fn block(
        &mut self,
        index: [usize; 2],
        start: [usize; 2],
        progress: &dyn Progress,
    ) -> Result<&Array2<f32>> {
        if !self.made.contains_key(&index) {
            let field = &self.recipe.field;
            let (origin, built) = (field.crop_origin_px(), field.pixels(field.built_grid()));
            let shape = plane::sub(plane::add(origin, built), start).map(|n| n.min(BLOCK_PX));
            let configurations = self.recipe.phonons.configurations.max(1);
            let made =
                self.imager.mean_of(&PixelRect::new(start, shape), configurations, progress)?;
            self.made.insert(index, made.mapv(|v| v as f32));
        }
        Ok(&self.made[&index])
    }
}

/// The columns of all tiles, tile after tile.
#[derive(Default)]
pub(crate) struct ColumnLists {
    tiles: Vec<i32>,
    positions: Vec<[f32; 2]>,
    facts: Vec<[i32; 5]>,
}

impl ColumnLists {
    /// Adds a column of a tile at (row, column) in pixels, with its facts.
    pub(crate) fn add(&mut self, tile: usize, at: [f64; 2], facts: [i32; 5]) {
        self.tiles.push(tile as i32);
        self.positions.push(plane::swapped(at).map(|px| px as f32));
        self.facts.push(facts);
    }

    pub(crate) fn into_set(self, mut set: TrainingSet) -> TrainingSet {
        set.column_tiles = Array1::from(self.tiles);
        set.column_positions_px = ndarray::arr2(&self.positions);
        set.columns = ndarray::arr2(&self.facts);
        set
    }
}

impl TrainingSet {
    pub(crate) fn empty(n: usize, size: usize, pixel_angstrom: f64) -> Self {
        TrainingSet {
            images: Array3::zeros((n, size, size)),
            clean: Array3::zeros((n, size, size)),
            heat_maps: Array3::zeros((n, size, size)),
            class_masks: Array3::zeros((n, size, size)),
            phase_masks: Array3::zeros((n, size, size)),
            dose: Array1::zeros(n),
            centres_nm: Array2::zeros((n, 2)),
            column_tiles: Array1::zeros(0),
            column_positions_px: Array2::zeros((0, 2)),
            columns: Array2::zeros((0, 5)),
            pixel_angstrom,
        }
    }

    /// Records the place of a tile: its first pixel (row, column) in the full field.
    pub(crate) fn place(&mut self, tile: usize, first: [usize; 2]) {
        let half = 0.5 * (self.images.len_of(Axis(1)) as f64 - 1.0);
        let centre = plane::swapped(first).map(|n| (n as f64 + half) * 0.1 * self.pixel_angstrom);
        self.centres_nm.row_mut(tile).assign(&Array1::from(centre.to_vec()));
    }

    /// Draws the columns of a tile, and lists the columns in it.
    fn label(
        &mut self,
        tile: usize,
        recipe: &CheckedRecipe,
        specimen: &dyn Specimen,
        pixels: &PixelRect,
        sigma_px: f64,
        lists: &mut ColumnLists,
    ) {
        let pixel = recipe.field.pixel_nm();
        let around = pixels.region(pixel).grown(REACH_SIGMAS * sigma_px * pixel);
        // Positions count from the centre of the tile's first pixel.
        let origin = plane::swapped(pixels.first).map(|n| n as f64 * pixel);
        let (_, columns) = list(&specimen.query(&around), origin, 0);
        let mut heat = self.heat_maps.index_axis_mut(Axis(0), tile);
        let mut mask = self.class_masks.index_axis_mut(Axis(0), tile);
        let size = heat.dim().0 as f64;
        for column in &columns {
            let at = plane::swapped(column.position_nm).map(|nm| f64::from(nm) / pixel);
            draw_column(at, class_of(column), sigma_px, &mut heat, &mut mask);
            if at.iter().all(|v| (-0.5..size - 0.5).contains(v)) {
                lists.add(tile, at, facts_of(column));
            }
        }
    }
}
