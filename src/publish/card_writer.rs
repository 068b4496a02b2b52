//! Writes the card of some worlds and the tables beside them: completely or not at all.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::card_about::CardAbout;
use super::card_croissant::{RecordSource, croissant};
use super::card_readme::{MARK, ReadmeWorld, readme};
use super::card_tables::{CardTable, TABLES, WorldLine, write_table, write_worlds};
use super::card_words::{CardWords, DefectShare};
use super::card_world::{CardPictures, CardWorld};
use crate::error::{Error, Result};
use crate::files::OutputLock;
use crate::files::atomic_write;
use crate::files::disk_space::check_places;
use crate::files::file_digest::sha256_of_file;
use crate::files::outputs::check_outputs;
use crate::io::WorldFile;
use crate::progress::Progress;
use crate::setting::Setting;

/// Largest size of a README.md that is read to see whether it is a card.
const LARGEST_README: u64 = 16 << 20;
/// Prefix of the name of the temporary folder of a card.
const STAGING: &str = ".stemgen-card-";
/// Name of the note that a card is being moved into place; it is hidden, so that it is not uploaded to a hub.
const NOTE: &str = ".stemgen-unfinished-card";
/// Number of files of each world, for progress: tables, picture, world.
const FILES_EACH: usize = TABLES.len() + 2;
/// Folders whose files belong to a card.
const FOLDERS: [&str; 6] = ["columns", "defects", "particles", "parts", "pictures", "recipes"];

/// A file in the folder of a card.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CardFile {
    /// Path in the folder, with `/` between its parts.
    pub path: String,
    /// Description of the file.
    pub text: String,
    /// Media type of the file.
    pub media_type: &'static str,
    /// Size in bytes.
    pub bytes: u64,
    /// SHA-256 of the file.
    pub sha256: String,
    /// The command that makes the file again, for a world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
}

/// The written card.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct CardSummary {
    /// The folder.
    pub folder: PathBuf,
    /// The files of the card, except README.md and croissant.json.
    pub files: Vec<CardFile>,
    /// Properties that Croissant requires or recommends and the publisher has not given.
    pub missing: Vec<&'static str>,
}

/// The card of some worlds.
pub struct Card<'a> {
    /// Information from the publisher.
    pub about: &'a CardAbout,
    /// The worlds, in the order of the card.
    pub worlds: &'a [CardWorld],
    /// Folder of the card. Worlds elsewhere are copied into it.
    pub folder: &'a Path,
    /// Whether existing files are replaced although they belong to no card.
    pub overwrite: bool,
    /// Draws a world with its defects.
    pub draw: &'a dyn Fn(&WorldFile, &CardWorld) -> Result<CardPictures>,
}

/// A world whose files are ready.
struct PreparedWorld {
    file: CardFile,
    tables: Vec<&'static CardTable>,
    /// Description of the part in the second picture, if there is one.
    part: Option<String>,
    others: Vec<CardFile>,
}

