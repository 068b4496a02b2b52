//! Recipes: what a world is made of, as TOML with one table per difficulty.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::crystal::ColumnCrystal;
use super::crystal_source::CrystalSource;
use super::orientation;
use super::overrides::Override;
use super::recipe_check;
pub use super::tables::*;
use crate::error::{Error, Result};
use crate::structure::Structure;

/// Recipes that come with the program: name and text.
const BUILT_IN: &[(&str, &str)] = &[
    ("srtio3", include_str!("../../generate/srtio3.toml")),
    ("batio3", include_str!("../../generate/batio3.toml")),
    ("sige", include_str!("../../generate/sige.toml")),
    ("gan", include_str!("../../generate/gan.toml")),
    ("pt", include_str!("../../generate/pt.toml")),
    ("replay", include_str!("../../generate/replay.toml")),
    ("test", include_str!("../../generate/test.toml")),
];

/// A tier of difficulty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Difficulty {
    /// Many defects, much dose.
    Easy,
    /// Between.
    Medium,
    /// Few defects, little dose.
    Hard,
}

impl Difficulty {
    /// All tiers.
    pub const ALL: [Difficulty; 3] = [Difficulty::Easy, Difficulty::Medium, Difficulty::Hard];

    /// The name that recipes and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            Difficulty::Easy => "easy",
            Difficulty::Medium => "medium",
            Difficulty::Hard => "hard",
        }
    }
}

impl std::str::FromStr for Difficulty {
    type Err = Error;
    fn from_str(text: &str) -> Result<Self> {
        let found = Difficulty::ALL.into_iter().find(|d| d.name() == text);
        found.ok_or_else(|| {
            Error::invalid(crate::Setting::Difficulty, text, "expected easy, medium or hard")
        })
    }
}

/// A resolved recipe: every value that decides what a world holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Version of the recipe format.
    pub version: u32,
    /// Identifies the material: `srtio3`.
    pub id: String,
    /// The tier that this recipe was resolved for, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tier: Option<Difficulty>,
    /// Where readers should say that the data come from, where it matters: `synthetic_replay`. Becomes
    /// an attribute of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Which specimen builder the recipe is for.
    pub structure: StructureKind,
    /// Direction of the beam in the crystal, as text: `[001]`, `[11-20]`; `none` for particles.
    pub zone_axis: String,
    /// Direction along +y, perpendicular to the zone; the shortest such when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The crystal.
    pub crystal: CrystalSource,
    /// Field of view, tiles and thickness.
    pub field: Field,
    /// Grain boundaries (`grains`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boundaries: Option<Boundaries>,
    /// Domains of a second phase (`domains`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub domains: Option<Domains>,
    /// Composition of an alloy (`epitaxy`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alloy: Option<Alloy>,
    /// Quantum wells of the alloy (`epitaxy`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wells: Option<Wells>,
    /// Particles on a film (`particles`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<Particles>,
    /// Vacancies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vacancies: Option<Vacancies>,
    /// Random substitutions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub substitutions: Option<Substitutions>,
    /// Thermal vibration.
    pub phonons: Phonons,
    /// The probe.
    pub optics: Optics,
    /// The detector.
    pub detector: Detector,
    /// Noise.
    pub dose: Dose,
}

impl Recipe {
    /// Names of the recipes that come with the program.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// A recipe that comes with the program, at one of its [`Recipe::tiers`].
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown material, naming the nearest; [`Error::Parse`] for a tier
    /// that it lacks.
    pub fn load(material: &str, difficulty: impl Into<Option<Difficulty>>) -> Result<Self> {
        let (name, text) = built_in_text(material)?;
        Recipe::from_toml_str(&format!("generate/{name}.toml"), text, difficulty.into())
    }

    /// The tiers of a recipe that comes with the program; none if it describes a single world.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown material, naming the nearest.
    pub fn tiers(material: &str) -> Result<Vec<Difficulty>> {
        let (_, text) = built_in_text(material)?;
        let table: toml::Table = toml::from_str(text)
            .map_err(|e| Error::invalid(crate::Setting::Recipe, material, e.message()))?;
        let tiers = table.get("difficulty").and_then(toml::Value::as_table);
        let there = |d: &Difficulty| tiers.is_some_and(|t| t.contains_key(d.name()));
        Ok(Difficulty::ALL.into_iter().filter(there).collect())
    }

