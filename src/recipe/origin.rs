//! The origin of a recipe's values, so that errors can name the line or the change at fault.

use std::path::PathBuf;
use std::sync::Arc;

use super::atoms_table::NO_CRYSTAL;
use super::difficulty::Difficulty;
use super::overrides::{Override, merge};
use super::tables::StructureKind;
use super::toml_errors::{explain, unknown_key};
use crate::error::Error;
use crate::error::Result;

/// The text that a recipe was read from, and the changes made since. The origin does not count when recipes are compared: all origins are
/// equal.
#[derive(Debug, Clone, Default)]
pub struct RecipeOrigin {
    /// The text; `None` for a recipe that does not come from a text.
    pub(super) text: Option<Arc<RecipeText>>,
    /// The changes, in the order in which they were made.
    pub(super) changes: Vec<Override>,
    /// The folder that the text was read from, which may also hold the files that it names.
    pub(super) folder: PathBuf,
}

impl PartialEq for RecipeOrigin {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Message about an array in place of a table.
pub(super) const NO_ARRAY: &str = "expected a table of keys and values, found an array";

/// The keys of a recipe that may be arrays of tables.
const ARRAYS: [&str; 2] = ["detector", "defects"];

/// Returns the first key of a recipe with an array as its value, if that is not allowed. Arrays lie inside tables, except the arrays of
/// detectors and defects; serde would read an array as a table whose values come in the order of the source.
/// one for a table whose values stand in the order of the source.
pub(super) fn array_for_table(table: &toml::Table) -> Option<&str> {
    table
        .iter()
        .find(|(key, value)| match value {
            // Arrays of tables: other faults in them are reported when they are read.
            toml::Value::Array(list) if ARRAYS.contains(&key.as_str()) => {
                list.iter().any(toml::Value::is_array)
            }
            value => value.is_array(),
        })
        .map(|(key, _)| key.as_str())
}

/// The text of a recipe.
#[derive(Debug)]
pub struct RecipeText {
    /// Path of the file, or the name that errors give in its place.
    pub path: PathBuf,
    /// The text, in TOML.
    pub text: String,
    /// The tier that was chosen.
    pub difficulty: Option<Difficulty>,
}

impl RecipeText {
    /// Returns the table of the resolved recipe: the values of the tier replace the common values.
    ///
    /// # Errors
    /// [`Error::Parse`] with the line.
    pub fn table(&self) -> Result<toml::Table> {
        let mut table: toml::Table =
            toml::from_str(&self.text).map_err(|e| self.syntax_error(&e))?;
        let tiers = table.remove("difficulty");
        if let Some(chosen) = self.tier(tiers, self.difficulty)? {
            merge(&mut table, chosen);
        }
        if let Some(key) = array_for_table(&table) {
            let message = format!("{key}: {NO_ARRAY}");
            return Err(Error::parse(&self.path, self.line_of(key), message));
        }
        if let Some(difficulty) = self.difficulty {
            table.insert("tier".into(), difficulty.name().into());
        }
        let structure = table.get("structure").and_then(toml::Value::as_str);
        if [StructureKind::Atoms, StructureKind::Stack].iter().any(|k| structure == Some(k.name()))
        {
            // The atoms of a file have no crystal, and the layers of a stack have their own.
            for key in ["zone_axis", "crystal"] {
                table.entry(key).or_insert_with(|| NO_CRYSTAL.into());
            }
        }
        Ok(table)
    }

    fn syntax_error(&self, error: &toml::de::Error) -> Error {
        let start = error.span().map_or(0, |s| s.start.min(self.text.len()));
        let line = self.text.as_bytes()[..start].iter().filter(|&&b| b == b'\n').count() + 1;
        Error::parse(&self.path, line, error.message())
    }

    /// Returns the table of the chosen tier.
    fn tier(
        &self,
        tiers: Option<toml::Value>,
        difficulty: Option<Difficulty>,
    ) -> Result<Option<toml::Table>> {
        let line = self.line_of("difficulty");
        let fail = |message: String| Err(Error::parse(&self.path, line, message));
        let mut tiers = match (tiers, difficulty) {
            (None, None) => return Ok(None),
            (Some(toml::Value::Table(t)), _) => t,
            (Some(_), _) => return fail("`difficulty` is not a table".into()),
            (None, Some(d)) => {
                return fail(format!(
                    "there is no [difficulty.{}]: the recipe has no tiers; give no difficulty",
                    d.name()
                ));
            }
        };
        let known = Difficulty::ALL.map(Difficulty::name);
        let there: Vec<&str> = known.into_iter().filter(|k| tiers.contains_key(*k)).collect();
        let there = there.join(", ");
        if let Some(key) = tiers.keys().find(|k| !known.contains(&k.as_str())) {
            return Err(self.unknown_key(key, known.into_iter()));
        }
        let Some(difficulty) = difficulty else {
            let message = format!("choose a tier; the recipe has {there}");
            return Err(Error::choice(&self.path, crate::Setting::Difficulty, message));
        };
        match tiers.remove(difficulty.name()) {
            Some(toml::Value::Table(t)) => Ok(Some(t)),
            Some(_) => fail("a difficulty has to be a table".into()),
            None => fail(format!(
                "there is no [difficulty.{}]; the recipe has {there}",
                difficulty.name()
            )),
        }
    }

    /// Converts an error of deserialisation.
    pub fn value_error(&self, error: &toml::de::Error) -> Error {
        let (key, explained) = explain(error);
        let last = key.as_deref().and_then(|key| key.rsplit('.').next());
        Error::parse(&self.path, last.map_or(0, |key| self.line_of(key)), explained)
    }

    fn unknown_key<'k>(&self, key: &str, known: impl Iterator<Item = &'k str> + Clone) -> Error {
        Error::parse(&self.path, self.line_of(key), unknown_key(key, known))
    }

    /// Returns the line that mentions the last name of a dotted key. For a key such as `stack.layers[2].fit` the line is searched from the
    /// second header `[[stack.layers]]` on.
    pub fn line_of_key(&self, key: &str) -> usize {
        let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
        let numbered = |text: &str| -> Option<(String, usize)> {
            let (name, number) = text.strip_suffix(']')?.split_once('[')?;
            Some((format!("[[{name}]]"), number.parse().ok()?))
        };
        let Some((header, number)) = numbered(path).or_else(|| numbered(key)) else {
            return self.line_of(last);
        };
        let lines = || self.text.lines().enumerate();
        let mut found = lines().filter(|(_, line)| line.starts_with(&header));
        let Some((start, _)) = found.nth(number.max(1) - 1) else {
            return self.line_of(last);
        };
        let table = lines().skip(start + 1).take_while(|(_, line)| !line.starts_with('['));
        let named = table
            .into_iter()
            .find(|(_, line)| line.split('=').next().is_some_and(|name| name.trim() == last));
        1 + named.map_or(start, |(n, _)| n)
    }

    /// Returns the line that mentions `key`: a line in the table of the tier if there is one, else the first line. 0 if no line does.
    pub fn line_of(&self, key: &str) -> usize {
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
