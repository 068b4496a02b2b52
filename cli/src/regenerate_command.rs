//! `stemgen regenerate`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde::Serialize;

use super::common::{CacheArgs, Common, Force};
use super::hdf5_check;
use super::progress_bar::Reporter;
use super::recipe_choice::{recipes, world_name};
use super::text;
use super::validate_command::DIFFERENT;
use stemgen::files::{atomic_write, read_text};
use stemgen::io::WorldFile;
use stemgen::numerics::{NUMERICS_VERSION, processor};
use stemgen::progress::Progress;
use stemgen::recipe::CheckedRecipe;
use stemgen::validate::{Manifest, PinnedSameness, PinnedWorld};
use stemgen::world::{BuildOptions, WorldBuild, remove_leftovers};

/// The released worlds, `worlds/manifest.toml`.
const RELEASED: &str = include_str!("../../worlds/manifest.toml");
/// Most bytes of a manifest.
const LARGEST_MANIFEST: usize = 16 << 20;

const EXAMPLES: &str = "\
Examples:
  Build one released world in worlds/, and compare it with the release:
    stemgen regenerate srtio3_hard
  Compare all of them with the release, and keep no file:
    stemgen regenerate --check
  Build the worlds of your own manifest:
    stemgen regenerate --manifest mine.toml -o mine/

A manifest lists released worlds and their digests. Each world is built with its noise-free image
and compared with the manifest: its recipe, its truth, its tiles, and every other dataset and
attribute. The table names parts that differ, are missing, or were not released. The manifest has
digests of images for some kinds of processors. Other kinds round images differently, so 64 values
before noise are compared instead. A list below the table names the parts that were not compared.

Exit code: 0 if no world differs, 3 if one does, 1 if one could not be built or compared.";

/// Build the released worlds again, and compare them with the release
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Regenerate {
    /// Worlds of the manifest, such as srtio3_hard [default: all]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    /// Build each world in a temporary folder, and remove it
    #[arg(long, conflicts_with = "output", help_heading = "Results")]
    check: bool,
    /// Folder to write to. A world that exists there is compared, not built again [default: worlds]
    #[arg(short, long, value_name = "FOLDER", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Manifest, in place of the manifest of the program
    #[arg(long, value_name = "FILE", help_heading = "Manifest")]
    manifest: Option<PathBuf>,
    /// Write the digests of the worlds to the file of --manifest, which may be new. NAME may then be any world of the program's
    /// recipes
    #[arg(long, requires = "manifest", help_heading = "Manifest")]
    pin: bool,
    #[command(flatten)]
    kept: CacheArgs,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

#[derive(Serialize)]
struct Regenerated {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    sameness: Option<PinnedSameness>,
    /// The reason why it could not be built or compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    engine: String,
    audit_bright_percent: Option<f64>,
    audit_all_percent: Option<f64>,
    /// `None` for a world that existed.
    wall_time_s: Option<f64>,
    /// The largest memory of the process so far.
    peak_memory_bytes: Option<u64>,
}

impl Regenerate {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if a world differs from the release.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        let mut manifest = self.read_manifest()?;
        let chosen = self.chosen(&manifest)?;
        if self.common.dry_run {
            let names: Vec<String> = chosen.iter().map(|r| world_name(r)).collect();
            self.common.print(&names, &names.join("\n"))?;
            return Ok(0);
        }
        if chosen.is_empty() {
            anyhow::bail!(
                "the manifest lists no worlds, so nothing is built; name worlds, and give --pin to add them"
            );
        }
        let mut all = Vec::new();
        for (number, recipe) in chosen.iter().enumerate() {
            let name = world_name(recipe);
            reporter.note(&format!("world {} of {}: {name}", number + 1, chosen.len()));
            let (mut made, found) = match self.one(&name, recipe, &reporter) {
                Ok(made) => made,
                Err(error) if reporter.interrupted() => return Err(error),
                Err(error) => {
                    reporter.note(&format!("error: {name}: {error:#}"));
                    all.push(Regenerated { error: Some(format!("{error:#}")), ..new(&name) });
                    continue;
                }
            };
            made.sameness =
                manifest.worlds.iter().find(|w| w.name == name).map(|w| w.compare(&found));
            if let (true, Some(path)) = (self.pin, &self.manifest) {
                manifest.pin(found);
                atomic_write::write(path, manifest.to_toml().as_bytes())?;
            }
            all.push(made);
        }
        self.common.print(&all, &table(&all))?;
        let failed = all.iter().filter(|r| r.error.is_some()).count();
        if failed > 0 {
            anyhow::bail!(
                "{failed} of {} worlds were not compared; repeat the command to try them again",
                all.len()
            );
        }
        let differs =
            |r: &&Regenerated| matches!(r.sameness, Some(PinnedSameness::Different { .. }));
        Ok(if all.iter().any(|r| differs(&r)) { DIFFERENT } else { 0 })
    }

    fn read_manifest(&self) -> anyhow::Result<Manifest> {
        let Some(path) = &self.manifest else {
            return Ok(Manifest::from_toml("worlds/manifest.toml", RELEASED)?);
        };
        if self.pin && !path.exists() {
            return Ok(Manifest::empty());
        }
        let text = read_text(path, LARGEST_MANIFEST)?;
        Ok(Manifest::from_toml(&path.display().to_string(), &text)?)
    }

    /// Returns the recipes of the named worlds.
    fn chosen(&self, manifest: &Manifest) -> anyhow::Result<Vec<CheckedRecipe>> {
        let mut left: Vec<&String> = self.names.iter().collect();
        let mut chosen = Vec::new();
        for recipe in recipes(&[], None)? {
            let name = world_name(&recipe);
            let listed = self.pin || manifest.worlds.iter().any(|w| w.name == name);
            let asked = left.iter().position(|n| **n == name);
            if listed && (asked.is_some() || self.names.is_empty()) {
                chosen.push(recipe.checked()?);
                asked.map(|k| left.remove(k));
            }
        }
        if let Some(unknown) = left.first() {
            let known: Vec<&str> = manifest.worlds.iter().map(|w| w.name.as_str()).collect();
            anyhow::bail!("{unknown}: is no world of the manifest; it lists {}", known.join(", "));
        }
        Ok(chosen)
    }

    /// Builds a world, or opens it if it exists, and computes its digests.
    fn one(
        &self,
        name: &str,
        recipe: &CheckedRecipe,
        reporter: &Reporter,
    ) -> anyhow::Result<(Regenerated, PinnedWorld)> {
        let usual = BuildOptions { keep_clean: true, ..BuildOptions::default() };
        let cache = self.kept.cache();
        let build = WorldBuild::new(recipe, &BuildOptions { cache, ..usual })?;
        let folder = self.output.clone().unwrap_or_else(|| PathBuf::from("worlds"));
        let removed = self.check.then(|| tempfile::tempdir_in(".")).transpose()?;
        let folder = removed.as_ref().map_or(folder.as_path(), |f| f.path());
        let path = folder.join(format!("{name}.h5"));
        let mut made = new(name);
        if path.exists() && !build.is_complete(&path) {
            hdf5_check::check(&path)?;
            remove_leftovers(&path);
            made.engine = "was there".into();
        } else {
            std::fs::create_dir_all(folder).map_err(|e| stemgen::Error::io(folder, "create", e))?;
            let (needed, remedy) = build.memory(&build.cost()?, stemgen::simulation::threads())?;
            self.force.check_memory(needed, remedy, reporter)?;
            let began = Instant::now();
            let summary = build.run(&path, reporter)?;
            made.wall_time_s = Some(began.elapsed().as_secs_f64());
            made.peak_memory_bytes = peak_memory();
            made.audit_bright_percent = summary.audit.as_ref().map(|a| a.bright_rms_percent);
            made.audit_all_percent = summary.audit.as_ref().map(|a| a.all_rms_percent);
            made.engine = summary.engine;
        }
        let found = PinnedWorld::of(name, &WorldFile::open(&path)?, reporter);
        // Only a world that existed can lack the noise-free image.
        let found = found.map_err(|error| match error {
            stemgen::Error::Choice { .. } => anyhow::anyhow!(
                "{}: holds no noiseless image to compare; move it away, so that the world is built again with this image",
                path.display()
            ),
            error => error.into(),
        })?;
        Ok((made, found))
    }
}

