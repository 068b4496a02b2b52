//! `stemgen build`.

use super::build_plan::{DryRun, Request};
use super::common::Common;
use super::hints::hinted;
use super::plan_report::Lines;
use super::progress_bar::Reporter;
use super::recipe_args::RecipeArgs;
use super::values::{self, EngineName as Engine};
use super::{imaging_args, output, pictures, text};
use anyhow::bail;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::engine::{Algorithm, Expansion};
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::world::audit::{Audit, AuditOptions};
use stemgen::world::method::Check;
use stemgen::world::mosaic::{Cache, MosaicEngine};
use stemgen::world::recipe::StructureKind;
use stemgen::world::simulator::{WINDOW_ANGSTROM, default_window};
use stemgen::world::{BuildOptions, Difficulty, Recipe, Simulator, SubTileEngine, Summary};

/// Sub-tiles in nm; 4 nm take below 2 GB of memory on two threads.
const SUBTILE_NM: f64 = 4.0;
/// Sub-tiles of PRISM in nm, whose plane waves take the memory.
const PRISM_SUBTILE_NM: f64 = 2.5;
/// Sub-tiles of the published worlds in nm.
const PUBLISHED_SUBTILE_NM: f64 = 7.0;
/// Edge of audited regions in nm.
const AUDIT_NM: f64 = 0.8;
/// Configurations that audits of particles average at most: slices are thin there, and multislice of sixteen would take a
/// quarter of the time of the world. The mean of more is nearer to the exact one.
const PARTICLE_AUDIT_CONFIGURATIONS: usize = 4;
/// Sub-tiles of mosaics in nm, and their overlap.
const MOSAIC_SUBTILE_NM: f64 = 8.0;
const MOSAIC_OVERLAP_NM: f64 = 0.5;
/// Interpolation of PRISM unless another is asked for: windows of 10 A in sub-tiles of 2.5 nm.
const INTERPOLATION: [usize; 2] = [4, 4];

const EXAMPLES: &str = "\
Examples:
  The central 2 x 2 tiles of the easy SrTiO3 world, with a picture beside:
    stemgen build srtio3 --difficulty easy --grid 2x2
  What would the whole world take?
    stemgen build srtio3 --difficulty hard --dry-run
  Another specimen of the same kind, and the noiseless image with it:
    stemgen build srtio3 --difficulty medium --grid 4x4 --seed 7 --keep-clean -o seven.h5
  From a recipe of your own, with the settings of the published worlds:
    stemgen build --recipe mine.toml --difficulty easy --profile published

Finished sub-tiles are kept in FILE.work until the world is complete: after Ctrl-C or a power
failure the same command goes on from there.";

/// Build a world: a whole annotated specimen and its image
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Build {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Leave out the Poisson noise
    #[arg(long)]
    no_noise: bool,
    /// Also store the noiseless tiles
    #[arg(long)]
    keep_clean: bool,
    #[command(flatten)]
    method: Method,
    /// File to write [default: worlds/MATERIAL_TIER[_RxC].h5]
    #[arg(short, long, value_name = "FILE.h5", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    /// Leave out the picture
    #[arg(long, help_heading = "Results")]
    no_png: bool,
    #[command(flatten)]
    common: Common,
}

