//! The engine of `stemgen build`: library, assembly, and direct simulation of what does not repeat.

use std::collections::BTreeMap;

use ndarray::Array2;

use super::assembly::Assembly;
use super::atoms::{DisplacedAtoms, definite_atoms};
use super::cache::Cache;
use super::library::Library;
use super::survey::{Survey, survey};
use crate::engine::{PlannedScan, Scan, Site};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::resample::{Kernel, image_band_limit};
use crate::world::build::SubTileEngine;
use crate::world::field_image::FieldImage;
use crate::world::pixel_box::PixelBox;
use crate::world::recipe::Recipe;
use crate::world::simulator::Simulator;
use crate::world::specimen::{Region, Specimen};
use crate::world::subprogress::Quiet;

/// Edge in pixels of the blocks in which pixels that need direct simulation are gathered.
pub const BLOCK_PX: usize = 48;
/// A library is worth its cost where it takes fewer probes than this share of the field's.
const WORTH: f64 = 0.8;

/// How a mosaic is made.
#[derive(Debug, Clone)]
pub struct MosaicEngine {
    /// Simulates sheets, and what does not repeat.
    pub simulator: Simulator,
    /// Where images of sheets are kept.
    pub cache: Cache,
    /// Make a library even for fields that take less without one.
    pub always: bool,
}

impl SubTileEngine for MosaicEngine {
    fn name(&self) -> String {
        "mosaic".into()
    }
    fn parameters(&self) -> serde_json::Value {
        self.simulator.parameters()
    }
    fn margin_angstrom(&self) -> f64 {
        self.simulator.margin_angstrom()
    }
    fn image(
        &self,
        sites: &[Site],
        box_angstrom: [f64; 3],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        self.simulator.image(sites, box_angstrom, scan, progress)
    }
    fn mosaic(&self) -> Option<&MosaicEngine> {
        Some(self)
    }
}

/// A field's library, ready to make images from.
pub struct Mosaic<'a> {
    specimen: &'a dyn Specimen,
    recipe: &'a Recipe,
    simulator: Simulator,
    library: Library,
    kernel: Kernel,
    /// What the field holds.
    pub survey: Survey,
    /// Images of sheets that were simulated, not read from the cache.
    pub simulated: usize,
}

impl<'a> Mosaic<'a> {
    /// Surveys the field and fills the library. `None` where simulating the field itself takes less.
    ///
    /// # Errors
    /// Those of the engine, and [`Error::Interrupted`].
    pub fn prepare(
        engine: &MosaicEngine,
        specimen: &'a dyn Specimen,
        recipe: &'a Recipe,
        progress: &dyn Progress,
    ) -> Result<Option<Self>> {
        let settings = engine.simulator.settings();
        let survey = survey(specimen, &recipe.field);
        let mut library = Library::new(specimen, survey.families.iter().copied(), settings)?;
        if !(engine.always || worth(&library, &survey, recipe)) {
            return Ok(None);
        }
        let band_limit = image_band_limit(&settings.optics);
        let kernel = Kernel::new(Kernel::default_step(band_limit), band_limit)?;
        let sigma = |number| recipe.phonons.sigma_angstrom(number);
        let simulated = library.fill(&recipe.id, &sigma, &engine.cache, progress)?;
        let simulator = engine.simulator.clone();
        Ok(Some(Mosaic { specimen, recipe, simulator, library, kernel, survey, simulated }))
    }

    /// What making the mosaic of a field will take.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn outlook(
        engine: &MosaicEngine,
        specimen: &dyn Specimen,
        recipe: &Recipe,
    ) -> Result<Outlook> {
        let settings = engine.simulator.settings();
        let survey = survey(specimen, &recipe.field);
        let library = Library::new(specimen, survey.families.iter().copied(), settings)?;
        let sigma = |number| recipe.phonons.sigma_angstrom(number);
        let missing = library.missing(&recipe.id, &sigma, &engine.cache);
        Ok(Outlook {
            pays: engine.always || worth(&library, &survey, recipe),
            images: library.len(),
            missing: missing.len(),
            missing_probes: missing.iter().sum(),
            columns: survey.tagged,
            unique_columns: survey.untagged,
            image_bytes: library.image_bytes(),
            plan: library.largest_plan()?,
        })
    }

    /// Simulates the pixels [row, column, rows, columns] of the full field with the atoms of the mosaic.
    fn direct(
        &self,
        block: Block,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        let [row, column, rows, columns] = block;
        let pixels = ([row, column], [rows, columns], 1);
        let (margin, thickness) = (self.simulator.margin_angstrom(), self.specimen.thickness_nm());
        let pixels = PixelBox::new(pixels, self.recipe.field.pixel_nm(), margin, thickness);
        let atoms = |configuration| self.atoms(&pixels.area, configuration);
        let mean = self.simulator.mean(&pixels, configurations, atoms, &Quiet(progress))?;
        Ok(mean.mapv(|v| v as f32))
    }
}