impl Card<'_> {
    /// Returns the paths of all files that may be written, except copies of worlds.
    #[must_use]
    pub fn outputs(&self) -> Vec<PathBuf> {
        let mut paths = vec!["README.md".to_owned(), "croissant.json".into(), "worlds.csv".into()];
        for world in self.worlds {
            paths.extend(TABLES.map(|table| table.path(&world.name)));
            paths.extend([picture_path(&world.name), part_path(&world.name)]);
            if world.recipe_text.is_some() {
                paths.push(CardWorld::recipe_path(&world.name));
            }
        }
        paths.into_iter().map(|path| self.folder.join(path)).collect()
    }

    /// Writes the card. All files are first made in a temporary folder beside their final place, so that a failure changes nothing.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there are no worlds, for two worlds of one name, for errors that [`CardAbout::check`] finds, and for existing
    /// files that belong to no card, unless they may be replaced; [`Error::DiskSpace`], [`Error::Io`], errors of damaged worlds,
    /// [`Error::Interrupted`].
    pub fn write(&self, progress: &dyn Progress) -> Result<CardSummary> {
        self.about.check()?;
        self.check_worlds()?;
        let added = Added::below(self.folder);
        let note = self.folder.join(NOTE);
        let ours = is_a_card(&self.folder.join("README.md"))? || is_a_card(&note)?;
        let inputs = self.worlds.iter().map(|w| &w.path);
        check_outputs(self.outputs(), inputs, ours || self.overwrite)?;
        // Two processes that write one card at the same time would remove each other's files.
        let lock = OutputLock::hold(&self.folder.join("README.md"))?;
        self.remove_staging()?;
        let copied = self.copied()?;
        let bytes: u64 = copied.iter().map(|w| fs::metadata(&w.path).map_or(0, |m| m.len())).sum();
        check_places(&[(self.folder, bytes + bytes / 8)])?;
        let staging = tempfile::Builder::new()
            .prefix(STAGING)
            .tempdir_in(self.folder)
            .map_err(|e| Error::io(self.folder, "create a folder in", e))?;
        for folder in FOLDERS {
            let folder = staging.path().join(folder);
            fs::create_dir(&folder).map_err(|e| Error::io(&folder, "create", e))?;
        }
        let summary = self.prepare(staging.path(), &copied, progress)?;
        // From here on existing files belong to the card, even if the process ends half-way.
        atomic_write::write(&note, MARK.as_bytes())?;
        self.put_in_place(staging.path(), &summary, &copied)?;
        remove(&note)?;
        drop(lock);
        added.keep();
        self.warn_of_strangers(&summary, progress);
        Ok(summary)
    }

    fn check_worlds(&self) -> Result<()> {
        if self.worlds.is_empty() {
            let expected = "holds no worlds; a card needs one at least";
            return Err(Error::invalid(Setting::WorldFile, self.folder.display(), expected));
        }
        let mut names: Vec<(String, &Path)> =
            self.worlds.iter().map(|w| (w.name.to_lowercase(), w.path.as_path())).collect();
        names.sort();
        match names.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            None => Ok(()),
            Some(pair) => {
                let expected =
                    format!("has the name of {}; rename one of the two", pair[0].1.display());
                Err(Error::invalid(Setting::WorldFile, pair[1].1.display(), expected))
            }
        }
    }

    /// Removes temporary folders that a killed run has left.
    fn remove_staging(&self) -> Result<()> {
        for entry in fs::read_dir(self.folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let ours = entry.file_name().to_string_lossy().starts_with(STAGING);
            if ours && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                fs::remove_dir_all(&path).map_err(|e| Error::io(&path, "remove", e))?;
            }
        }
        Ok(())
    }

    /// Returns the worlds that do not lie in the folder yet.
    fn copied(&self) -> Result<Vec<&CardWorld>> {
        let mut copied = Vec::new();
        for world in self.worlds {
            let there = self.folder.join(world.file_name());
            let same = |a: &Path, b: &Path| a.canonicalize().ok() == b.canonicalize().ok();
            if there.exists() && same(&there, &world.path) {
                continue;
            }
            if there.exists() && sha256_of_file(&there)? == sha256_of_file(&world.path)? {
                continue;
            }
            check_outputs([&there], [&world.path], self.overwrite)?;
            copied.push(world);
        }
        Ok(copied)
    }

    /// Makes all files in `staging`.
    fn prepare(
        &self,
        staging: &Path,
        copied: &[&CardWorld],
        progress: &dyn Progress,
    ) -> Result<CardSummary> {
        progress.start("card", "file", (self.worlds.len() * FILES_EACH) as u64);
        let mut prepared = Vec::new();
        let mut share = DefectShare::default();
        for world in self.worlds {
            let copy = copied.iter().any(|c| c.name == world.name);
            prepared.push(self.prepare_world(world, staging, copy, &mut share, progress)?);
        }
        progress.finish();
        let of_worlds = self.worlds.iter().zip(&prepared);
        let lines = || of_worlds.clone().map(|(world, p)| world_line(world, p));
        let path = staging.join("worlds.csv");
        write_worlds(&lines().collect::<Vec<_>>(), &path)?;
        let mut files =
            vec![listed(staging, "worlds.csv", "One line for each world.", "text/csv")?];
        for one in &prepared {
            files.push(one.file.clone());
            files.extend(one.others.iter().cloned());
        }
        let words = CardWords::of(self.worlds, share);
        let tables = of_worlds.clone().flat_map(|(world, p)| {
            p.tables.iter().map(|table| RecordSource { table, world: &world.name })
        });
        let json = croissant(self.about, &words, &files, &tables.collect::<Vec<_>>());
        atomic_write::write(&staging.join("croissant.json"), json.as_bytes())?;
        let pages = of_worlds.map(|(world, p)| ReadmeWorld {
            line: world_line(world, p),
            picture: picture_path(&world.name),
            part: p.part.as_ref().map(|text| (text.as_str(), part_path(&world.name))),
            tables: p.tables.clone(),
        });
        let text = readme(self.about, &words, &pages.collect::<Vec<_>>());
        atomic_write::write(&staging.join("README.md"), text.as_bytes())?;
        Ok(CardSummary { folder: self.folder.to_owned(), files, missing: self.about.missing() })
    }

    fn prepare_world(
        &self,
        world: &CardWorld,
        staging: &Path,
        copy: bool,
        share: &mut DefectShare,
        progress: &dyn Progress,
    ) -> Result<PreparedWorld> {
        let name = &world.name;
        let file = WorldFile::open(&world.path)?;
        share.columns += world.facts.columns;
        let with_defects = |c: &crate::io::WorldColumn| c.vacancies > 0 || c.substitutions > 0;
        share.with_defects += file.columns()?.iter().filter(|c| with_defects(c)).count();
        let (mut tables, mut others) = (Vec::new(), Vec::new());
        for table in TABLES {
            progress.advance(1);
            let path = table.path(name);
            // A table without lines has no types, so hubs cannot join it with the tables of other worlds.
            match write_table(table, &file, name, &staging.join(&path), progress)? {
                0 => remove(&staging.join(&path))?,
                _ => {
                    let text = format!("{} Of the world {name}.", table.text);
                    others.push(listed(staging, &path, &text, "text/csv")?);
                    tables.push(table);
                }
            }
        }
        progress.advance(1);
        let CardPictures { whole, part } = (self.draw)(&file, world)?;
        let mut draw = |path: String, text: String, png: &[u8]| {
            atomic_write::write(&staging.join(&path), png)?;
            others.push(listed(staging, &path, &text, "image/png")?);
            Ok(())
        };
        draw(picture_path(name), format!("The world {name}, drawn."), &whole)?;
        if let Some((text, png)) = &part {
            draw(part_path(name), format!("Of the world {name}: {text}."), png)?;
        }
        if let Some(recipe) = &world.recipe_text {
            let path = CardWorld::recipe_path(name);
            atomic_write::write(&staging.join(&path), recipe.as_bytes())?;
            let text = format!("The recipe of the world {name}.");
            others.push(listed(staging, &path, &text, "application/toml")?);
        }
        progress.advance(1);
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let own = world.file_name();
        if copy {
            let to = staging.join(&own);
            fs::copy(&world.path, &to).map_err(|e| Error::io(&to, "write", e))?;
        }
        let from = if copy { staging.to_owned() } else { self.folder.to_owned() };
        let text = format!("The world {name}: its image and its truth.");
        let mut file = listed(&from, &own, &text, "application/x-hdf5")?;
        file.command.clone_from(&world.command);
        Ok(PreparedWorld { file, tables, part: part.map(|(text, _)| text), others })
    }

    /// Moves the finished files to their final places; files that describe the others come last.
    fn put_in_place(
        &self,
        staging: &Path,
        summary: &CardSummary,
        copied: &[&CardWorld],
    ) -> Result<()> {
        let worlds: Vec<String> = self.worlds.iter().map(CardWorld::file_name).collect();
        let new =
            |path: &String| !worlds.contains(path) || copied.iter().any(|c| c.file_name() == *path);
        let files = summary.files.iter().map(|f| &f.path).filter(|path| new(path));
        let last = ["croissant.json".to_owned(), "README.md".into()];
        for path in files.chain(&last) {
            let to = self.folder.join(path);
            fs::rename(staging.join(path), &to).map_err(|e| Error::io(&to, "create", e))?;
            atomic_write::sync_folder(&to)?;
        }
        Ok(())
    }

    /// Warns of files in the folder that would be uploaded to the hub but are not in the card.
    fn warn_of_strangers(&self, summary: &CardSummary, progress: &dyn Progress) {
        let mut strangers = Vec::new();
        for folder in FOLDERS {
            for name in names_in(&self.folder.join(folder)) {
                let path = format!("{folder}/{name}");
                if !summary.files.iter().any(|f| f.path == path) {
                    strangers.push(path);
                }
            }
            // The folder is only removed if it is empty.
            let _ = fs::remove_dir(self.folder.join(folder));
        }
        for name in names_in(self.folder) {
            if is_hdf5_name(Path::new(&name)) && !summary.files.iter().any(|f| f.path == name) {
                strangers.push(name);
            }
        }
        if !strangers.is_empty() {
            progress.warn(&format!(
                "{}: not in the card, but in its folder: {}; remove what is not to be published",
                self.folder.display(),
                strangers.join(", ")
            ));
        }
    }
}

