//! `stemgen build`.

use super::acquire_command::AcquisitionName;
use super::audit_verdict;
use super::build_all;
use super::build_shard::ShardReport;
use super::common::{CacheArgs, Common, Force};
use super::hints::{self, hinted};
use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::recipe_args::RecipeArgs;
use super::values::{self, EngineName as Engine};
use super::world_plan_text;
use super::{output, text, world_hspy};
use clap::{Arg, Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::acquisition::{Acquisition, AcquisitionTable, Profile};
use stemgen::engine::Expansion;
use stemgen::files::Shard;
use stemgen::files::outputs::{check_outputs, work_folder};
use stemgen::imaging::Audit;
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::recipe::{CheckedRecipe, Difficulty, Recipe};
use stemgen::render::image_pictures;
use stemgen::world::footprint::PICTURE;
use stemgen::world::{
    BuildMethod, BuildOptions, BuildProfile, BuildSummary, Companion, WorldBuild, WorldPlan,
    remove_leftovers,
};

const EXAMPLES: &str = "\
Examples:
  The central 2 x 2 tiles of the easy SrTiO3 world, with a picture:
    stemgen build srtio3 --difficulty easy --grid 2x2
  Print time, memory and disk space of a whole world:
    stemgen build srtio3 --difficulty hard --dry-run
  A new specimen of this kind; the file also holds the noise-free image:
    stemgen build srtio3 --difficulty medium --grid 4x4 --seed 7 --keep-clean -o seven.h5
  One world in four parts, on machines that share a file system; then the world:
    stemgen build gan --difficulty hard --shard 0/4    # and 1/4, 2/4, 3/4
    stemgen build gan --difficulty hard
  Your own recipe, with the settings of the published worlds:
    stemgen build --recipe mine.toml --difficulty easy --profile published
  Your own atoms (extended XYZ with labels of defects and phases, CIF, POSCAR); print the plan:
    stemgen build atoms.xyz --dry-run

The cache and the folder FILE.work keep finished work (simulations of the library, the audit,
sub-tiles) until the world and its picture are complete. After Ctrl-C or a power failure, repeat the
command: it continues. `stemgen glossary` explains window, mosaic, library, sub-tile and audit.

Exit code: 0 if the world is written, 3 if it is written but its audit found an error above 5 % (or
above --max-error), 1 on errors.";

/// Build a world: one file with the image of a whole specimen and its ground truth
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES, mut_args(with_all))]
pub struct Build {
    #[command(flatten)]
    pub(super) recipe: RecipeArgs,
    /// Build the worlds of all recipes of the program, or of --materials, at --difficulty or at all tiers. Finished worlds are
    /// kept; --output names a folder
    #[arg(long, conflicts_with_all = ["material", "recipe", "hspy"], help_heading = "Recipe")]
    all: bool,
    /// With --all: build the worlds of these materials only
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', requires = "all")]
    #[arg(help_heading = "Recipe")]
    pub(super) materials: Vec<String>,
    /// Record the field in one scan with the errors of a microscope: drift, jitter, the detector. The tiles then hold this
    /// recording. Sets the profile of [acquisition] in the recipe (see `stemgen acquire --help`)
    #[arg(long, value_name = "NAME", conflicts_with = "no_noise", help_heading = "Image")]
    pub(super) acquisition: Option<AcquisitionName>,
    /// Leave out the Poisson noise
    #[arg(long, help_heading = "Image")]
    pub(super) no_noise: bool,
    /// Also store the noise-free tiles
    #[arg(long, help_heading = "Image")]
    pub(super) keep_clean: bool,
    #[command(flatten)]
    method: Method,
    /// File to write [default: worlds/MATERIAL_TIER[_RxC][_seedN].h5]
    #[arg(short, long, value_name = "FILE.h5", help_heading = "Results")]
    pub(super) output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    pub(super) overwrite: bool,
    /// Also write the whole image for HyperSpy (.hspy), beside the file, in fractions of the beam
    #[arg(long, help_heading = "Results")]
    hspy: bool,
    /// Write no picture
    #[arg(long, help_heading = "Results")]
    no_png: bool,
    /// Compute part K (from 0) of N of the world, for several processes or machines that share a file system; `slurm` takes K and
    /// N from the Slurm job array. The command without --shard then finds the parts and writes the world
    #[arg(long, value_name = "K/N|slurm", value_parser = values::shard, help_heading = "Running")]
    #[arg(conflicts_with_all = ["dry_run", "overwrite", "hspy", "max_error", "accuracy"])]
    pub(super) shard: Option<Shard>,
    #[command(flatten)]
    pub(super) common: Common,
    #[command(flatten)]
    force: Force,
}