/// How it is simulated.
#[derive(Debug, Args)]
#[command(next_help_heading = "Method")]
struct Method {
    /// How images are made [default: mosaic, or window where a field is too small for it to pay]
    #[arg(long, value_name = "NAME", conflicts_with = "profile")]
    engine: Option<Engine>,
    /// Width of the window that follows each probe, in A [default: 7.8]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["interpolation", "profile"])]
    window: Option<f64>,
    /// Take the narrowest window whose error is at most so many per cent of the mean image (rms): 3.3, 0.8
    /// or 0.4 and above
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["window", "interpolation", "profile"])]
    accuracy: Option<f64>,
    /// Windows and mosaics: expand probes that share a window in fewer waves, each right to so many per cent of its
    /// amplitude. `off` propagates every probe; `auto`: 1 % in 7.8 A, less in wider windows
    #[arg(long, value_name = "PERCENT|off|auto", default_value = "auto", value_parser = values::expansion)]
    #[arg(allow_negative_numbers = true, conflicts_with_all = ["interpolation", "profile"])]
    expansion: Expansion,
    /// PRISM interpolation factor, or one for x and one for y [default: 4]
    #[arg(long, value_name = "F[,FY]", value_parser = values::factors, conflicts_with = "profile")]
    interpolation: Option<[usize; 2]>,
    /// `published`: the coarser settings of the published worlds (PRISM, 0.05 A, slices of 1 A)
    /// [default: default]
    #[arg(long, value_name = "NAME")]
    profile: Option<Profile>,
    /// Regions of a mosaic that are simulated exactly beforehand, with the same atoms; the file tells the
    /// error found. 0 leaves it out
    #[arg(long, value_name = "N", default_value_t = 1)]
    #[arg(value_parser = clap::value_parser!(u16).range(0..=1000))]
    audit: u16,
    /// Widen the windows, or leave the mosaic, until the audit's errors (rms at bright columns, and over all
    /// pixels of the brightest column) are at most so many per cent
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["profile", "interpolation"])]
    max_error: Option<f64>,
    /// Neither read nor keep the mosaic's simulations in the cache (see `stemgen cache`)
    #[arg(long)]
    no_cache: bool,
    /// Largest width of a sub-tile, which is simulated at once, in nm [default: mosaic: 8; window,
    /// multislice: 4; prism: 2.5; published: 7]
    #[arg(long, value_name = "NM", value_parser = values::finite, allow_negative_numbers = true)]
    subtile: Option<f64>,
    /// Overlap of sub-tiles in nm [default: a quarter of the sub-tile, at most 1]
    #[arg(long, value_name = "NM", value_parser = values::finite, allow_negative_numbers = true)]
    subtile_overlap: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Profile {
    /// Carries all scattering to the detector
    Default,
    /// As the published STEMGym worlds
    Published,
}

#[derive(Serialize)]
struct Built {
    output: PathBuf,
    file_bytes: u64,
    picture: Option<PathBuf>,
    material: String,
    difficulty: Option<Difficulty>,
    seed: u64,
    tiles: [usize; 2],
    pixels: [usize; 2],
    fov_nm: [f64; 2],
    sites: u64,
    vacancies: u64,
    substitutions: u64,
    columns: u64,
    grain_boundaries: usize,
    phase_boundaries: usize,
    dose_electrons_per_angstrom2: Option<f64>,
    engine: String,
    library: Option<[usize; 2]>,
    audit: Option<Audit>,
    subtiles: usize,
    subtiles_resumed: usize,
    wall_time_s: f64,
}