/// Whether a file has the ending of HDF5 files.
fn is_hdf5_name(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "h5" || e == "hdf5")
}

impl CardWorld {
    /// Returns the files of a folder that have the ending of HDF5 files, in the order of their names; hidden files are left out.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] if there are none.
    pub fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
        fs::read_dir(folder).map_err(|e| Error::io(folder, "read", e))?;
        let names = names_in(folder).into_iter().map(PathBuf::from);
        let found: Vec<PathBuf> = names
            .filter(|n| is_hdf5_name(n))
            .map(|n| folder.join(n))
            .filter(|p| p.is_file())
            .collect();
        match found.is_empty() {
            true => {
                let expected = "holds no worlds (files that end in .h5 or .hdf5); build some, or name another folder";
                Err(Error::invalid(Setting::WorldFile, folder.display(), expected))
            }
            false => Ok(found),
        }
    }
}

/// Returns the names in a folder, in order, without hidden ones; empty for a folder that cannot be read.
fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

fn picture_path(name: &str) -> String {
    format!("pictures/{name}.png")
}

fn part_path(name: &str) -> String {
    format!("parts/{name}.png")
}

fn world_line<'a>(world: &'a CardWorld, prepared: &'a PreparedWorld) -> WorldLine<'a> {
    WorldLine { world, bytes: prepared.file.bytes, sha256: &prepared.file.sha256 }
}