/// Holds the options of the method.
#[derive(Debug, Args)]
#[command(next_help_heading = "Method")]
struct Method {
    /// How the image is computed [default: mosaic; window if the field is too small for a mosaic to save time]
    #[arg(long, value_name = "NAME", conflicts_with = "profile")]
    engine: Option<Engine>,
    /// Width in A of the window, the small box around each probe in which the probe is propagated [default: 7.8, wider for
    /// mistilt, defocus and bright-field detectors]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["interpolation", "profile"])]
    window: Option<f64>,
    /// Largest rms error of the audit, in per cent of the mean image. The program takes wider windows, then no mosaic, then the
    /// exact engine, until the error is at most this
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["window", "interpolation", "profile"])]
    accuracy: Option<f64>,
    /// In windows and mosaics: expand the probes that share a window in fewer waves, and propagate only these waves. The value is
    /// the error of each probe, in per cent of its amplitude. `auto` takes 1 % in 7.8 A and less in wider windows; `off`
    /// propagates every probe
    #[arg(long, value_name = "PERCENT|off|auto", default_value = "auto", value_parser = values::expansion)]
    #[arg(allow_negative_numbers = true, conflicts_with_all = ["interpolation", "profile"])]
    expansion: Expansion,
    /// Interpolation factor of PRISM, or one for x and one for y [default: 4]
    #[arg(long, value_name = "F[,FY]", value_parser = values::factors, conflicts_with = "profile")]
    interpolation: Option<[usize; 2]>,
    /// Set of engine settings. `published` has the coarser settings of the published worlds: PRISM, 0.05 A, slices of 1 A
    /// [default: default]
    #[arg(long, value_name = "NAME")]
    profile: Option<ProfileName>,
    /// Number of regions of the audit, which simulates them by multislice with the same atoms and stores the error in the file.
    /// 0 makes no audit; --accuracy and --max-error use at least four [default: 1 for films and mosaics, 0 for others and for
    /// mosaics of the library that is installed with the program, which was audited when it was made]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1000))]
    audit: Option<u16>,
    /// Largest error of the audit, in per cent: rms at bright columns (above 40 % of the brightest column), and rms over all pixels
    /// relative to the brightest column. The program takes wider windows, then no mosaic, then the exact engine, until both errors
    /// are at most this
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["profile", "interpolation"])]
    max_error: Option<f64>,
    #[command(flatten)]
    kept: CacheArgs,
    /// Largest width in nm of a sub-tile, a part of the field that is computed at once [default: mosaic: 8; window,
    /// multislice: 4; prism: 2.5; published: 7]
    #[arg(long, value_name = "NM", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(help_heading = "Method")]
    subtile: Option<f64>,
    /// Overlap of sub-tiles in nm [default: a quarter of the sub-tile, at most 1]
    #[arg(long, value_name = "NM", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(help_heading = "Method")]
    subtile_overlap: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ProfileName {
    /// Grids carry all scattering to the detector
    Default,
    /// Settings of the published STEMGym worlds
    Published,
}

#[derive(Serialize)]
pub struct Built {
    pub output: PathBuf,
    pub file_bytes: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    hspy: Option<PathBuf>,
    picture: Option<PathBuf>,
    material: String,
    difficulty: Option<Difficulty>,
    seed: u64,
    pub tiles: [usize; 2],
    pixels: [usize; 2],
    fov_nm: [f64; 2],
    pub sites: u64,
    vacancies: u64,
    substitutions: u64,
    columns: u64,
    grain_boundaries: usize,
    phase_boundaries: usize,
    dose_electrons_per_angstrom2: Option<f64>,
    acquisition: Option<Acquisition>,
    pub engine: String,
    library: Option<[usize; 2]>,
    pub audit: Option<Audit>,
    /// Whether the audit was left out because the errors of the installed library are known.
    audit_known: bool,
    subtiles: usize,
    subtiles_resumed: usize,
    pub wall_time_s: f64,
}

/// Makes MATERIAL optional with `--all`.
fn with_all(argument: Arg) -> Arg {
    match argument.get_id() == "material" {
        true => argument.required_unless_present("all"),
        false => argument,
    }
}

