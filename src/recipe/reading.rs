//! Reads recipes from TOML: recipes installed with the program, files, and changes of their values.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::atoms_table::is_atoms_file;
use super::difficulty::Difficulty;
use super::origin::{NO_ARRAY, RecipeText, array_for_table};
use super::overrides::Override;
use super::resolved_recipe::Recipe;
use super::stack_table::StackTable;
use super::toml_errors::{explain, nearest};
use crate::error::{Error, Result};
use crate::files::whole_file;

/// Largest size of a recipe in bytes: a resolved recipe holds the file of its crystal.
const LARGEST_FILE: usize = 64 << 20;

/// Recipes that are installed with the program: name and text.
const BUILT_IN: &[(&str, &str)] = &[
    ("srtio3", include_str!("../../generate/srtio3.toml")),
    ("batio3", include_str!("../../generate/batio3.toml")),
    ("sige", include_str!("../../generate/sige.toml")),
    ("gan", include_str!("../../generate/gan.toml")),
    ("pt", include_str!("../../generate/pt.toml")),
    ("mos2", include_str!("../../generate/mos2.toml")),
    ("wse2", include_str!("../../generate/wse2.toml")),
    ("graphene", include_str!("../../generate/graphene.toml")),
    ("replay", include_str!("../../generate/replay.toml")),
    ("test", include_str!("../../generate/test.toml")),
];

impl Recipe {
    /// Returns the names of the recipes that are installed with the program.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// Loads a recipe that is installed with the program, at one of its [`Recipe::tiers`].
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown material, naming the nearest; [`Error::Parse`] for a tier
    /// that it lacks.
    pub fn load(material: &str, difficulty: impl Into<Option<Difficulty>>) -> Result<Self> {
        let (name, text) = built_in_text(material)?;
        Recipe::from_toml_str(&format!("generate/{name}.toml"), text, difficulty.into())
    }

    /// Returns the tiers of a recipe that is installed with the program; empty if it describes a single world.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown material, naming the nearest.
    pub fn tiers(material: &str) -> Result<Vec<Difficulty>> {
        let (_, text) = built_in_text(material)?;
        Recipe::tiers_in(material, text)
    }

    /// Returns the tiers of a recipe in TOML; `name` is used in errors.
    ///
    /// # Errors
    /// [`Error::Invalid`] for bad syntax.
    pub(crate) fn tiers_in(name: &str, text: &str) -> Result<Vec<Difficulty>> {
        let table: toml::Table = toml::from_str(text)
            .map_err(|e| Error::invalid(crate::Setting::Recipe, name, e.message()))?;
        let tiers = table.get("difficulty").and_then(toml::Value::as_table);
        let there = |d: &Difficulty| tiers.is_some_and(|t| t.contains_key(d.name()));
        Ok(Difficulty::ALL.into_iter().filter(there).collect())
    }

    /// Returns the tiers of a recipe in a file.
    ///
    /// # Errors
    /// [`Error::Io`], and [`Error::Parse`] for text that is no recipe.
    pub fn tiers_of_file(path: &Path) -> Result<Vec<Difficulty>> {
        if is_atoms_file(path) {
            return Ok(Vec::new());
        }
        let text = whole_file::read_text(path, LARGEST_FILE)?;
        Recipe::tiers_in(&path.display().to_string(), &text)
    }

    /// Reads a recipe from a file; for a file of atoms, makes a recipe of these atoms.
    ///
    /// # Errors
    /// [`Error::Io`], or as [`Recipe::from_toml_str`], and errors of reading atoms.
    pub fn from_file(path: &Path, difficulty: Option<Difficulty>) -> Result<Self> {
        if is_atoms_file(path) {
            return match difficulty {
                None => Recipe::of_atoms_file(path),
                Some(tier) => {
                    let expected = "a file of atoms has no tiers; give no difficulty";
                    Err(Error::invalid(crate::Setting::Difficulty, tier.name(), expected))
                }
            };
        }
        let text = whole_file::read_text(path, LARGEST_FILE)?;
        Recipe::from_toml_str(&path.display().to_string(), &text, difficulty)
    }

