//! `stemgen card`.

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;

use super::build_again::BuildAgain;
use super::common::Common;
use super::{hdf5_check, text};
use stemgen::Error;
use stemgen::files::outputs::folder;
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::publish::{
    Card, CardAbout, CardPictures, CardSummary, CardWorld, DataCreator, DataLicense,
};
use stemgen::render::{Overlay, WorldPart, WorldPicture};

/// Longest side of a picture in pixels.
const PICTURE: u32 = 700;
/// Edge in nm above which a part of the field is drawn too, since columns are then too small for rings.
const WIDE_NM: f64 = 17.5;
/// Edge of this part in nm.
const PART_NM: f64 = 8.0;
/// Name of the program in commands. A fixed name keeps the card independent of the name of this program.
const PROGRAM: &str = "stemgen";

const EXAMPLES: &str = "\
Examples:
  The card of all worlds of a folder, written into the folder:
    stemgen card released/
  A folder for a data hub, with copies of worlds from elsewhere:
    stemgen card worlds/srtio3_*.h5 -o srtio3-worlds/ --title 'SrTiO3 with oxygen vacancies' \\
      --license CC-BY-4.0 --creator 'A. Person' --url https://example.org/srtio3 --date 2026-11-23

A card is the description of a data set. README.md is for people, and data hubs read its head;
croissant.json (Croissant 1.1 with RAI fields) is for programs. worlds.csv lists the worlds. Each
world has its columns, defects and particles as CSV, a picture, and its recipe if the command that
makes the world again reads a recipe file. Equal worlds and options make identical bytes.";

/// Prepare worlds for a data hub: write a README, a Croissant file, tables and pictures
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CardCommand {
    /// Folder with world files (.h5), or the world files
    #[arg(value_name = "FOLDER|WORLD.h5", required = true)]
    worlds: Vec<PathBuf>,
    /// Folder to write to. Worlds from other folders are copied to it [default: FOLDER]
    #[arg(short, long, value_name = "FOLDER", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace existing files that do not belong to an earlier card
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    said: Said,
    #[command(flatten)]
    common: Common,
}

/// Holds the statements that only the publisher can make.
#[derive(Debug, Args)]
#[command(next_help_heading = "Statements on the card")]
struct Said {
    /// Title of the data set [default: the name of the folder]
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// Description of the data set; it stands before the statements that the program reads from the files
    #[arg(long, value_name = "TEXT")]
    description: Option<String>,
    /// Licence of the data: an SPDX name such as CC-BY-4.0, or an address [default: none]
    #[arg(long, value_name = "NAME|URL", value_parser = DataLicense::parse)]
    license: Option<DataLicense>,
    /// Person who made the data set (repeatable)
    #[arg(long, value_name = "NAME")]
    creator: Vec<String>,
    /// Organization that made the data set (repeatable)
    #[arg(long, value_name = "NAME")]
    organization: Vec<String>,
    /// Address of the page of the data set
    #[arg(long, value_name = "URL")]
    url: Option<String>,
    /// Day of publication, such as 2026-11-23 [default: none; the clock is not used]
    #[arg(long, value_name = "DATE")]
    date: Option<String>,
    /// Version of the data set
    #[arg(long, value_name = "X.Y.Z", default_value = "1.0.0")]
    data_version: String,
    /// Citation of the data set
    #[arg(long, value_name = "TEXT")]
    cite: Option<String>,
}

impl Said {
    fn about(&self, folder: &Path) -> CardAbout {
        let usual = || {
            let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
            let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if name.is_empty() { "worlds".into() } else { name }
        };
        let persons = self.creator.iter().cloned().map(DataCreator::Person);
        let organizations = self.organization.iter().cloned().map(DataCreator::Organization);
        CardAbout {
            description: self.description.clone(),
            license: self.license.clone(),
            creators: persons.chain(organizations).collect(),
            url: self.url.clone(),
            published: self.date.clone(),
            version: self.data_version.clone(),
            citation: self.cite.clone(),
            ..CardAbout::new(&self.title.clone().unwrap_or_else(usual))
        }
    }
}

impl CardCommand {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let out = self.folder()?;
        let about = self.said.about(&out);
        about.check()?;
        let mut worlds = Vec::new();
        for path in self.files()? {
            if reporter.interrupted() {
                return Err(Error::Interrupted.into());
            }
            // Every world is checked before the first file is written, so that a damaged one leaves the folder unchanged.
            hdf5_check::check(&path)?;
            worlds.push(card_world(&WorldFile::open(&path)?)?);
        }
        worlds.sort_by(|a, b| a.name.cmp(&b.name));
        let draw = |file: &WorldFile, world: &CardWorld| pictures(file, world);
        let (folder, overwrite) = (out.as_path(), self.overwrite);
        let card = Card { about: &about, worlds: &worlds, folder, overwrite, draw: &draw };
        if self.common.dry_run {
            let paths = card.outputs();
            let lines: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
            return self.common.print(&serde_json::json!({ "outputs": paths }), &lines.join("\n"));
        }
        let summary = card.write(&reporter)?;
        self.common.print(&summary, &summary_text(&summary, worlds.len()))
    }

    /// Returns the world files.
    fn files(&self) -> stemgen::Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        for path in &self.worlds {
            match path.is_dir() {
                true => files.extend(CardWorld::files_of(path)?),
                false => files.push(path.clone()),
            }
        }
        Ok(files)
    }

    /// Returns the folder of the card.
    fn folder(&self) -> anyhow::Result<PathBuf> {
        match (&self.output, &self.worlds[..]) {
            (Some(out), _) if out.is_file() => {
                bail!("{}: is a file; --output names a folder, which may be new", out.display())
            }
            (Some(out), _) => Ok(out.clone()),
            (None, [one]) if one.is_dir() => Ok(one.clone()),
            (None, [one]) if !one.exists() => {
                Err(Error::io(one, "read", std::io::ErrorKind::NotFound.into()).into())
            }
            (None, [one]) => bail!(
                "{}: is no folder; name a folder, or give --output for the folder of the card, such as --output {}",
                one.display(),
                folder(one).join("card").display()
            ),
            (None, _) => bail!(
                "several files or folders are named; give --output for the folder of the card"
            ),
        }
    }
}