impl Build {
    /// Runs the subcommand; the exit code is not 0 if the audit found an error above the limit.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        if self.all {
            return build_all::run(&self, &reporter);
        }
        let recipe = self.recorded(self.recipe.resolve()?)?;
        let build = WorldBuild::new(&recipe, &self.options())?;
        let path = self.output(&recipe);
        if self.common.dry_run {
            build.warnings()?.iter().for_each(|w| reporter.warn(w));
            stemgen::simulation::check_hdf5_name(&path)?;
            let report = WorldPlan::new(&recipe, &build, path)?;
            if reporter.interrupted() {
                return Err(stemgen::Error::Interrupted.into());
            }
            self.common.print(&report, &world_plan_text::text_of(&report))?;
            return Ok(0);
        }
        if let Some(shard) = self.shard {
            let part = self.part((&recipe, build), &path, shard, &reporter)?;
            self.common.print(&part, &part.text())?;
            return Ok(0);
        }
        let built = self.make((&recipe, build), &path, &reporter)?;
        self.common.print(&built, &built.text())?;
        Ok(self.verdict(&built))
    }

    /// Warns if the audit found an error above the limit; returns the exit code.
    pub fn verdict(&self, built: &Built) -> u8 {
        let subject = built.output.display().to_string();
        let limit = self.method.max_error;
        built.audit.as_ref().map_or(0, |audit| audit_verdict::exit_code(&subject, audit, limit))
    }

    /// Computes a part of a world.
    pub fn part(
        &self,
        (recipe, build): (&CheckedRecipe, WorldBuild),
        path: &Path,
        shard: Shard,
        reporter: &Reporter,
    ) -> anyhow::Result<ShardReport> {
        stemgen::simulation::check_hdf5_name(path)?;
        check_outputs([path], self.recipe.files(recipe), false)
            .inspect_err(|_| remove_leftovers(path))?;
        build.warnings()?.iter().for_each(|w| reporter.warn(w));
        self.check_memory(&build, reporter)?;
        ShardReport::of(build, path, shard, reporter).map_err(|e| with_what_is_kept(e, path))
    }

    /// Makes a world and the files beside it.
    pub fn make(
        &self,
        (recipe, build): (&CheckedRecipe, WorldBuild),
        path: &Path,
        reporter: &Reporter,
    ) -> anyhow::Result<Built> {
        let picture = (!self.no_png).then(|| path.with_extension("png"));
        let hspy = self.hspy.then(|| path.with_extension("hspy"));
        let outputs = [Some(path), picture.as_deref(), hspy.as_deref()].into_iter().flatten();
        let complete = build.is_complete(path);
        check_outputs(outputs, self.recipe.files(recipe), self.overwrite || complete)
            .inspect_err(|_| remove_leftovers(path))?;
        stemgen::simulation::check_hdf5_name(path)?;
        let draw = picture.as_deref().map(|path| Companion {
            path,
            most_bytes: PICTURE,
            write: &image_pictures::write_world,
        });
        let shape = recipe.field.pixels(recipe.field.built_grid());
        let images = recipe.detector.count() * if self.options().keep_clean { 2 } else { 1 };
        let place = hspy.clone().unwrap_or_default();
        let signals =
            |world: &WorldFile, path: &Path| world_hspy::write_world((path, &place), world, recipe);
        let signals = hspy.as_deref().map(|path| Companion {
            path,
            most_bytes: world_hspy::most_bytes(shape, images),
            write: &signals,
        });
        let companions: Vec<Companion> = draw.into_iter().chain(signals).collect();
        if !complete {
            // The disk is checked first: the warnings may look at the whole field.
            build.check_disk(path, &companions)?;
            let warnings = build.warnings()?.into_iter().chain(WorldPlan::warnings(&build)?);
            warnings.for_each(|w| reporter.warn(&w));
            self.check_memory(&build, reporter)?;
        }
        let summary =
            build.run_with(path, &companions, reporter).map_err(|e| with_what_is_kept(e, path))?;
        let world = WorldFile::open(path)?;
        Ok(Built { hspy, ..self.built(recipe, &summary, &world, picture)? })
    }

    /// Returns the plan of the build.
    pub fn planned(&self) -> anyhow::Result<WorldPlan> {
        let recipe = self.recorded(self.recipe.resolve()?)?;
        let build = WorldBuild::new(&recipe, &self.options())?;
        Ok(WorldPlan::new(&recipe, &build, self.output(&recipe))?)
    }

    fn check_memory(&self, build: &WorldBuild, reporter: &Reporter) -> anyhow::Result<()> {
        let (needed, remedy) = build.memory(&build.cost()?, stemgen::simulation::threads())?;
        Ok(self.force.check_memory(needed, remedy, reporter)?)
    }

    /// Returns the options of the build: the arguments, and the defaults of the crate.
    pub fn options(&self) -> BuildOptions {
        let m = &self.method;
        let usual = BuildOptions::default();
        BuildOptions {
            noise: !self.no_noise,
            keep_clean: self.keep_clean,
            overwrite: self.overwrite,
            method: m.engine.map_or(usual.method, Into::into),
            profile: m.profile.map_or(usual.profile, Into::into),
            window_angstrom: m.window,
            accuracy_percent: m.accuracy,
            expansion: m.expansion,
            interpolation: m.interpolation,
            audit_regions: m.audit.map_or(usual.audit_regions, usize::from),
            audit_direct: m.audit.is_some_and(|n| n > 0),
            max_error_percent: m.max_error,
            cache: m.kept.cache(),
            subtile_nm: m.subtile,
            subtile_overlap_nm: m.subtile_overlap,
        }
    }

    /// Sets the profile of `--acquisition` in the recipe.
    pub fn recorded(&self, recipe: CheckedRecipe) -> anyhow::Result<CheckedRecipe> {
        let Some(profile) = self.acquisition else { return Ok(recipe) };
        let mut changed = recipe.recipe().clone();
        let table = changed.acquisition.unwrap_or_default();
        changed.acquisition = Some(AcquisitionTable { profile: Some(profile.into()), ..table });
        Ok(changed.checked()?)
    }

    fn output(&self, recipe: &Recipe) -> PathBuf {
        let profile = self.acquisition.map(|a| format!("_{}", Profile::from(a).name()));
        let stem = self.recipe.stem(recipe) + &profile.unwrap_or_default();
        let default = || Path::new("worlds").join(stem + ".h5");
        self.output.clone().unwrap_or_else(default)
    }

    fn built(
        &self,
        recipe: &Recipe,
        summary: &BuildSummary,
        world: &WorldFile,
        picture: Option<PathBuf>,
    ) -> anyhow::Result<Built> {
        let dose = recipe.dose.electrons_per_angstrom2;
        Ok(Built {
            output: summary.path.clone(),
            file_bytes: output::size(&summary.path),
            picture,
            hspy: None,
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
            acquisition: recipe.acquisition.map(|table| table.resolved()),
            engine: summary.engine.clone(),
            library: summary.library,
            audit: summary.audit.clone(),
            audit_known: summary.audit.is_none()
                && summary.library.is_some()
                && self.options().audit_regions > 0,
            subtiles: summary.subtiles,
            subtiles_resumed: summary.subtiles_resumed,
            wall_time_s: summary.wall_time_s,
        })
    }
}

