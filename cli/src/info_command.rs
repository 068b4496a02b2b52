//! `stemgen info`.

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use serde::Serialize;

use super::build_again::{BuildAgain, recipe_file};
use super::plan_text::Lines;
use super::{hdf5_check, output, text};
use stemgen::files::outputs::check_outputs;
use stemgen::files::{atomic_write, sha256_of_file};
use stemgen::imaging::Audit;
use stemgen::io::{ImageKind, RecordedSource, StoredImages, WorldFile};
use stemgen::world::WorldFacts;

const EXAMPLES: &str = "\
Examples:
  Print the contents of a world, and the command that makes it again:
    stemgen info worlds/srtio3_easy_2x2.h5
  Print JSON with checksums of all worlds of a folder, for a script:
    stemgen info worlds/*.h5 --checksum --json
  Write the recipe of a world to a file, to edit it and build from it:
    stemgen info mine.h5 --recipe-out mine.toml

For a file of `simulate`, `acquire` or `live`, info prints its images and the command that made it.

With one version of the numerics, on one kind of processor, the command makes identical bytes of
tiles and truth. If it names a recipe file, --recipe-out writes this file.";

/// Print the contents of a world or of a file of images, and the command that makes it again
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Info {
    /// World files, and files of `simulate`, `acquire` or `live`
    #[arg(value_name = "FILE.h5", required = true)]
    worlds: Vec<PathBuf>,
    /// Also print the SHA-256 of each file
    #[arg(long)]
    checksum: bool,
    /// Write the recipe of the world with all values to a file
    #[arg(long, value_name = "FILE.toml")]
    recipe_out: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, requires = "recipe_out")]
    overwrite: bool,
    /// Print as JSON
    #[arg(long)]
    json: bool,
}

/// The contents of a world, as `--json` prints them.
#[derive(Serialize)]
pub struct WorldInfo {
    /// The file.
    pub world: PathBuf,
    /// Size of the file.
    pub file_bytes: u64,
    /// SHA-256 of the file, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// The contents.
    #[serde(flatten)]
    pub facts: WorldFacts,
    /// The command that makes the world again, as a line of a shell.
    pub command: Option<String>,
    /// The words of this command, and the recipe file that it reads.
    pub again: BuildAgain,
}

/// The contents of a file of images, as `--json` prints them.
#[derive(Serialize)]
pub struct ImagesInfo {
    /// The file.
    pub file: PathBuf,
    /// Size of the file.
    pub file_bytes: u64,
    /// SHA-256 of the file, if asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Kind of the images.
    pub kind: &'static str,
    /// Names of the images.
    pub images: Vec<String>,
    /// The command that made the file.
    pub command: Option<String>,
    /// The request that made simulated images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub request: Option<serde_json::Value>,
}

impl ImagesInfo {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        lines.add(self.kind, self.file.display().to_string());
        lines.add("file", text::bytes(self.file_bytes));
        if let Some(digest) = &self.sha256 {
            lines.add("SHA-256", digest.clone());
        }
        lines.add("images", self.images.join(", "));
        lines.add("made by", self.command.clone().unwrap_or_else(|| "no command known".into()));
        if self.request.is_some() {
            lines.add(
                "again",
                format!("stemgen rerun {}", text::quoted(&self.file.to_string_lossy())),
            );
        }
        lines.text()
    }
}

impl Info {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        if let (Some(out), false) = (&self.recipe_out, self.worlds.len() == 1) {
            bail!(
                "--recipe-out {}: writes the recipe of one world; name one world file",
                out.display()
            );
        }
        let (mut infos, mut images, mut texts) = (Vec::new(), Vec::new(), Vec::new());
        for path in &self.worlds {
            hdf5_check::check(path)?;
            if let Some(stored) = StoredImages::open(path)? {
                let info = self.of_images(path, stored)?;
                texts.push(info.text());
                images.push(info);
                continue;
            }
            let world = WorldFile::open(path)?;
            let info = self.of(&world)?;
            texts.push(info.text());
            infos.push(info);
            if let Some(out) = &self.recipe_out {
                let Some(recipe) = &world.metadata().recipe else {
                    bail!(
                        "{}: holds no recipe, since it is a recorded image or a file of another program; leave out --recipe-out",
                        path.display()
                    );
                };
                check_outputs([out], [path], self.overwrite)?;
                atomic_write::write(out, recipe.as_bytes())?;
            }
        }
        if self.json {
            let mut all = serde_json::json!({ "worlds": infos });
            if !images.is_empty() {
                all["images"] = serde_json::to_value(images)?;
            }
            return text::print(&serde_json::to_string_pretty(&all)?);
        }
        text::print(&texts.join("\n\n"))
    }

    fn of_images(&self, path: &Path, stored: StoredImages) -> anyhow::Result<ImagesInfo> {
        if self.recipe_out.is_some() {
            bail!(
                "--recipe-out: {} is no world, and holds no recipe; leave it out",
                path.display()
            );
        }
        let sha256 = self.checksum.then(|| sha256_of_file(path)).transpose()?;
        Ok(ImagesInfo {
            file: path.to_owned(),
            file_bytes: output::size(path),
            sha256: sha256.map(|(digest, _)| digest),
            kind: match stored.kind {
                ImageKind::Simulated => "simulated images",
                ImageKind::Recording => "recording",
            },
            images: stored.names,
            command: stored.command_line,
            request: stored.request.and_then(|text| serde_json::from_str(&text).ok()),
        })
    }

    fn of(&self, world: &WorldFile) -> stemgen::Result<WorldInfo> {
        let path = world.path();
        let name = PathBuf::from(path.file_name().unwrap_or_default());
        let own = self.recipe_out.clone().unwrap_or_else(|| recipe_file(&name));
        let again = BuildAgain::of(world, &own, &name)?;
        let sha256 = self.checksum.then(|| sha256_of_file(path)).transpose()?;
        Ok(WorldInfo::new(path, sha256.map(|(digest, _)| digest), WorldFacts::of(world)?, again))
    }
}

impl WorldInfo {
    fn new(path: &Path, sha256: Option<String>, facts: WorldFacts, again: BuildAgain) -> Self {
        let file_bytes = output::size(path);
        WorldInfo {
            world: path.to_owned(),
            file_bytes,
            sha256,
            facts,
            command: again.line(),
            again,
        }
    }

    fn text(&self) -> String {
        let mut lines = Lines::default();
        lines.add("world", self.world.display().to_string());
        lines.add("file", text::bytes(self.file_bytes));
        if let Some(digest) = &self.sha256 {
            lines.add("SHA-256", digest.clone());
        }
        specimen_lines(&self.facts, &mut lines);
        image_lines(&self.facts, &mut lines);
        making_lines(&self.facts, &mut lines);
        match &self.command {
            Some(line) => lines.add("made again by", line.clone()),
            None => lines.add("made again by", "no command known"),
        }
        if self.again.recipe.is_some() {
            lines.add("", "--recipe-out writes the recipe file that the command names");
        }
        if let Some(note) = &self.again.note {
            lines.add("", note.clone());
        }
        lines.text()
    }
}

fn specimen_lines(f: &WorldFacts, lines: &mut Lines) {
    let mut add = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            lines.add(name, value);
        }
    };
    add("material", f.material.clone());
    add("tier", f.tier.map(|t| t.name().to_owned()));
    add("seed", f.seed.map(|s| s.to_string()));
    add("source", f.source.clone());
    add("zone axis", f.zone_axis.clone().filter(|z| z != "none"));
    add("thickness", f.thickness_nm.map(|t| format!("{} nm", text::significant(t, 3))));
    let counts = [
        (f.vacancies, "vacancies"),
        (f.substitutions, "substitutions"),
        (f.columns as u64, "columns"),
        (f.grain_boundaries as u64, "grain boundaries"),
        (f.phase_boundaries as u64, "phase boundaries"),
        (f.particles as u64, "particles"),
    ];
    let counts = counts.into_iter().filter(|(n, _)| *n > 0);
    let counts: Vec<String> =
        counts.map(|(n, what)| format!(", {what}: {}", text::count(n))).collect();
    add("sites", Some(text::count(f.sites as u64) + &counts.concat()));
    add("phases", (!f.phases.is_empty()).then(|| f.phases.join(", ")));
}

fn image_lines(f: &WorldFacts, lines: &mut Lines) {
    let [height, width] = f.fov_nm.map(|nm| text::significant(nm, 4));
    lines.add("field", format!("{height} x {width} nm (height x width)"));
    let [rows, columns] = f.pixels;
    let pixel = text::significant(f.pixel_size_nm, 4);
    lines.add("pixels", format!("{rows} x {columns} of {pixel} nm"));
    let [rows, columns] = f.tiles;
    let (size, overlap) = (f.tile_size_px, f.overlap_px);
    lines.add("tiles", format!("{rows} x {columns} of {size} pixels, {overlap} of them shared"));
    if let (Some(energy), Some(angle)) = (f.energy_kev, f.convergence_mrad) {
        lines.add("probe", format!("{energy} keV, {angle} mrad"));
    }
    let detector = |d: &stemgen::detect::Detector| format!("{} {}", d.name, d.angles());
    if !f.detectors.is_empty() {
        let all: Vec<String> = f.detectors.iter().map(detector).collect();
        lines.add("detectors", all.join(", "));
    }
    let dose = f.dose_electrons_per_angstrom2.map(|d| format!("{d} electrons/A^2"));
    let noise = match f.noise {
        Some(true) => "the tiles hold its noise",
        Some(false) => "the tiles hold no noise",
        None => "",
    };
    let kept = if f.noise_free_image { "with the noise-free image" } else { "" };
    let parts = [dose.as_deref().unwrap_or_default(), noise, kept];
    let parts: Vec<&str> = parts.into_iter().filter(|p| !p.is_empty()).collect();
    if !parts.is_empty() {
        lines.add("dose", parts.join(", "));
    }
    if let Some(recording) = &f.recording {
        let a = &recording.acquisition;
        let current = recording
            .beam_current_pa
            .map(|pa| format!(", beam of {} pA", text::significant(pa, 3)));
        let current = current.unwrap_or_default();
        let what = format!("{} frames, {} us per pixel{current}", a.frames, a.dwell_us);
        lines.add("recorded", what);
    }
}

fn making_lines(f: &WorldFacts, lines: &mut Lines) {
    if let Some(engine) = &f.engine {
        let window = f
            .engine_parameters
            .as_ref()
            .and_then(|p| p["algorithm"]["window"]["width_angstrom"].as_f64());
        let window = window.map(|w| format!(", windows of {w} A")).unwrap_or_default();
        let phonons = f.phonon_configurations.map(|n| format!(", phonon configurations: {n}"));
        lines.add("engine", format!("{engine}{window}{}", phonons.unwrap_or_default()));
    }
    for audit in f.audit.iter().flat_map(Audit::all) {
        let of = audit.detector.as_ref().map_or(String::new(), |name| format!("{name}: "));
        let found = format!(
            "{of}{:.2} % rms at bright columns, {:.2} % of the mean image; regions: {}",
            audit.bright_rms_percent,
            audit.mean_rms_percent,
            audit.regions.len()
        );
        lines.add("audit", found);
    }
    if let Some(recorded) = &f.recorded {
        recorded_lines(recorded, lines);
    }
    if let Some(version) = &f.stemgen_version {
        let numerics = f.numerics_version.map(|n| format!(", numerics version {n}"));
        lines.add("made by", format!("stemgen {version}{}", numerics.unwrap_or_default()));
    }
}

fn recorded_lines(recorded: &RecordedSource, lines: &mut Lines) {
    let energy = recorded.energy_kev.map(|kev| format!("{kev} keV"));
    let about = [&recorded.format, &recorded.image, &recorded.detector, &energy];
    let mut about: Vec<&str> = about.into_iter().filter_map(|t| t.as_deref()).collect();
    about.dedup();
    lines.add("recorded in", format!("{} ({})", recorded.file, about.join(", ")));
    for (name, value) in [
        ("pixel from", &recorded.pixel_size_from),
        ("scaling", &recorded.normalisation),
        ("gaps", &recorded.gaps),
    ] {
        if let Some(value) = value {
            lines.add(name, value.clone());
        }
    }
}