fn listed(folder: &Path, path: &str, text: &str, media_type: &'static str) -> Result<CardFile> {
    let (sha256, bytes) = sha256_of_file(&folder.join(path))?;
    let (path, text) = (path.to_owned(), text.to_owned());
    Ok(CardFile { path, text, media_type, bytes, sha256, command: None })
}

fn remove(path: &Path) -> Result<()> {
    fs::remove_file(path).map_err(|e| Error::io(path, "remove", e))
}

/// Whether the file at the path is a card of this program; other files are not replaced without permission.
fn is_a_card(path: &Path) -> Result<bool> {
    match fs::metadata(path) {
        Ok(about) if about.is_file() && about.len() <= LARGEST_README => {
            let text = fs::read(path).map_err(|e| Error::io(path, "read", e))?;
            Ok(text.windows(MARK.len()).any(|part| part == MARK.as_bytes()))
        }
        _ => Ok(false),
    }
}

/// Folders that were made for a card, and are removed if it fails.
struct Added(Vec<PathBuf>);

impl Added {
    fn below(folder: &Path) -> Self {
        let above: Vec<&Path> = folder.ancestors().filter(|p| !p.as_os_str().is_empty()).collect();
        let all = above.into_iter().rev().map(Path::to_owned);
        let all = all.chain(FOLDERS.map(|name| folder.join(name)));
        Added(all.filter(|path| !path.exists()).collect())
    }

    fn keep(mut self) {
        self.0.clear();
    }
}

impl Drop for Added {
    fn drop(&mut self) {
        for path in self.0.iter().rev() {
            // Folders with contents stay.
            let _ = fs::remove_dir(path);
        }
    }
}