/// Returns the report of a world of which nothing is known yet.
fn new(name: &str) -> Regenerated {
    Regenerated {
        name: name.to_owned(),
        sameness: None,
        error: None,
        engine: String::new(),
        audit_bright_percent: None,
        audit_all_percent: None,
        wall_time_s: None,
        peak_memory_bytes: None,
    }
}

/// Returns the largest memory of this process, on systems that report it.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string(Path::new("/proc/self/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    Some(1024 * line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()?)
}

fn table(all: &[Regenerated]) -> String {
    let head = ["world", "engine", "bright %", "all %", "time", "memory", "found"];
    let mut rows = vec![head.map(str::to_owned)];
    let percent = |p: Option<f64>| p.map_or(String::new(), |p| format!("{p:.2}"));
    for r in all {
        let found = match &r.sameness {
            None if r.error.is_some() => "FAILED: the error is above".into(),
            None => format!("noted, numerics {NUMERICS_VERSION}, {}", processor()),
            Some(PinnedSameness::SameBytes { compared, .. }) => {
                format!("the same: {compared} datasets and attributes")
            }
            Some(PinnedSameness::SameValues { difference, values, compared, .. }) => format!(
                "the same: {compared} datasets and attributes, and {values} values before noise within {difference:.1e}; all tiles are compared only on the kinds of processor that the manifest lists"
            ),
            Some(PinnedSameness::Different { what }) => format!("DIFFERS: {}", what.join(", ")),
        };
        rows.push([
            r.name.clone(),
            r.engine.clone(),
            percent(r.audit_bright_percent),
            percent(r.audit_all_percent),
            r.wall_time_s.map(text::duration).unwrap_or_default(),
            r.peak_memory_bytes.map(text::bytes).unwrap_or_default(),
            found,
        ]);
    }
    [text::table(&rows)].into_iter().chain(not_compared(all)).collect::<Vec<_>>().join("\n")
}

/// Lists the parts of equal worlds that were not compared: each list once, with the names of its worlds.
fn not_compared(all: &[Regenerated]) -> Vec<String> {
    let mut lists: Vec<(&[String], Vec<&str>)> = Vec::new();
    for r in all {
        let Some(
            PinnedSameness::SameBytes { not_compared: list, .. }
            | PinnedSameness::SameValues { not_compared: list, .. },
        ) = &r.sameness
        else {
            continue;
        };
        match lists.iter_mut().find(|(known, _)| known == list) {
            Some((_, names)) => names.push(&r.name),
            None => lists.push((list, vec![&r.name])),
        }
    }
    let line = |(list, names): (&[String], Vec<&str>)| {
        format!("not compared ({}): {}", names.join(", "), list.join("; "))
    };
    lists.into_iter().map(line).collect()
}
