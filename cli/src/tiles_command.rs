//! `stemgen tiles`.

use super::common::{CacheArgs, Common};
use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::recipe_args::RecipeArgs;
use super::{image_plan_text, output, text, values};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::files::outputs::check_outputs;
use stemgen::imaging::OneDetector;
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::replay::stored_training_set;
use stemgen::specimen::specimen;
use stemgen::world::{
    ImagePlan, TrainingOptions, TrainingSet, imaging_of, training_set, write_training_set,
};

const EXAMPLES: &str = "\
Examples:
  200 tiles of a world at random places, with random doses:
    stemgen tiles worlds/srtio3_easy_2x2.h5 --random-dose 1e3,1e5 -n 200 -o train.npz
  200 tiles of a recipe; no world is built:
    stemgen tiles srtio3 --difficulty easy --grid 4x4 -n 200 --random-dose 1e3,1e5 -o train.npz
  Read the tiles in Python:
    import numpy as np
    train = np.load(\"train.npz\")
    train[\"images\"], train[\"heat_maps\"], train[\"class_masks\"]    # each (200, 128, 128)
    train[\"columns\"][\"x_px\"]                                     # of all columns of all tiles

Arrays of the file, [tile, row, column] unless noted:
  images: with noise, in fractions of the beam
  clean: without noise
  heat_maps: Gaussians of height 1 at columns
  class_masks: 0 background, 1 pristine column, 2 vacancies, 3 substitutions, 4 both
  phase_masks: number of the phase
  dose, pixel_nm, angle_deg, centre_nm (x, y in the full field), index, source: [tile]
  recipes: TOML, by source
  columns: one record for each column: sample, x_px, y_px, class, number (of the heaviest
    atom), occupancy, sites, vacancies, substitutions
stemworlds.export writes files of this layout.

The noise-free image is simulated from the recipe. Parts of it that the cache holds are reused.
A world without a recipe (`stemgen import`) gives tiles of its stored image: values from 0 to 1,
with the noise of the recording, and without clean and dose.";

/// Write labelled tiles from random places of a world or recipe, for training (NumPy .npz)
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Tiles {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Number of tiles
    #[arg(short = 'n', long, value_name = "N", default_value_t = 100, help_heading = "Tiles")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    number: u32,
    /// Edge of a tile in pixels
    #[arg(long, value_name = "PX", default_value_t = 128, help_heading = "Tiles")]
    size: usize,
    /// Range of the dose in electrons per square Angstrom. Each tile gets a random dose, uniform in its logarithm [default: the
    /// dose of the recipe]
    #[arg(long, value_name = "LOW,HIGH", value_parser = values::point, help_heading = "Tiles")]
    random_dose: Option<[f64; 2]>,
    /// Detector, if the world or recipe has several [default: the first]
    #[arg(long, value_name = "NAME", help_heading = "Tiles")]
    detector: Option<String>,
    /// Standard deviation of a column's Gaussian in the heat maps, in pixels
    #[arg(long, value_name = "PX", default_value_t = 2.0, value_parser = values::positive)]
    #[arg(help_heading = "Tiles")]
    heat_sigma: f64,
    /// Seed of places, doses and noise
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Tiles")]
    tile_seed: u64,
    #[command(flatten)]
    kept: CacheArgs,
    /// File to write
    #[arg(short, long, value_name = "FILE.npz", help_heading = "Results")]
    output: PathBuf,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct TilesSummary {
    output: PathBuf,
    file_bytes: u64,
    tiles: usize,
    size_px: usize,
    pixel_angstrom: f64,
    dose_electrons_per_angstrom2: Option<[f64; 2]>,
    columns: usize,
    phases: Vec<String>,
    wall_time_s: f64,
}

/// The plan of tiles.
#[derive(Serialize)]
struct TilesPlan {
    tiles: usize,
    size_px: usize,
    /// `null` if tiles are cut from a stored image.
    image: Option<ImagePlan>,
    output: PathBuf,
}

impl Tiles {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let begun = Instant::now();
        let reporter = self.common.start()?;
        if !self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) {
            let name = self.output.with_extension("npz");
            bail!("--output {}: did you mean {}?", self.output.display(), name.display());
        }
        if let Some(world) = self.recipe.world_without_recipe()? {
            return self.cut(&world, begun, &reporter);
        }
        let (recipe, made) = self.recipe.resolve_or_world()?;
        if !self.common.dry_run {
            check_outputs([&self.output], self.recipe.inputs(&recipe), self.overwrite)?;
        }
        let dose = recipe.dose.electrons_per_angstrom2;
        let options = self.options(self.random_dose.unwrap_or([dose; 2]));
        let cache = self.kept.cache();
        let specimen = specimen(&recipe)?;
        let mut imager = imaging_of(&recipe, made.as_ref(), cache)?.imager(&recipe, &specimen)?;
        if let Some(name) = &self.detector {
            imager = Box::new(OneDetector::named(name, &recipe, imager)?);
        }
        let shape = recipe.field.pixels(recipe.field.built_grid());
        options.crowding(shape).iter().for_each(|warning| reporter.warn(warning));
        if self.common.dry_run {
            let image = ImagePlan::new(&*imager, [self.size; 2], self.number as usize)?;
            return self.planned(Some(image));
        }
        imager.prepare(&reporter)?;
        let set = training_set(&recipe, &*specimen, &*imager, &options, &reporter)?;
        let made_of = (Some(options.dose), Some(recipe.to_toml()));
        self.finish(&set, made_of, specimen.facts().phases.clone(), begun)
    }

    /// Cuts tiles, with their noise, from the stored image of a world without a recipe, such as a recorded image.
    fn cut(&self, world: &WorldFile, begun: Instant, reporter: &Reporter) -> anyhow::Result<()> {
        let path = world.path();
        if self.random_dose.is_some() {
            bail!(
                "{}: its stored image has noise, and no other dose can be drawn; leave out --random-dose",
                path.display()
            );
        }
        let world = match &self.detector {
            Some(name) => world.on_detector(name)?,
            None => WorldFile::open(path)?,
        };
        let options = self.options([1.0; 2]);
        options.crowding(world.shape()).iter().for_each(|warning| reporter.warn(warning));
        if self.common.dry_run {
            return self.planned(None);
        }
        check_outputs([&self.output], [path], self.overwrite)?;
        let set = stored_training_set(&world, &options, reporter)?;
        self.finish(&set, (None, None), world.phase_names()?, begun)
    }

    /// Prints the plan of the tiles. Tiles of a stored image need no simulation.
    fn planned(&self, image: Option<ImagePlan>) -> anyhow::Result<()> {
        let plan = TilesPlan {
            tiles: self.number as usize,
            size_px: self.size,
            image,
            output: self.output.clone(),
        };
        let mut lines = Lines::default();
        let tiles = text::count(plan.tiles as u64);
        lines.add("tiles", format!("{tiles} of {0} x {0} pixels", plan.size_px));
        match &plan.image {
            Some(image) => image_plan_text::add(image, &mut lines),
            None => lines.add("image", "the stored one; nothing has to be simulated"),
        }
        image_plan_text::output(&plan.output, &mut lines);
        self.common.print(&plan, &lines.text())
    }

    fn options(&self, dose: [f64; 2]) -> TrainingOptions {
        TrainingOptions {
            tiles: self.number as usize,
            size_px: self.size,
            dose,
            sigma_px: self.heat_sigma,
            seed: self.tile_seed,
        }
    }

    /// Writes the tiles, and prints the summary. Tiles of a stored image have no dose and no noise-free images.
    fn finish(
        &self,
        set: &TrainingSet,
        (dose, recipe): (Option<[f64; 2]>, Option<String>),
        phases: Vec<String>,
        begun: Instant,
    ) -> anyhow::Result<()> {
        write_training_set(&self.output, self.overwrite, set, recipe.as_deref())?;
        let summary = TilesSummary {
            file_bytes: output::size(&self.output),
            output: self.output.clone(),
            tiles: self.number as usize,
            size_px: self.size,
            pixel_angstrom: set.pixel_angstrom,
            dose_electrons_per_angstrom2: dose,
            columns: set.columns.nrows(),
            phases,
            wall_time_s: begun.elapsed().as_secs_f64(),
        };
        self.common.print(&summary, &summary.text())
    }
}

impl TilesSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let n = text::count(self.tiles as u64);
        let (size, pixel) = (self.size_px, self.pixel_angstrom);
        lines.add("tiles", format!("{n} of {size} x {size} pixels of {pixel:.4} A"));
        let dose = self.dose_electrons_per_angstrom2.map(|[low, high]| {
            let range = if low == high { format!("{low}") } else { format!("{low} to {high}") };
            format!("{range} electrons per square Angstrom")
        });
        lines.add("dose", dose.unwrap_or_else(|| "that of the stored image".into()));
        lines.add("columns", text::count(self.columns as u64));
        if !self.phases.is_empty() {
            let codes = self.phases.iter().enumerate().map(|(n, name)| format!("{n} {name}"));
            lines.add("phases", codes.collect::<Vec<_>>().join(", "));
        }
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        lines.text()
    }
}
