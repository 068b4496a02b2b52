//! `stemgen cache export`, `import`, `verify` and `fill`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::common::Common;
use super::plan_text::Lines;
use super::recipe_args::is_recipe_file;
use super::recipe_choice::{recipes, world_name};
use super::text;
use super::validate_command::DIFFERENT;
use super::values::{self, Tier};
use stemgen::files::Shard;
use stemgen::files::outputs::check_outputs;
use stemgen::imaging::library_archive::{ArchiveSummary, export, import};
use stemgen::imaging::{Cache, CacheFault, RecomputedImage};
use stemgen::progress::Progress;
use stemgen::recipe::{Difficulty, Recipe, StructureKind};
use stemgen::world::{BuildMethod, BuildOptions, WorldBuild};

const FILL_EXAMPLES: &str = "\
Examples:
  The library of all hard worlds of SrTiO3, for any seed:
    stemgen cache fill srtio3 --difficulty hard
  The libraries of all materials, on four machines that share the cache:
    stemgen cache fill --all --shard 0/4    # and 1/4, 2/4, 3/4";

const VERIFY_EXAMPLES: &str = "\
Examples:
  Check that every image is complete:
    stemgen cache verify
  Also simulate three random images again, and compare:
    stemgen cache verify srtio3 --difficulty hard --recompute 3 --seed 7

Exit code: 0 if all images are complete and equal, 3 if one is damaged or differs, 1 on errors.";

/// Write the cached simulations of one material, or of all, to one file for another machine
#[derive(Debug, Args)]
pub struct Export {
    /// Material whose simulations are written [default: all]
    #[arg(value_name = "MATERIAL")]
    material: Option<String>,
    /// File to write
    #[arg(short, long, value_name = "FILE.stemlib", help_heading = "Results")]
    output: PathBuf,
    /// Replace an existing file
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

/// Add the simulations of a file to the cache
#[derive(Debug, Args)]
pub struct Import {
    /// File written by `stemgen cache export`
    #[arg(value_name = "FILE.stemlib")]
    file: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Check the simulations in the cache and in the installed library for damage, or compare them with new ones
#[derive(Debug, Args)]
#[command(after_help = VERIFY_EXAMPLES)]
pub struct VerifyCache {
    /// Material whose simulations are checked, or with --recompute also your own recipe file [default: all]
    #[arg(value_name = "MATERIAL|RECIPE.toml")]
    material: Option<String>,
    /// Tier of the recipe, for --recompute [default: all tiers]
    #[arg(long, value_name = "TIER", requires = "recompute")]
    difficulty: Option<Tier>,
    /// Simulate N random images of the recipe of MATERIAL again, and compare them
    #[arg(long, value_name = "N", requires = "material", value_parser = clap::value_parser!(u16).range(1..))]
    recompute: Option<u16>,
    /// Seed of the random choice of images
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

/// Simulate the library of a recipe, the simulations that its worlds share, before any world is built
#[derive(Debug, Args)]
#[command(after_help = FILL_EXAMPLES)]
pub struct Fill {
    /// Materials of the program's recipes (`stemgen list` prints them)
    #[arg(value_name = "MATERIAL", required_unless_present = "all", conflicts_with = "all")]
    materials: Vec<String>,
    /// Simulate the libraries of all materials
    #[arg(long)]
    all: bool,
    /// Tier whose library is simulated [default: all tiers]
    #[arg(long, value_name = "TIER")]
    difficulty: Option<Tier>,
    /// Simulate part K (from 0) of N of each library, for several processes; `slurm` takes K and N from the Slurm job array
    #[arg(long, value_name = "K/N|slurm", value_parser = values::shard, help_heading = "Running")]
    shard: Option<Shard>,
    /// Also simulate the images that the installed library holds
    #[arg(long, help_heading = "Running")]
    no_library: bool,
    #[command(flatten)]
    common: Common,
}

impl Export {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let cache = Cache::of_user();
        super::cache_command::check_known(&cache, self.material.as_deref(), false)?;
        check_outputs([&self.output], cache.folder(), self.overwrite)?;
        if self.common.dry_run {
            return self
                .common
                .print(&self.output, &format!("{} would be written", self.output.display()));
        }
        let found = export(&cache, self.material.as_deref(), &self.output, &reporter)?;
        if found.added == 0 {
            reporter.warn(
                "the cache has no simulations of this version of the program, so the file holds none; `stemgen cache fill` makes them",
            );
        }
        let mut lines = holdings(&found);
        if found.outdated > 0 {
            lines.add(
                "left out",
                format!("{} images of other versions of the program", found.outdated),
            );
        }
        let size = text::bytes(found.archive_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        self.common.print(&found, &lines.text())
    }
}

impl Import {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        if self.common.dry_run {
            return self
                .common
                .print(&self.file, &format!("{} would be read", self.file.display()));
        }
        let found = import(&Cache::of_user(), &self.file, &reporter)?;
        let mut lines = holdings(&found);
        lines.add(
            "new",
            format!("{} images; the cache had the others", text::count(found.added as u64)),
        );
        self.common.print(&found, &lines.text())
    }
}

fn holdings(found: &ArchiveSummary) -> Lines {
    let mut lines = Lines::default();
    for h in &found.materials {
        let images = text::count(h.images as u64);
        lines.add(h.material.clone(), format!("{images} images, {}", text::bytes(h.bytes)));
    }
    lines
}

#[derive(Serialize)]
struct CacheVerification {
    sound: bool,
    images: usize,
    /// Number of images in the installed library, all of them complete.
    supplied: usize,
    damaged: Vec<CacheFault>,
    recomputed: Vec<RecomputedImage>,
}

impl VerifyCache {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if an image is damaged or differs.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        let cache = Cache::of_user();
        let again = self.recipes()?;
        // The cache lists the images of a recipe file below the id of the recipe, not below the name of the file.
        let material = again.first().map(|recipe| &recipe.id).or(self.material.as_ref());
        let material = material.map(String::as_str);
        super::cache_command::check_known(&cache, material, true)?;
        if self.common.dry_run {
            let folder = cache.folder().map(|f| f.display().to_string()).unwrap_or_default();
            self.common.print(&folder, &format!("{folder} would be read"))?;
            return Ok(0);
        }
        let (images, damaged) = cache.verify(material, &reporter)?;
        let supplied = match cache.supplied_library() {
            Some(library) => library.verified(&reporter)?.iter().map(|h| h.images).sum(),
            None => 0,
        };
        let mut recomputed = Vec::new();
        if let (Some(count), Some(material)) = (self.recompute, &self.material) {
            for recipe in again.iter().cloned() {
                // In a small field a library saves no time, so that the automatic choice would use none.
                let shares = recipe.structure != StructureKind::Particles;
                let method = if shares { BuildMethod::Mosaic } else { BuildMethod::Auto };
                let Some(library) = build_of(recipe, &cache, method)?.library()? else { continue };
                recomputed.extend(library.recomputed(usize::from(count), self.seed, &reporter)?);
            }
            if recomputed.is_empty() {
                let maker = match is_recipe_file(material) {
                    true => format!("stemgen build --recipe {material}"),
                    false => format!("stemgen cache fill {material}"),
                };
                anyhow::bail!(
                    "the cache holds no simulations of {material} that its worlds use; `{maker}` makes them"
                );
            }
        }
        let sound = damaged.is_empty() && recomputed.iter().all(RecomputedImage::agrees);
        let found = CacheVerification { sound, images, supplied, damaged, recomputed };
        self.common.print(&found, &found.text())?;
        Ok(if sound { 0 } else { DIFFERENT })
    }

