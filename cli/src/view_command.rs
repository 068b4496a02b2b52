//! `stemgen view`.

use super::hdf5_check;
use super::picture_args::PictureArgs;
use super::progress_bar::Reporter;
use super::recipe_args::is_recipe_file;
use super::values::{self, Tier};
use super::view_images::{self, ViewedImage};
use super::view_patterns;
use super::{output, text};
use anyhow::{Context, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use stemgen::files::outputs::check_outputs;
use stemgen::io::{PatternFile, StoredImages, WorldFile};
use stemgen::recipe::{CheckedRecipe, Difficulty, Recipe};
use stemgen::render::WorldPart;
use stemgen::render::html::StoredPage;
use stemgen::world::draw_specimen;

const EXAMPLES: &str = "\
Examples:
  The whole field of a world:
    stemgen view worlds/srtio3_easy_1x1.h5
  A part of it, 2 nm wide, with every defect:
    stemgen view worlds/srtio3_easy_1x1.h5 --region 0.2,0.2,2.2,2.2 --overlay defects
  Phases and their boundaries over the noise-free image:
    stemgen view worlds/batio3_hard_4x4.h5 --clean --overlay phases --colormap inferno -o b.png
  The image of another detector:
    stemgen view worlds/srtio3_easy_1x1.h5 --detector ABF
  The specimen of a recipe, without a simulation:
    stemgen view srtio3 --difficulty easy --grid 2x2
  A recording, or an image of `stemgen simulate`:
    stemgen view tile.h5
  A page for the browser of a recording, a series of recordings, or images:
    stemgen view tile.h5 --html
  A page for the browser that zooms to single atoms and shows the ground truth of each:
    stemgen view worlds/srtio3_easy_1x1.h5 --html
  A page of diffraction patterns: move over the scan, draw detectors:
    stemgen view srtio3.emd --html

The page of a world is one file that needs no network. It shows overlays, the values and the column
under the pointer, and line profiles. Without --overlay it begins with defects, boundaries and
particles; if the world has none, with all columns.

x grows to the right and y down, from the centre of pixel (0, 0), as in the world's ground truth.";

/// Draw a world, image, recording or mean diffraction pattern as PNG, or write a page for the browser
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct View {
    /// World file, or file of `simulate`, `acquire`, `live` or `patterns`; or a recipe, by its name or its file (.toml), whose
    /// specimen is drawn
    #[arg(value_name = "FILE|RECIPE")]
    world: PathBuf,
    /// Tier of the recipe. Needed if the recipe has tiers
    #[arg(long, value_name = "TIER", help_heading = "Recipe")]
    difficulty: Option<Tier>,
    /// Draw only the central tiles of the recipe's field, rows x columns [default: the whole field]
    #[arg(long, value_name = "RxC", value_parser = values::rows_columns, help_heading = "Recipe")]
    grid: Option<[usize; 2]>,
    /// Detector of a world that has several, or image of a file of `simulate` [default: the first]
    #[arg(long, value_name = "NAME", help_heading = "Picture")]
    detector: Option<String>,
    /// Image of a stack of thicknesses, frames or recordings, from 0 [default: the last]
    #[arg(long, value_name = "NUMBER", help_heading = "Picture")]
    index: Option<usize>,
    /// Write a page (HTML) that needs no network, in place of a PNG. For a world, --region, --clean, --colormap, --contrast and
    /// --overlay set its first view
    #[arg(long, help_heading = "Picture")]
    html: bool,
    /// Draw only this part: left, upper, right and lower edge in nm [default: the whole field]
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = values::rectangle)]
    #[arg(allow_hyphen_values = true, help_heading = "Picture")]
    region: Option<[f64; 4]>,
    #[command(flatten)]
    picture: PictureArgs,
    /// File to write [default: name of FILE or RECIPE with the ending .view.png or .html]
    #[arg(short, long, value_name = "FILE", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    /// Print only errors
    #[arg(short, long, help_heading = "Running")]
    quiet: bool,
}