    /// Reads a recipe from a file.
    ///
    /// # Errors
    /// [`Error::Io`], or as [`Recipe::from_toml_str`].
    pub fn from_file(path: &Path, difficulty: Option<Difficulty>) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Recipe::from_toml_str(&path.display().to_string(), &text, difficulty)
    }

    /// Parses a recipe and applies the table of `difficulty`; `name` stands in errors. A text
    /// without tables of difficulty (a resolved recipe) takes `None`.
    ///
    /// # Errors
    /// [`Error::Parse`] with the line, for bad syntax, unknown keys and values out of limits.
    pub fn from_toml_str(name: &str, text: &str, difficulty: Option<Difficulty>) -> Result<Self> {
        let source = Source { path: PathBuf::from(name), text, difficulty };
        let mut table: toml::Table =
            toml::from_str(text).map_err(|e| source.syntax_error(&e, text))?;
        let tiers = table.remove("difficulty");
        if let Some(chosen) = source.tier(tiers, difficulty)? {
            merge(&mut table, chosen);
        }
        if let Some(difficulty) = difficulty {
            table.insert("tier".into(), difficulty.name().into());
        }
        let mut recipe: Recipe =
            table.try_into().map_err(|e: toml::de::Error| source.value_error(&e))?;
        recipe.read_crystals(source.path.parent().unwrap_or(Path::new(""))).map_err(
            |e| match e {
                Error::Invalid { value, expected, .. } => {
                    let line = source.line_of("crystal");
                    Error::parse(&source.path, line, format!("crystal = {value}: {expected}"))
                }
                other => other,
            },
        )?;
        recipe_check::check(&recipe).map_err(|fault| {
            let line = source.line_of(fault.key.rsplit('.').next().unwrap_or_default());
            let Fault { key, value, expected } = fault;
            Error::parse(&source.path, line, format!("{key} = {value}: {expected}"))
        })?;
        Ok(recipe)
    }

    /// Reads the files of crystals that are not the program's, relative to `folder`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown crystal, [`Error::Io`].
    pub fn read_crystals(&mut self, folder: &Path) -> Result<()> {
        self.crystal.read(folder)?;
        if let Some(domains) = &mut self.domains {
            domains.crystal.read(folder)?;
        }
        match &mut self.alloy {
            Some(alloy) => alloy.end_member.read(folder),
            None => Ok(()),
        }
    }

    /// The crystal in a box whose z axis is the zone axis.
    ///
    /// # Errors
    /// [`Error::Invalid`] when no such box exists, and those of the crystal's file.
    pub fn oriented_crystal(&self) -> Result<Structure> {
        oriented(&self.crystal, &self.zone_axis, self.y_axis.as_deref())
    }

    /// That crystal as columns.
    ///
    /// # Errors
    /// As [`Recipe::oriented_crystal`] and [`ColumnCrystal::new`].
    pub fn column_crystal(&self) -> Result<ColumnCrystal> {
        ColumnCrystal::new(&self.oriented_crystal()?)
    }

    /// The recipe with some values changed, in the order given.
    ///
    /// # Errors
    /// [`Error::Set`] that names the change at fault; [`Error::Invalid`] when values that were not
    /// changed no longer fit.
    pub fn with_overrides(&self, changes: &[Override]) -> Result<Self> {
        if changes.is_empty() {
            return Ok(self.clone());
        }
        let mut table: toml::Table = toml::from_str(&self.to_toml())
            .map_err(|e| Error::invalid(crate::Setting::Recipe, &self.id, e.message()))?;
        changes.iter().for_each(|change| change.apply(&mut table));
        let mut recipe: Recipe = table.try_into().map_err(|e: toml::de::Error| {
            let (key, message) = explain(&e);
            at_fault(changes, key, message)
        })?;
        recipe.read_crystals(Path::new(""))?;
        recipe_check::check(&recipe).map_err(|Fault { key, value, expected }| {
            match changes.iter().rev().find(|c| c.concerns(&key)) {
                Some(change) => change.error(format!("{key} = {value}: {expected}")),
                None => {
                    Error::invalid(crate::Setting::Recipe, format!("{key} = {value}"), expected)
                }
            }
        })?;
        Ok(recipe)
    }

    /// Checks every value against its limits, as needed after changing some.
    ///
    /// # Errors
    /// [`Error::Invalid`] that names the key.
    pub fn check(&self) -> Result<()> {
        recipe_check::check(self).map_err(|Fault { key, value, expected }| {
            Error::invalid(crate::Setting::Recipe, format!("{key} = {value}"), expected)
        })
    }

    /// The same specimen and pixel, but only the central `rows` x `columns` tiles. Where the
    /// difference is odd, the part lies half a tile up and left of the centre.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the grid is empty or larger than the full field.
    pub fn with_grid(mut self, rows: usize, columns: usize) -> Result<Self> {
        let [r, c] = self.field.grid;
        if rows == 0 || columns == 0 || rows > r || columns > c {
            let expected = format!("the full field has {r}x{c} tiles; use 1x1 to {r}x{c}");
            return Err(Error::invalid(
                crate::Setting::Grid,
                format!("{rows}x{columns}"),
                expected,
            ));
        }
        self.field.crop = ([rows, columns] != self.field.grid).then_some([rows, columns]);
        Ok(self)
    }

    /// The resolved recipe as TOML; [`Recipe::from_toml_str`] with no difficulty reads it back.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|e| format!("# cannot be written as TOML: {e}\n"))
    }
}

