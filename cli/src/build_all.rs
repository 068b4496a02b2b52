//! `stemgen build --all`: many worlds in one run.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use serde::Serialize;

use super::build_command::{Build, Built};
use super::hdf5_check;
use super::progress_bar::Reporter;
use super::recipe_choice::recipes;
use super::text;
use stemgen::acquisition::Profile;
use stemgen::files::outputs::check_outputs;
use stemgen::io::WorldFile;
use stemgen::numerics::NUMERICS_VERSION;
use stemgen::progress::Progress;
use stemgen::recipe::CheckedRecipe;
use stemgen::world::{WorldBuild, WorldPlan, remove_leftovers};

/// One of the worlds.
struct Target {
    name: String,
    recipe: CheckedRecipe,
    path: PathBuf,
    /// Whether the finished world exists.
    kept: bool,
    /// The expected time in s.
    expected_s: f64,
}

/// The result for one world.
#[derive(Serialize)]
struct WorldOutcome {
    name: String,
    output: PathBuf,
    #[serde(flatten)]
    result: WorldResult,
}

#[derive(Serialize)]
#[serde(tag = "outcome", rename_all = "snake_case")]
enum WorldResult {
    /// It existed.
    Kept {
        file_bytes: u64,
    },
    /// It would be built, or a part of it.
    Planned {
        expected_s: f64,
    },
    Built(Box<Built>),
    /// A part of it was computed.
    Part {
        wall_time_s: f64,
    },
    Failed {
        error: String,
    },
}

/// Builds all worlds that the arguments name; the exit code is not 0 if an audit found an error above the limit.
pub fn run(build: &Build, reporter: &Reporter) -> anyhow::Result<u8> {
    let mut targets = targets(build, reporter)?;
    let mut outcomes = Vec::new();
    let planned = targets.iter().filter(|t| !t.kept).count();
    reporter.start("estimating", "world", planned as u64);
    for target in targets.iter_mut().filter(|t| !t.kept) {
        if reporter.interrupted() {
            return Err(stemgen::Error::Interrupted.into());
        }
        let world = WorldBuild::new(&target.recipe, &build.options())?;
        let report = WorldPlan::new(&target.recipe, &world, target.path.clone())?;
        target.expected_s = report.expected_s() / build.shard.map_or(1, |s| s.count()) as f64;
        reporter.advance(1);
    }
    reporter.finish();
    let mut clock = Clock::new(&targets);
    for (number, target) in targets.iter().enumerate() {
        let result = match target.kept {
            true => {
                if !build.common.dry_run {
                    remove_leftovers(&target.path);
                }
                WorldResult::Kept { file_bytes: super::output::size(&target.path) }
            }
            false if build.common.dry_run => WorldResult::Planned { expected_s: target.expected_s },
            false => {
                let [own, all] =
                    [target.expected_s, clock.left_s].map(|s| text::duration(s * clock.slower));
                let of = format!("world {} of {}", number + 1, targets.len());
                reporter.note(&format!(
                    "{of}, {}: about {own}; all that are left: about {all}",
                    target.name
                ));
                let result = one(build, target, reporter);
                if reporter.interrupted() {
                    return result.map(|_| 0).context("repeat the command to continue");
                }
                clock.passed(target);
                result.unwrap_or_else(|e| {
                    reporter.note(&format!("error: {}: {e:#}", target.name));
                    WorldResult::Failed { error: format!("{e:#}") }
                })
            }
        };
        let (name, output) = (target.name.clone(), target.path.clone());
        outcomes.push(WorldOutcome { name, output, result });
    }
    build.common.print(&outcomes, &table(&outcomes))?;
    let failed = outcomes.iter().filter(|o| matches!(o.result, WorldResult::Failed { .. })).count();
    if failed > 0 {
        anyhow::bail!(
            "{failed} of {} worlds were not built; repeat the command to try them again",
            outcomes.len()
        );
    }
    let verdict = |outcome: &WorldOutcome| match &outcome.result {
        WorldResult::Built(built) => build.verdict(built),
        _ => 0,
    };
    Ok(outcomes.iter().map(verdict).max().unwrap_or(0))
}

/// The remaining time, and how much slower this machine is than expected.
struct Clock {
    left_s: f64,
    slower: f64,
    expected_s: f64,
    taken_s: f64,
    since: Instant,
}