impl View {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        if let Some(recipe) = self.recipe()? {
            return self.draw_recipe(&recipe);
        }
        hdf5_check::check(&self.world)?;
        if let Some(images) = StoredImages::open(&self.world)? {
            return self.draw_image(&images);
        }
        if let Some(patterns) = PatternFile::open(&self.world)? {
            return self.draw_patterns(&patterns);
        }
        if self.index.is_some() {
            bail!("--index: a world is one image; leave it out");
        }
        let mut world = WorldFile::open(&self.world)?;
        if let Some(name) = &self.detector {
            world = world.on_detector(name)?;
        }
        let path = self.free_output()?;
        let part = WorldPart::of_region(&world, self.region)?;
        if self.html {
            return self.write_page(&world, &path);
        }
        let picture = part.picture(&self.picture.picture(), &world)?;
        picture.write_png(&path)?;
        let [h, w] = [&part.rows, &part.columns].map(|r| r.len() as f64 * part.pixel_nm);
        self.tell(&format!("{}: {w:.2} x {h:.2} nm", path.display()))
    }

    /// Returns the recipe that is named in place of a file.
    fn recipe(&self) -> anyhow::Result<Option<CheckedRecipe>> {
        let name = self.world.to_string_lossy();
        let tier = self.difficulty.map(Difficulty::from);
        let recipe = match is_recipe_file(&name) {
            true => Recipe::from_file(&self.world, tier)?,
            false if Recipe::built_in().any(|known| known == name) => Recipe::load(&name, tier)?,
            false if tier.is_some() || self.grid.is_some() => {
                bail!("{name}: a world has its recipe; leave out --difficulty and --grid")
            }
            false => return Ok(None),
        };
        let recipe = match self.grid {
            Some([rows, columns]) => recipe.with_grid(rows, columns)?,
            None => recipe,
        };
        Ok(Some(recipe.checked()?))
    }

    /// Draws the specimen of a recipe with its ground truth.
    fn draw_recipe(&self, recipe: &CheckedRecipe) -> anyhow::Result<()> {
        if self.html
            || self.region.is_some()
            || self.picture.clean
            || self.detector.is_some()
            || self.index.is_some()
        {
            bail!(
                "{}: is a recipe, whose whole specimen is drawn; leave out --html, --region, --clean, --detector and --index, or build the world for --html, --region, --clean and --detector",
                self.world.display()
            );
        }
        let usual = || PathBuf::from(format!("{}.view.png", recipe.id));
        let path = self.output.clone().unwrap_or_else(usual);
        check_outputs([&path], [&self.world], self.overwrite)?;
        draw_specimen(recipe, &path, &Reporter::new(self.quiet))?;
        self.tell(&path.display().to_string())
    }

    /// Draws a simulated image or a recording.
    fn draw_image(&self, images: &StoredImages) -> anyhow::Result<()> {
        if self.region.is_some() || !self.picture.overlay.is_empty() {
            bail!("{}: is no world; leave out --region and --overlay", self.world.display());
        }
        let path = self.free_output()?;
        if self.html {
            if self.picture.clean {
                bail!("--clean: the page has the noise-free image too; leave it out");
            }
            let page =
                StoredPage { title: self.title(), name: self.detector.clone(), index: self.index };
            page.page(images)?.write(&path)?;
            return self.tell_page(&path);
        }
        let choice = ViewedImage { name: self.detector.as_deref(), index: self.index };
        let (picture, what) = view_images::picture(images, &choice, &self.picture.picture())?;
        picture.write_png(&path)?;
        self.tell(&format!("{}: {what}", path.display()))
    }

    /// Draws the mean of diffraction patterns, or writes a page of all patterns.
    fn draw_patterns(&self, patterns: &PatternFile) -> anyhow::Result<()> {
        let picture = &self.picture;
        if self.region.is_some()
            || self.detector.is_some()
            || self.index.is_some()
            || picture.clean
            || !picture.overlay.is_empty()
        {
            bail!(
                "{}: holds diffraction patterns; leave out --region, --detector, --index, --clean and --overlay (`stemgen integrate` computes images of detectors)",
                self.world.display()
            );
        }
        let path = self.free_output()?;
        let reporter = Reporter::new(self.quiet);
        let file = || self.world.display().to_string();
        if self.html {
            view_patterns::page(patterns, self.title(), &reporter)
                .with_context(file)?
                .write(&path)?;
            return self.tell_page(&path);
        }
        let (drawn, what) =
            view_patterns::picture(patterns, &picture.picture(), &reporter).with_context(file)?;
        drawn.write_png(&path)?;
        self.tell(&format!("{}: {what}", path.display()))
    }

    /// Returns the file to write, after checking that it may be written.
    fn free_output(&self) -> anyhow::Result<PathBuf> {
        let ending = if self.html { "html" } else { "view.png" };
        let path = self.output.clone().unwrap_or_else(|| self.world.with_extension(ending));
        check_outputs([&path], [&self.world], self.overwrite)?;
        Ok(path)
    }

    /// Returns the title of a page.
    fn title(&self) -> String {
        self.world.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn tell_page(&self, path: &Path) -> anyhow::Result<()> {
        let size = text::bytes(output::size(path));
        self.tell(&format!("{} ({size}); open it in a browser", path.display()))
    }

    fn tell(&self, line: &str) -> anyhow::Result<()> {
        if self.quiet { Ok(()) } else { text::print(line) }
    }

    fn write_page(&self, world: &WorldFile, path: &Path) -> anyhow::Result<()> {
        self.picture.picture().page(world, self.title(), self.region)?.write(path)?;
        self.tell_page(path)
    }
}