    /// Returns the recipes whose images are simulated again: the recipes of a material, or of a file.
    fn recipes(&self) -> anyhow::Result<Vec<Recipe>> {
        let Some(name) = self.material.as_ref().filter(|_| self.recompute.is_some()) else {
            return Ok(Vec::new());
        };
        let tier = self.difficulty.map(Difficulty::from);
        if !is_recipe_file(name) {
            return recipes(std::slice::from_ref(name), tier);
        }
        let tiers = match tier {
            Some(tier) => vec![tier],
            None => Recipe::tiers_of_file(name.as_ref())?,
        };
        let tiers: Vec<Option<Difficulty>> = match tiers.is_empty() {
            true => vec![None],
            false => tiers.into_iter().map(Some).collect(),
        };
        tiers.into_iter().map(|tier| Ok(Recipe::from_file(name.as_ref(), tier)?)).collect()
    }
}

impl CacheVerification {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let whole = text::count((self.images - self.damaged.len()) as u64);
        lines.add("whole", format!("{whole} of {} images", text::count(self.images as u64)));
        if self.supplied > 0 {
            let all = text::count(self.supplied as u64);
            lines.add("library", format!("{all} images of the installed library, all whole"));
        }
        for fault in &self.damaged {
            lines.add(
                "DAMAGED",
                format!(
                    "{}: {}; remove it, and the next build simulates it again",
                    fault.path.display(),
                    fault.fault
                ),
            );
        }
        for image in &self.recomputed {
            let word = if image.agrees() { "agrees" } else { "DIFFERS" };
            let by = match image.difference {
                0.0 => "the same bytes".into(),
                difference => format!("{difference:.1e} of the brightest value"),
            };
            lines.add(word, format!("{}: {by}", image.key));
        }
        lines.text()
    }
}

#[derive(Serialize)]
struct Filled {
    world: String,
    images: usize,
    simulated: usize,
    /// Number of images that the parts of other processes still have to simulate.
    lacking: usize,
}

impl Fill {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let shard = self.shard.unwrap_or(Shard::WHOLE);
        let cache = Cache::of_user();
        let cache = if self.no_library { cache.without_supplied() } else { cache };
        let mut filled = Vec::new();
        for recipe in recipes(&self.materials, self.difficulty.map(Difficulty::from))? {
            let world = world_name(&recipe);
            let Some(library) = build_of(recipe, &cache, BuildMethod::Auto)?.library()? else {
                continue;
            };
            let cost = library.mosaic_cost();
            let (images, lacking) = (cost.images, cost.missing);
            if self.common.dry_run {
                filled.push(Filled { world, images, simulated: 0, lacking });
                continue;
            }
            let simulated = library.fill_part(shard, &reporter)?;
            let lacking = library.mosaic_cost().missing;
            filled.push(Filled { world, images, simulated, lacking });
        }
        if filled.is_empty() {
            reporter
                .warn("worlds of these recipes share no simulations, so the cache stays unchanged");
        }
        let mut lines = Lines::default();
        if filled.is_empty() {
            lines.add("filled", "nothing");
        }
        for f in &filled {
            let count = |n: usize| text::count(n as u64);
            let lacking = match f.lacking {
                0 => String::new(),
                n => format!(", {} are lacking", count(n)),
            };
            lines.add(
                f.world.clone(),
                format!(
                    "{} images, {} simulated now{lacking}",
                    count(f.images),
                    count(f.simulated)
                ),
            );
        }
        self.common.print(&filled, &lines.text())
    }
}

/// Returns the build of a world, with this cache.
fn build_of(recipe: Recipe, cache: &Cache, method: BuildMethod) -> stemgen::Result<WorldBuild> {
    let options = BuildOptions { cache: cache.clone(), method, ..BuildOptions::default() };
    WorldBuild::new(&recipe.checked()?, &options)
}