/// A value outside its limits.
#[derive(Debug)]
pub(super) struct Fault {
    pub key: String,
    pub value: String,
    pub expected: String,
}

/// Where a recipe came from, for errors.
struct Source<'a> {
    path: PathBuf,
    text: &'a str,
    difficulty: Option<Difficulty>,
}

impl Source<'_> {
    fn syntax_error(&self, error: &toml::de::Error, text: &str) -> Error {
        let start = error.span().map_or(0, |s| s.start.min(text.len()));
        let line = text.as_bytes()[..start].iter().filter(|&&b| b == b'\n').count() + 1;
        Error::parse(&self.path, line, error.message())
    }

    /// The table of the chosen difficulty.
    fn tier(
        &self,
        tiers: Option<toml::Value>,
        difficulty: Option<Difficulty>,
    ) -> Result<Option<toml::Table>> {
        let line = self.line_of("difficulty");
        let fail = |message: String| Err(Error::parse(&self.path, line, message));
        let mut tiers = match (tiers, difficulty) {
            (None, None) => return Ok(None),
            (Some(toml::Value::Table(t)), Some(_)) => t,
            (Some(_), Some(_)) => return fail("`difficulty` is not a table".into()),
            (Some(_), None) => return fail("say which difficulty: easy, medium or hard".into()),
            (None, Some(d)) => {
                return fail(format!("there is no [difficulty.{}]; give no difficulty", d.name()));
            }
        };
        let known = Difficulty::ALL.map(Difficulty::name);
        if let Some(key) = tiers.keys().find(|k| !known.contains(&k.as_str())) {
            return Err(self.unknown_key(key, known.into_iter()));
        }
        match difficulty.and_then(|d| tiers.remove(d.name())) {
            Some(toml::Value::Table(t)) => Ok(Some(t)),
            Some(_) => fail("a difficulty has to be a table".into()),
            None => fail("the recipe has no table for this difficulty".into()),
        }
    }

    /// An error of deserialisation.
    fn value_error(&self, error: &toml::de::Error) -> Error {
        let (key, explained) = explain(error);
        let last = key.as_deref().and_then(|key| key.rsplit('.').next());
        Error::parse(&self.path, last.map_or(0, |key| self.line_of(key)), explained)
    }

    fn unknown_key<'k>(&self, key: &str, known: impl Iterator<Item = &'k str> + Clone) -> Error {
        Error::parse(&self.path, self.line_of(key), unknown_key(key, known))
    }

    /// The line that mentions `key`: in the table of the difficulty if there, else the first. 0 if
    /// there is none.
    fn line_of(&self, key: &str) -> usize {
        let word = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
        let mentions = |line: &str| {
            let code = line.split('#').next().unwrap_or("");
            code.split(|c| !word(c)).any(|w| w == key)
        };
        let header = self.difficulty.map(|d| format!("[difficulty.{}", d.name()));
        let (mut first, mut inside) = (0, false);
        for (n, line) in self.text.lines().enumerate() {
            if line.starts_with('[') {
                inside = header.as_ref().is_some_and(|h| line.starts_with(h));
            }
            match mentions(line) {
                true if inside => return n + 1,
                true if first == 0 => first = n + 1,
                _ => {}
            }
        }
        first
    }
}

