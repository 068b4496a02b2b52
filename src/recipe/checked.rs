//! Recipes whose values have been checked against all limits.

use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;

use super::checking;
use super::difficulty::Difficulty;
use super::fault::Fault;
use super::oriented_crystals::OrientedCrystals;
use super::origin::RecipeText;
use super::resolved_recipe::Recipe;
use super::stacked_crystals::StackedCrystals;
use crate::error::{Error, Result};
use crate::models::particles::Metal;
use crate::structure::columns::ColumnCrystal;
use crate::structure::{LabelledAtoms, Structure};

/// A recipe whose values are within their limits, with its crystals read and oriented. A specimen can only be made from a checked recipe.
///
/// It dereferences to [`Recipe`] and cannot be changed; to change values, take [`CheckedRecipe::recipe`] and check the result again. A
/// clone shares all data.
#[derive(Debug, Clone)]
pub struct CheckedRecipe(Arc<Parts>);

#[derive(Debug)]
struct Parts {
    recipe: Recipe,
    crystals: Arc<OrientedCrystals>,
}

impl Deref for CheckedRecipe {
    type Target = Recipe;
    fn deref(&self) -> &Recipe {
        &self.0.recipe
    }
}

impl CheckedRecipe {
    /// Loads a recipe that is installed with the program, at one of its [`Recipe::tiers`].
    ///
    /// # Errors
    /// As [`Recipe::load`] and [`Recipe::checked`].
    pub fn load(material: &str, difficulty: impl Into<Option<Difficulty>>) -> Result<Self> {
        Recipe::load(material, difficulty)?.checked()
    }

    /// Reads a recipe from a file, and checks it.
    ///
    /// # Errors
    /// As [`Recipe::from_file`] and [`Recipe::checked`].
    pub fn from_file(path: &Path, difficulty: Option<Difficulty>) -> Result<Self> {
        Recipe::from_file(path, difficulty)?.checked()
    }

    /// Returns the recipe, whose clone can be changed.
    pub fn recipe(&self) -> &Recipe {
        &self.0.recipe
    }

    /// Returns this recipe with another seed, on which neither limits nor crystals depend.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a seed that TOML cannot hold.
    pub fn with_seed(&self, seed: u64) -> Result<Self> {
        let mut recipe = self.0.recipe.clone();
        recipe.seed = seed;
        match checking::check_seed("seed", seed) {
            Ok(()) => {
                let crystals = Arc::clone(&self.0.crystals);
                Ok(CheckedRecipe(Arc::new(Parts { recipe, crystals })))
            }
            Err(fault) => Err(recipe.error_of(fault)),
        }
    }

    /// Returns the crystal in a box whose z axis is the zone axis; lengths in Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for particles, each of which has its own orientation, and for the atoms of a file.
    pub(crate) fn structure(&self) -> Result<&Structure> {
        match &*self.0.crystals {
            OrientedCrystals::Columns { structure, .. } => Ok(structure),
            _ => Err(self.lacks("crystal along a zone axis")),
        }
    }

    /// Returns that crystal as columns of atoms along the beam.
    ///
    /// # Errors
    /// As [`CheckedRecipe::structure`].
    pub(crate) fn columns(&self) -> Result<&ColumnCrystal> {
        match &*self.0.crystals {
            OrientedCrystals::Columns { columns, .. } => Ok(columns),
            _ => Err(self.lacks("crystal along a zone axis")),
        }
    }

    /// Returns the second phase of domains, or the end member of an alloy, in a box whose z axis is the zone axis.
    ///
    /// # Errors
    /// [`Error::Invalid`] for other specimens.
    pub(crate) fn second_crystal(&self) -> Result<&Structure> {
        match &*self.0.crystals {
            OrientedCrystals::Columns { second: Some(second), .. } => Ok(second),
            _ => Err(self.lacks("second crystal")),
        }
    }

    /// Returns atomic number and lattice of the metal of particles.
    ///
    /// # Errors
    /// [`Error::Invalid`] for other specimens.
    pub(crate) fn metal(&self) -> Result<(u8, &Metal)> {
        match &*self.0.crystals {
            OrientedCrystals::Particles { number, metal } => Ok((*number, metal)),
            _ => Err(self.lacks("particles")),
        }
    }

    /// Returns the atoms of the file.
    ///
    /// # Errors
    /// [`Error::Invalid`] for other specimens.
    pub(crate) fn atoms(&self) -> Result<&Arc<LabelledAtoms>> {
        match &*self.0.crystals {
            OrientedCrystals::Atoms(atoms) => Ok(atoms),
            _ => Err(self.lacks("file of atoms")),
        }
    }