impl FieldImage for Mosaic<'_> {
    fn name(&self) -> &'static str {
        "mosaic"
    }

    fn parameters(&self) -> serde_json::Value {
        self.simulator.parameters()
    }

    fn library(&self) -> Option<[usize; 2]> {
        Some([self.library.len(), self.simulated])
    }

    fn mean_of(
        &self,
        first: [usize; 2],
        shape: [usize; 2],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let pixel = self.recipe.field.pixel_nm();
        let assembly = Assembly::new(self.specimen, first, shape, pixel);
        let seed = self.recipe.seed;
        let mut image = assembly.image(&self.library, &self.kernel, seed, configurations);
        let missing = assembly.missing();
        for (block, pixels) in blocks(&missing, first, shape) {
            let direct = self.direct(block, configurations, progress)?;
            for (pixel, weight) in pixels {
                let [row, column] = [pixel / shape[1], pixel % shape[1]];
                let at = [first[0] + row - block[0], first[1] + column - block[1]];
                image[[row, column]] += weight * f64::from(direct[at]);
            }
        }
        Ok(image)
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        let which = (self.recipe.seed, configuration);
        let phonons = &self.recipe.phonons;
        definite_atoms(self.specimen, Some(&self.library), area, which, phonons)
    }
}

/// What a mosaic will take.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Outlook {
    /// Whether it takes less than simulating the field itself.
    pub pays: bool,
    /// Images of sheets.
    pub images: usize,
    /// Those that the cache lacks.
    pub missing: usize,
    /// Probes that they take.
    pub missing_probes: usize,
    /// Columns with a place in the library.
    pub columns: u64,
    /// Columns that are simulated where they lie.
    pub unique_columns: u64,
    /// Memory of the library's images.
    pub image_bytes: u64,
    /// Plan of the largest image.
    #[serde(skip)]
    pub plan: Option<PlannedScan>,
}

/// Whether the library takes clearly fewer probes than the field.
fn worth(library: &Library, survey: &Survey, recipe: &Recipe) -> bool {
    let [rows, columns] = recipe.field.pixels(recipe.field.built_grid());
    let all = (survey.tagged + survey.untagged).max(1) as f64;
    let repeating = (rows * columns * library.configurations()) as f64 * survey.tagged as f64 / all;
    survey.tagged > 0 && (library.probes() as f64) < WORTH * repeating
}

/// The atoms of an area, displaced as by engines that simulate the field itself.
pub fn atoms_by_seed(
    specimen: &dyn Specimen,
    area: &Region,
    which: (u64, usize),
    recipe: &Recipe,
) -> DisplacedAtoms {
    definite_atoms(specimen, None, area, which, &recipe.phonons)
}

type Block = [usize; 4];

/// Gathers pixels into the least rectangles [row, column, rows, columns] within blocks of the full field.
fn blocks(
    missing: &std::collections::HashMap<usize, f64>,
    first: [usize; 2],
    shape: [usize; 2],
) -> Vec<(Block, Vec<(usize, f64)>)> {
    let mut by_block: BTreeMap<[usize; 2], Vec<(usize, f64)>> = BTreeMap::new();
    for (&pixel, &weight) in missing {
        let at = [first[0] + pixel / shape[1], first[1] + pixel % shape[1]];
        by_block.entry(at.map(|v| v / BLOCK_PX)).or_default().push((pixel, weight));
    }
    let rectangle = |pixels: &Vec<(usize, f64)>| {
        let range = |of: &dyn Fn(usize) -> usize| {
            let low = pixels.iter().map(|p| of(p.0)).min().unwrap_or(0);
            let high = pixels.iter().map(|p| of(p.0)).max().unwrap_or(0);
            [low, high - low + 1]
        };
        let rows = range(&|p| first[0] + p / shape[1]);
        let columns = range(&|p| first[1] + p % shape[1]);
        [rows[0], columns[0], rows[1], columns[1]]
    };
    by_block.into_values().map(|pixels| (rectangle(&pixels), pixels)).collect()
}