impl Build {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let recipe = self.recipe.resolve()?;
        let (simulator, warning) = self.simulator(&recipe)?;
        warning.iter().for_each(|w| reporter.warn(w));
        let path = self.output(&recipe);
        let look = self.common.dry_run && self.is_mosaic(&simulator);
        let report = DryRun::new(Request {
            recipe: &recipe,
            simulator: &simulator,
            mosaic: look.then(|| self.mosaic(simulator.clone())),
            subtile_nm: self.subtile_nm(&simulator),
            timed: self.common.dry_run,
            keep_clean: self.keep_clean,
            output: path.clone(),
        })?;
        if self.common.dry_run {
            return self.common.print(&report, &report.text());
        }
        output::check(&path, self.overwrite)?;
        let picture = (!self.no_png).then(|| path.with_extension("png"));
        if let Some(picture) = &picture {
            output::check(picture, self.overwrite)?;
        }
        report.warnings().iter().for_each(|w| reporter.warn(w));
        let engine = self.engine(simulator.clone());
        let summary = self.build(&recipe, &*engine, &simulator, &path, &reporter)?;
        let world = WorldFile::open(&path)?;
        if let Some(picture) = &picture {
            pictures::write_world(picture, &world)?;
        }
        let built = self.built(&recipe, &summary, &world, picture)?;
        self.common.print(&built, &built.text())
    }

    fn published(&self) -> bool {
        self.method.profile == Some(Profile::Published)
    }

    /// The engine, and what is to be said of its accuracy.
    fn simulator(&self, recipe: &Recipe) -> anyhow::Result<(Simulator, Option<String>)> {
        if self.published() {
            return Ok((Simulator::published(recipe), None));
        }
        let (simulator, warning) = self.exact(recipe)?;
        Ok((simulator.with_expansion(self.method.expansion), warning))
    }

    /// As [`Build::simulator`], for the profile that carries all scattering to the detector.
    fn exact(&self, recipe: &Recipe) -> anyhow::Result<(Simulator, Option<String>)> {
        let m = &self.method;
        let (window, factors) = (m.window, m.interpolation);
        imaging_args::check_accuracy(m.accuracy, m.engine)?;
        let algorithm = imaging_args::algorithm(
            m.engine,
            window,
            factors,
            Engine::Window,
            WINDOW_ANGSTROM,
            INTERPOLATION,
        )?;
        let free = m.engine.is_none() && window.is_none() && factors.is_none();
        if free && m.accuracy.is_none() {
            return Ok(by_rule(recipe));
        }
        let mut settings = Simulator::new(recipe, algorithm).settings().clone();
        let thickness = recipe.field.thickness_nm * 10.0;
        let warning = imaging_args::choose_window(m.accuracy, &mut settings, thickness)?;
        Ok((Simulator::new(recipe, settings.algorithm), warning))
    }

    fn output(&self, recipe: &Recipe) -> PathBuf {
        let default = || Path::new("worlds").join(self.recipe.stem(recipe) + ".h5");
        self.output.clone().unwrap_or_else(default)
    }

    /// Width and overlap of sub-tiles.
    fn subtile_nm(&self, simulator: &Simulator) -> [f64; 2] {
        let default = match simulator.settings().algorithm {
            _ if self.published() => PUBLISHED_SUBTILE_NM,
            _ if self.is_mosaic(simulator) => MOSAIC_SUBTILE_NM,
            Algorithm::Prism { .. } => PRISM_SUBTILE_NM,
            _ => SUBTILE_NM,
        };
        let size = self.method.subtile.unwrap_or(default);
        let most = if self.is_mosaic(simulator) { MOSAIC_OVERLAP_NM } else { 1.0 };
        [size, self.method.subtile_overlap.unwrap_or((0.25 * size).clamp(0.0, most))]
    }

    /// Whether units that repeat share simulations.
    fn is_mosaic(&self, simulator: &Simulator) -> bool {
        let windows = matches!(simulator.settings().algorithm, Algorithm::Window { .. });
        let implied = windows && !self.published();
        self.method.engine.map_or(implied, |e| e == Engine::Mosaic)
    }

    /// How a mosaic is checked before the world is made of it.
    fn check(&self, recipe: &Recipe, simulator: &Simulator) -> anyhow::Result<Check> {
        let regions = usize::from(self.method.audit);
        if self.method.max_error.is_some() && !self.is_mosaic(simulator) {
            bail!("--max-error is for mosaics; leave out --engine, or see `stemgen audit`");
        }
        if self.method.max_error.is_some() && regions == 0 {
            bail!("--max-error needs an audit; leave out --audit 0");
        }
        let thin = recipe.structure == StructureKind::Particles;
        let configurations = thin.then_some(PARTICLE_AUDIT_CONFIGURATIONS);
        let audit =
            AuditOptions { regions, size_nm: AUDIT_NM, configurations, ..AuditOptions::default() };
        let max_error_percent = self.method.max_error;
        Ok(Check { audit: (regions > 0).then_some(audit), max_error_percent })
    }

    fn engine(&self, simulator: Simulator) -> Box<dyn SubTileEngine> {
        if !self.is_mosaic(&simulator) {
            return Box::new(simulator);
        }
        Box::new(self.mosaic(simulator))
    }

    fn mosaic(&self, simulator: Simulator) -> MosaicEngine {
        let cache = if self.method.no_cache { Cache::none() } else { Cache::of_user() };
        let always = self.method.engine == Some(Engine::Mosaic);
        MosaicEngine { simulator, cache, always }
    }

    fn build(
        &self,
        recipe: &Recipe,
        engine: &dyn SubTileEngine,
        simulator: &Simulator,
        path: &Path,
        reporter: &Reporter,
    ) -> anyhow::Result<Summary> {
        let [subtile_nm, subtile_overlap_nm] = self.subtile_nm(simulator);
        let options = BuildOptions {
            noise: !self.no_noise,
            keep_clean: self.keep_clean,
            overwrite: self.overwrite,
            subtile_nm,
            subtile_overlap_nm,
            check: self.check(recipe, simulator)?,
        };
        let done = stemgen::world::build(recipe, engine, path, &options, reporter);
        done.map_err(|error| match error {
            stemgen::Error::Interrupted => {
                let kept = format!(
                    "{}.work keeps the finished sub-tiles; the same command goes on from there",
                    path.display()
                );
                hinted(error, kept)
            }
            other => other.into(),
        })
    }

    fn built(
        &self,
        recipe: &Recipe,
        summary: &Summary,
        world: &WorldFile,
        picture: Option<PathBuf>,
    ) -> anyhow::Result<Built> {
        let dose = recipe.dose.electrons_per_angstrom2;
        Ok(Built {
            output: summary.path.clone(),
            file_bytes: output::size(&summary.path),
            picture,
            material: recipe.id.clone(),
            difficulty: recipe.tier,
            seed: recipe.seed,
            tiles: summary.grid,
            pixels: world.shape(),
            fov_nm: summary.fov_nm,
            sites: summary.counts.sites,
            vacancies: summary.counts.vacancies,
            substitutions: summary.counts.substitutions,
            columns: summary.counts.columns,
            grain_boundaries: world.boundaries()?.len(),
            phase_boundaries: world.phase_boundaries()?.len(),
            dose_electrons_per_angstrom2: (!self.no_noise).then_some(dose),
            engine: summary.engine.clone(),
            library: summary.library,
            audit: summary.audit.clone(),
            subtiles: summary.subtiles,
            subtiles_resumed: summary.subtiles_resumed,
            wall_time_s: summary.wall_time_s,
        })
    }
}