/// A crystal turned so that the beam runs along `zone_axis`.
///
/// # Errors
/// As [`Structure::oriented`], and those of the crystal's file.
pub(super) fn oriented(
    crystal: &CrystalSource,
    zone_axis: &str,
    y_axis: Option<&str>,
) -> Result<Structure> {
    let zone = orientation::parse(zone_axis)
        .map_err(|e| Error::invalid(crate::Setting::Zone, zone_axis, e))?;
    let up = match y_axis {
        Some(text) => Some(
            orientation::parse(text).map_err(|e| Error::invalid(crate::Setting::Up, text, e))?,
        ),
        None => None,
    };
    crystal.structure()?.oriented(zone, up)
}

/// Name and text of a recipe that comes with the program.
fn built_in_text(material: &str) -> Result<(&'static str, &'static str)> {
    let known = BUILT_IN.iter().find(|(name, _)| *name == material.to_ascii_lowercase());
    known.copied().ok_or_else(|| {
        let near = recipe_check::nearest(material, Recipe::built_in());
        let names = Recipe::built_in().collect::<Vec<_>>().join(", ");
        let hint = near.map(|n| format!("did you mean `{n}`? ")).unwrap_or_default();
        Error::invalid(
            crate::Setting::Material,
            material,
            format!("{hint}known materials: {names}"),
        )
    })
}

/// The dotted key that an error of deserialisation is about, if any, and what to say of it; serde's
/// list of fields yields the nearest known key.
fn explain(error: &toml::de::Error) -> (Option<String>, String) {
    let text = error.to_string();
    let place = text.lines().find_map(|l| l.strip_prefix("in `")?.strip_suffix('`'));
    let quoted: Vec<&str> = error.message().split('`').skip(1).step_by(2).collect();
    let within = |key: &str| place.map_or(key.to_owned(), |place| format!("{place}.{key}"));
    let message = error.message().trim();
    match quoted.split_first() {
        Some((key, known)) if message.starts_with("unknown field") => {
            (Some(within(key)), unknown_key(key, known.iter().copied()))
        }
        Some((key, _)) if message.starts_with("missing field") => {
            (Some(within(key)), message.to_owned())
        }
        _ => {
            let message = message
                .replace("expected f64", "expected a number")
                .replace("expected usize", "expected a whole number")
                .replace("expected u64", "expected a whole number")
                .replace("expected u32", "expected a whole number");
            let prefix = place.map(|place| format!("{place}: ")).unwrap_or_default();
            (place.map(str::to_owned), prefix + &message)
        }
    }
}

fn unknown_key<'k>(key: &str, known: impl Iterator<Item = &'k str> + Clone) -> String {
    match recipe_check::nearest(key, known.clone()) {
        Some(near) => format!("unknown key `{key}`; did you mean `{near}`?"),
        None => format!("unknown key `{key}`; known: {}", known.collect::<Vec<_>>().join(", ")),
    }
}

/// The error of the change that a fault of `key` comes from: the last that sets it, or a part of it,
/// or else the last of all.
fn at_fault(changes: &[Override], key: Option<String>, message: String) -> Error {
    let named = key.and_then(|key| changes.iter().rev().find(|c| c.concerns(&key)));
    match named.or(changes.last()) {
        Some(change) => change.error(message),
        None => Error::invalid(crate::Setting::Recipe, "", message),
    }
}

/// Lays `over` over `base`, table by table.
pub(super) fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(more)) => merge(inner, more),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}