impl Clock {
    fn new(targets: &[Target]) -> Self {
        let left_s = targets.iter().map(|t| t.expected_s).sum();
        Clock { left_s, slower: 1.0, expected_s: 0.0, taken_s: 0.0, since: Instant::now() }
    }

    /// Counts a world as done.
    fn passed(&mut self, target: &Target) {
        self.taken_s += self.since.elapsed().as_secs_f64();
        self.since = Instant::now();
        self.left_s -= target.expected_s;
        self.expected_s += target.expected_s;
        self.slower = self.taken_s / self.expected_s.max(1e-3);
    }
}

/// Returns the worlds to build, and the finished ones that are kept.
fn targets(build: &Build, reporter: &Reporter) -> anyhow::Result<Vec<Target>> {
    let folder = build.output.clone().unwrap_or_else(|| PathBuf::from("worlds"));
    if folder.is_file() {
        anyhow::bail!("{}: is a file; with --all, --output names a folder", folder.display());
    }
    let mut targets = Vec::new();
    for recipe in recipes(&build.materials, build.recipe.difficulty())? {
        let own = recipe.seed;
        let recipe = build.recorded(build.recipe.changed(recipe)?)?;
        let profile = build.acquisition.map(|a| format!("_{}", Profile::from(a).name()));
        let name = build.recipe.stem_of(&recipe, Some(own)) + &profile.unwrap_or_default();
        let path = folder.join(format!("{name}.h5"));
        let unfinished = WorldBuild::new(&recipe, &build.options())?.is_complete(&path);
        let kept =
            path.exists() && !unfinished && !build.overwrite && is_this(build, &recipe, &path)?;
        if !kept && !build.common.dry_run {
            check_outputs([&path], [] as [&Path; 0], build.overwrite || unfinished)?;
        }
        targets.push(Target { name, recipe, path, kept, expected_s: 0.0 });
    }
    if targets.is_empty() {
        reporter.warn("no recipe has this tier; nothing is built. `stemgen list` prints the tiers");
    }
    Ok(targets)
}

/// Whether a file holds the world that would be built.
fn is_this(build: &Build, recipe: &CheckedRecipe, path: &Path) -> anyhow::Result<bool> {
    hdf5_check::check(path)?;
    let Ok(world) = WorldFile::open(path) else { return Ok(false) };
    let found = world.metadata();
    Ok(found.recipe.as_deref() == Some(&recipe.to_toml())
        && found.numerics == Some(NUMERICS_VERSION)
        && found.noise == Some(!build.no_noise)
        && world.has_clean() == build.keep_clean)
}

fn one(build: &Build, target: &Target, reporter: &Reporter) -> anyhow::Result<WorldResult> {
    let world = WorldBuild::new(&target.recipe, &build.options())?;
    let parts = (&target.recipe, world);
    if let Some(shard) = build.shard {
        let part = build.part(parts, &target.path, shard, reporter)?;
        return Ok(WorldResult::Part { wall_time_s: part.wall_time_s() });
    }
    Ok(WorldResult::Built(Box::new(build.make(parts, &target.path, reporter)?)))
}

fn table(outcomes: &[WorldOutcome]) -> String {
    let head = ["world", "tiles", "sites", "engine", "bright %", "all %", "time", "size", "file"];
    let mut rows = vec![head.map(str::to_owned)];
    for WorldOutcome { name, output, result } in outcomes {
        let mut row = [const { String::new() }; 9];
        row[0].clone_from(name);
        row[8] = output.display().to_string();
        match result {
            WorldResult::Kept { file_bytes } => {
                row[3] = "was there".into();
                row[7] = text::bytes(*file_bytes);
            }
            WorldResult::Planned { expected_s } => {
                row[6] = format!("about {}", text::duration(*expected_s));
            }
            WorldResult::Part { wall_time_s } => {
                row[3] = "a part".into();
                row[6] = text::duration(*wall_time_s);
            }
            WorldResult::Failed { .. } => row[3] = "FAILED".into(),
            WorldResult::Built(built) => {
                let [rows, columns] = built.tiles;
                row[1] = format!("{rows} x {columns}");
                row[2] = text::count(built.sites);
                row[3].clone_from(&built.engine);
                if let Some(audit) = &built.audit {
                    row[4] = format!("{:.2}", audit.bright_rms_percent);
                    row[5] = format!("{:.2}", audit.all_rms_percent);
                }
                row[6] = text::duration(built.wall_time_s);
                row[7] = text::bytes(built.file_bytes);
            }
        }
        rows.push(row);
    }
    text::table(&rows)
}