/// The engine where none is asked for: windows as wide as the specimen is thick, PRISM for detectors at low
/// angles, which windows and mosaics cannot do. And what is to be said of its accuracy.
fn by_rule(recipe: &Recipe) -> (Simulator, Option<String>) {
    match default_window(recipe) {
        Ok(choice) => {
            let width_angstrom = choice.width_angstrom;
            let warning = (!choice.beyond_measured.is_empty()).then(|| {
                format!(
                    "windows of {width_angstrom:.1} A: their error was not measured for {}; the audit tells it",
                    choice.beyond_measured.join(", ")
                )
            });
            (Simulator::new(recipe, Algorithm::Window { width_angstrom }), warning)
        }
        Err(why) => {
            let algorithm = Algorithm::Prism { interpolation: INTERPOLATION };
            let warning = format!("neither mosaic nor windows: {why}; PRISM is used");
            (Simulator::new(recipe, algorithm), Some(warning))
        }
    }
}

impl Built {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let tier = self.difficulty.map(|d| format!(", {}", d.name())).unwrap_or_default();
        lines.add("world", format!("{}{tier}, seed {}", self.material, self.seed));
        let ([rows, columns], [ny, nx], [h, w]) = (self.tiles, self.pixels, self.fov_nm);
        lines.add("tiles", format!("{rows} x {columns}: {ny} x {nx} pixels, {h:.2} x {w:.2} nm"));
        let found = [
            (self.vacancies, "vacancy", "vacancies"),
            (self.substitutions, "substitution", "substitutions"),
            (self.grain_boundaries as u64, "grain boundary", "grain boundaries"),
            (self.phase_boundaries as u64, "phase boundary", "phase boundaries"),
        ];
        let found = found.into_iter().filter(|(n, _, _)| *n > 0).map(|(n, one, many)| {
            format!(", {} {}", text::count(n), if n == 1 { one } else { many })
        });
        let [sites, columns] = [self.sites, self.columns].map(text::count);
        let found: String = found.collect();
        lines.add("holds", format!("{sites} sites in {columns} columns{found}"));
        lines.add(
            "dose",
            match self.dose_electrons_per_angstrom2 {
                Some(dose) => format!("{dose} electrons per square Angstrom"),
                None => "no noise".into(),
            },
        );
        let resumed = match self.subtiles_resumed {
            0 => String::new(),
            n => format!(", {n} of them from an earlier run"),
        };
        let plural = if self.subtiles == 1 { "sub-tile" } else { "sub-tiles" };
        lines.add("engine", format!("{}, {} {plural}{resumed}", self.engine, self.subtiles));
        if let Some([images, simulated]) = self.library {
            let images = text::count(images as u64);
            let simulated = text::count(simulated as u64);
            lines.add("library", format!("{images} images, {simulated} of them simulated now"));
        }
        if let Some(audit) = &self.audit {
            let found = format!(
                "{:.2} % rms at bright columns, {:.2} % over all pixels, against multislice of the same atoms",
                audit.bright_rms_percent, audit.all_rms_percent
            );
            lines.add("audit", found);
        }
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        if let Some(picture) = &self.picture {
            lines.add("picture", picture.display().to_string());
        }
        lines.text()
    }
}