    /// Parses a recipe and applies the table of `difficulty`; `name` is used in errors. A text without tables of difficulty (a resolved
    /// recipe) takes `None`.
    ///
    /// # Errors
    /// [`Error::Parse`] with the line, for bad syntax and unknown keys. Limits are checked by
    /// [`Recipe::checked`].
    pub fn from_toml_str(name: &str, text: &str, difficulty: Option<Difficulty>) -> Result<Self> {
        let source = RecipeText { path: PathBuf::from(name), text: text.to_owned(), difficulty };
        let mut recipe: Recipe =
            source.table()?.try_into().map_err(|e: toml::de::Error| source.value_error(&e))?;
        let folder = source.path.parent().unwrap_or(Path::new("")).to_owned();
        let named = |key: &str, last: &str, error: Error| match error {
            Error::Invalid { value, expected, .. } => {
                let line = source.line_of(last);
                Error::parse(&source.path, line, format!("{key} = {value}: {expected}"))
            }
            other => other,
        };
        recipe.read_crystals(&folder).map_err(|e| named("crystal", "crystal", e))?;
        recipe.find_atoms(&folder).map_err(|e| named("atoms.file", "file", e))?;
        recipe.origin.text = Some(Arc::new(source));
        recipe.origin.folder = folder;
        Ok(recipe)
    }

    /// Reads the files of the user's crystals, relative to `folder`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown crystal, [`Error::Io`].
    pub(crate) fn read_crystals(&mut self, folder: &Path) -> Result<()> {
        for crystal in self.stack.iter_mut().flat_map(StackTable::crystals_mut) {
            crystal.read(folder)?;
        }
        if self.structure.lacks_crystal() {
            return Ok(());
        }
        self.crystal.read(folder)?;
        if let Some(domains) = &mut self.domains {
            domains.crystal.read(folder)?;
        }
        match &mut self.alloy {
            Some(alloy) => alloy.end_member.read(folder),
            None => Ok(()),
        }
    }

    /// Finds the file of atoms relative to `folder`, and records its digest.
    fn find_atoms(&mut self, folder: &Path) -> Result<()> {
        self.atoms.as_mut().map_or(Ok(()), |atoms| atoms.find(folder))
    }

    /// Returns the recipe with some values changed, in the order given.
    ///
    /// # Errors
    /// [`Error::Set`] that names the change at fault.
    pub fn with_overrides(&self, changes: &[Override]) -> Result<Self> {
        if changes.is_empty() {
            return Ok(self.clone());
        }
        let mut table: toml::Table = toml::from_str(&self.to_toml())
            .map_err(|e| Error::invalid(crate::Setting::Recipe, &self.id, e.message()))?;
        changes.iter().try_for_each(|change| change.apply(&mut table))?;
        if let Some(key) = array_for_table(&table) {
            return Err(at_fault(changes, Some(key.to_owned()), format!("{key}: {NO_ARRAY}")));
        }
        let mut recipe: Recipe = table.try_into().map_err(|e: toml::de::Error| {
            let (key, message) = explain(&e);
            at_fault(changes, key, message)
        })?;
        recipe.read_crystals(Path::new(""))?;
        if let (Some(atoms), Some(before)) = (&mut recipe.atoms, &self.atoms) {
            atoms.forget_another(before);
        }
        recipe.find_atoms(Path::new(""))?;
        recipe.origin = self.origin.clone();
        recipe.origin.changes.extend(changes.iter().cloned());
        Ok(recipe)
    }
}

/// Returns name and text of a recipe that is installed with the program.
fn built_in_text(material: &str) -> Result<(&'static str, &'static str)> {
    let known = BUILT_IN.iter().find(|(name, _)| *name == material.to_ascii_lowercase());
    known.copied().ok_or_else(|| {
        let near = nearest(material, Recipe::built_in());
        let names = Recipe::built_in().collect::<Vec<_>>().join(", ");
        let hint = near.map(|n| format!("did you mean `{n}`? ")).unwrap_or_default();
        Error::invalid(
            crate::Setting::Material,
            material,
            format!("{hint}known materials: {names}"),
        )
    })
}

/// Returns the error of the change that causes a fault of `key`: the last change that sets the key, or a part of it, or else the last of
/// all.
fn at_fault(changes: &[Override], key: Option<String>, message: String) -> Error {
    let named = key.and_then(|key| changes.iter().rev().find(|c| c.concerns(&key)));
    match named.or(changes.last()) {
        Some(change) => change.error(message),
        None => Error::invalid(crate::Setting::Recipe, "", message),
    }
}