/// Reads a world, and finds the command that makes it again.
fn card_world(file: &WorldFile) -> stemgen::Result<CardWorld> {
    let mut world = CardWorld::of(file)?;
    let (recipe, output) = (CardWorld::recipe_path(&world.name), world.file_name());
    let again = BuildAgain::of(file, Path::new(&recipe), Path::new(&output))?;
    world.command = again.line_of(PROGRAM).filter(|line| !line.chars().any(char::is_control));
    world.note = again.note.filter(|_| world.command.is_some());
    world.recipe_text = again.recipe.filter(|_| world.command.is_some());
    Ok(world)
}

/// Draws the whole field, and a part of it if the field is wide.
fn pictures(file: &WorldFile, world: &CardWorld) -> stemgen::Result<CardPictures> {
    let [height, width] = file.shape();
    let pixel_nm = world.facts.pixel_size_nm;
    let whole = picture(file, world, WorldPart { rows: 0..height, columns: 0..width, pixel_nm })?;
    if world.facts.fov_nm.iter().all(|nm| *nm <= WIDE_NM) {
        return Ok(CardPictures { whole, part: None });
    }
    let place = place_of_interest(file, world)?;
    let range = |at_nm: f64, size: usize| {
        let edge = ((PART_NM / pixel_nm).round() as usize).clamp(1, size);
        let first = (at_nm / pixel_nm - 0.5 * edge as f64).round().max(0.0) as usize;
        first.min(size - edge)..first.min(size - edge) + edge
    };
    let (rows, columns) = (range(place[1], height), range(place[0], width));
    let nm = |pixels: usize| text::significant(pixels as f64 * pixel_nm, 3);
    let [x, y] = [columns.start, rows.start].map(|first| format!("{:.1}", first as f64 * pixel_nm));
    let caption =
        format!("{} x {} nm of it, from x = {x}, y = {y} nm", nm(columns.len()), nm(rows.len()));
    let part = picture(file, world, WorldPart { rows, columns, pixel_nm })?;
    Ok(CardPictures { whole, part: Some((caption, part)) })
}

/// Returns the place of the particle or the defect that is nearest to the centre of the field, (x, y) in nm; the centre if there is none.
fn place_of_interest(file: &WorldFile, world: &CardWorld) -> stemgen::Result<[f64; 2]> {
    let [height, width] = world.facts.fov_nm;
    let centre = [0.5 * width, 0.5 * height];
    let mut places: Vec<[f32; 2]> =
        file.particles()?.centres.iter().map(|[x, y, _]| [*x, *y]).collect();
    if places.is_empty() {
        let columns = file.columns()?.into_iter();
        let with_defects = columns.filter(|c| c.vacancies > 0 || c.substitutions > 0);
        places.extend(with_defects.map(|c| c.position_nm));
    }
    let places = places.into_iter().map(|place| place.map(f64::from));
    let distance = |[x, y]: &[f64; 2]| (x - centre[0]).hypot(y - centre[1]);
    let nearest = places.min_by(|a, b| distance(a).total_cmp(&distance(b)));
    Ok(nearest.unwrap_or(centre))
}

/// Draws a part of the field with its ground truth, as a PNG.
fn picture(file: &WorldFile, world: &CardWorld, part: WorldPart) -> stemgen::Result<Vec<u8>> {
    let facts = &world.facts;
    let lines = facts.grain_boundaries + facts.phase_boundaries;
    let there = [
        (Overlay::Phases, facts.phases.len() > 1),
        (Overlay::Boundaries, lines > 0 && facts.phases.len() < 2),
        (Overlay::Defects, facts.vacancies + facts.substitutions > 0),
        (Overlay::Particles, facts.particles > 0),
    ];
    let overlay = there.into_iter().filter(|(_, there)| *there).map(|(overlay, _)| overlay);
    let view = WorldPicture {
        overlays: overlay.collect(),
        longest_side_px: PICTURE,
        ..WorldPicture::default()
    };
    let fault = |e: &dyn std::fmt::Display| {
        Error::parse(file.path(), 0, format!("cannot be drawn: {e}; copy or build it again"))
    };
    part.picture(&view, file)?.encode().map_err(|e| fault(&e))
}

fn summary_text(summary: &CardSummary, worlds: usize) -> String {
    let folder = &summary.folder;
    let bytes: u64 = summary.files.iter().map(|f| f.bytes).sum();
    let count = |ending: &str| summary.files.iter().filter(|f| f.path.ends_with(ending)).count();
    let mut lines = vec![format!(
        "{}, croissant.json: worlds: {worlds}, tables: {}, pictures: {}; {} in all",
        folder.join("README.md").display(),
        count(".csv"),
        count(".png"),
        text::bytes(bytes)
    )];
    let options = [
        ("license", "--license"),
        ("creator", "--creator or --organization"),
        ("url", "--url"),
        ("datePublished", "--date"),
        ("citeAs", "--cite"),
    ];
    let missing: Vec<&str> = options
        .into_iter()
        .filter(|(name, _)| summary.missing.contains(name))
        .map(|(_, option)| option)
        .collect();
    if !missing.is_empty() {
        lines.push(format!("Croissant and data hubs also ask for {}", missing.join(", ")));
    }
    lines.join("\n")
}