/// Adds to an error that the work folder keeps finished work, if there is one.
fn with_what_is_kept(error: stemgen::Error, path: &Path) -> anyhow::Error {
    let work = work_folder(path);
    let kept =
        format!("{} keeps the finished work; repeat the command to continue", work.display());
    match (error, work.is_dir()) {
        (error @ stemgen::Error::Interrupted, true) => hinted(error, kept),
        (error, true) => {
            let hint = hints::of(&error).map(|hint| format!("{hint}; "));
            hinted(error, hint.unwrap_or_default() + &kept)
        }
        (error, false) => error.into(),
    }
}

impl From<Engine> for BuildMethod {
    fn from(engine: Engine) -> Self {
        match engine {
            Engine::Multislice => BuildMethod::Multislice,
            Engine::Prism => BuildMethod::Prism,
            Engine::Window => BuildMethod::Window,
            Engine::Mosaic => BuildMethod::Mosaic,
        }
    }
}

impl From<ProfileName> for BuildProfile {
    fn from(name: ProfileName) -> Self {
        match name {
            ProfileName::Default => BuildProfile::Default,
            ProfileName::Published => BuildProfile::Published,
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
        if let Some(acquisition) = &self.acquisition {
            let Acquisition { frames, dwell_us, .. } = acquisition;
            let plural = if *frames == 1 { "frame" } else { "frames" };
            let scanned = (self.pixels[0] * frames) as f64;
            let scan = text::duration(acquisition.line_s(self.pixels[1]) * scanned);
            lines.add(
                "recording",
                format!("{frames} {plural} in one scan of {scan}, {dwell_us} us a pixel"),
            );
        }
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
            for audit in audit.all() {
                let of = audit.detector.as_ref().map_or(String::new(), |name| format!("{name}: "));
                let found = format!(
                    "{of}{:.2} % rms at bright columns, {:.2} % over all pixels, against multislice of the same atoms",
                    audit.bright_rms_percent, audit.all_rms_percent
                );
                lines.add("audit", found);
            }
        } else if self.audit_known {
            let why = "none: the installed library was audited when it was made; --audit 1 audits this world";
            lines.add("audit", why);
        }
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        if let Some(path) = &self.hspy {
            lines.add("HyperSpy", path.display().to_string());
        }
        if let Some(picture) = &self.picture {
            lines.add("picture", picture.display().to_string());
        }
        lines.text()
    }
}