    /// Returns the layers of a stack, in their places.
    ///
    /// # Errors
    /// [`Error::Invalid`] for other specimens.
    pub(crate) fn stack(&self) -> Result<&Arc<StackedCrystals>> {
        match &*self.0.crystals {
            OrientedCrystals::Stack(stack) => Ok(stack),
            _ => Err(self.lacks("layers")),
        }
    }

    /// Returns warnings about the files of crystals and atoms, as sentences for the user.
    ///
    /// # Errors
    /// Errors of the files of crystals.
    pub(crate) fn notes(&self) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        for crystal in self.crystals() {
            notes.extend(crystal.notes()?);
        }
        let (Some(table), OrientedCrystals::Atoms(atoms)) =
            (&self.0.recipe.atoms, &*self.0.crystals)
        else {
            return Ok(notes);
        };
        notes.extend(atoms.notes.iter().map(|note| format!("{}: {note}", table.file)));
        if self.phonons.sigma_angstrom.values().all(|sigma| *sigma == 0.0) {
            notes.push(format!(
                "{}: no atom vibrates, since phonons.sigma_angstrom is 0 for all elements: the image lacks the thermal diffuse \
                 scattering, most of what an annular detector sees at high angles. Give the standard deviations in A, and \
                 phonons.configurations of 8 or more",
                table.file
            ));
        }
        Ok(notes)
    }

    fn lacks(&self, what: &str) -> Error {
        Error::invalid(
            crate::Setting::Recipe,
            self.structure.name(),
            format!("specimens of this kind have no {what}"),
        )
    }
}

impl Recipe {
    /// Checks every value against its limits, and reads the crystals.
    ///
    /// # Errors
    /// [`Error::Set`] naming the change at fault; [`Error::Parse`] with the line of a value as it was written; else [`Error::Invalid`]
    /// naming the key; and errors of the crystals' files.
    pub fn checked(self) -> Result<CheckedRecipe> {
        match checking::check(&self) {
            Ok(crystals) => {
                let crystals = Arc::new(crystals);
                Ok(CheckedRecipe(Arc::new(Parts { recipe: self, crystals })))
            }
            Err(fault) => Err(self.error_of(fault)),
        }
    }

    /// Converts a fault to an error that names the change that set the key, or the line of the key, or the recipe.
    fn error_of(&self, Fault { key, value, expected }: Fault) -> Error {
        let changes = &self.origin.changes;
        let assignment = format!("{key} = {value}");
        if let Some(change) = changes.iter().rev().find(|c| c.concerns(&key)) {
            return change.error(format!("{assignment}: {expected}"));
        }
        match self.origin.text.as_ref().filter(|_| changes.is_empty()) {
            Some(text) if self.value(&key) == text.recipe().and_then(|r| r.value(&key)) => {
                let line = text.line_of_key(&key);
                Error::parse(&text.path, line, format!("{assignment}: {expected}"))
            }
            _ => Error::invalid(crate::Setting::Recipe, assignment, expected),
        }
    }

    /// Returns the value of a dotted key.
    fn value(&self, key: &str) -> Option<toml::Value> {
        value_at(&toml::Table::try_from(self).ok()?, key)
    }
}

impl RecipeText {
    /// Returns the recipe as it was written, if it can be read.
    fn recipe(&self) -> Option<Recipe> {
        self.table().ok()?.try_into().ok()
    }
}

/// Returns the value of a dotted key of a table.
fn value_at(table: &toml::Table, key: &str) -> Option<toml::Value> {
    match key.split_once('.') {
        Some((first, rest)) => value_at(table.get(first)?.as_table()?, rest),
        None => table.get(key).cloned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_seed_is_the_same_recipe_checked_again() {
        for material in ["batio3", "sige", "pt"] {
            let recipe = CheckedRecipe::load(material, Difficulty::Hard).unwrap();
            let mut other = recipe.recipe().clone();
            other.seed = 77;
            let again = other.clone().checked().unwrap();
            let with_seed = recipe.with_seed(77).unwrap();
            assert_eq!(format!("{with_seed:?}"), format!("{again:?}"), "{material}");
            other.seed = u64::MAX;
            let message = recipe.with_seed(u64::MAX).unwrap_err().to_string();
            assert_eq!(message, other.checked().unwrap_err().to_string());
            assert!(message.contains("seed = 18446744073709551615"), "{message}");
        }
    }
}
