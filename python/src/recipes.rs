//! Resolves and checks recipes. Python holds a recipe as TOML that contains its crystals.

use crate::errors::{Fault, OrRaise};
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::acquisition::{AcquisitionTable, Profile};
use stemgen::recipe::{CheckedRecipe, Difficulty, Override, Recipe};
use stemgen::{Error, Setting};

use crate::words::choice;

/// The source of a recipe.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct RecipeSource {
    /// Name of a shipped recipe.
    name: Option<String>,
    /// Path of a TOML file, or of a file of atoms.
    path: Option<PathBuf>,
    /// TOML. Paths of crystals are relative to the current folder.
    text: Option<String>,
    difficulty: Option<String>,
}

/// Changes of a recipe.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Changes {
    /// `key=value`, in TOML; or a key alone, which is removed.
    set: Vec<String>,
    grid: Option<[usize; 2]>,
    seed: Option<u64>,
    /// Name of a profile of the recording.
    acquisition: Option<String>,
}

/// The tiers, by name.
const TIERS: [(&str, Difficulty); 3] =
    [("easy", Difficulty::Easy), ("medium", Difficulty::Medium), ("hard", Difficulty::Hard)];

/// Returns the profile with a name.
pub fn profile(name: &str) -> Result<Profile, Fault> {
    let known = [("ideal", Profile::Ideal), ("routine", Profile::Routine), ("poor", Profile::Poor)];
    choice(Setting::Acquisition, name, &known)
}

impl RecipeSource {
    fn recipe(&self) -> Result<Recipe, Fault> {
        let tier = self.difficulty.as_deref();
        let tier = tier.map(|tier| choice(Setting::Difficulty, tier, &TIERS)).transpose()?;
        match (&self.name, &self.path, &self.text) {
            (Some(name), ..) => self.built_in(name, tier),
            (_, Some(path), _) => Ok(Recipe::from_file(path, tier)?),
            (.., text) => {
                let text = text.as_deref().unwrap_or_default();
                Ok(Recipe::from_toml_str("recipe", text, tier)?)
            }
        }
    }

    fn built_in(&self, name: &str, tier: Option<Difficulty>) -> Result<Recipe, Fault> {
        let tiers = Recipe::tiers(name)?;
        if tier.is_none() && !tiers.is_empty() {
            let names: Vec<String> = tiers.iter().map(|t| format!("\"{}\"", t.name())).collect();
            let expected = format!("{name} comes in tiers; choose one of {}", names.join(", "));
            return Err(Fault::Value(Setting::Difficulty, "None".into(), expected));
        }
        Ok(Recipe::load(name, tier)?)
    }
}

impl Changes {
    fn apply(&self, recipe: Recipe) -> Result<Recipe, Fault> {
        let change = |text: &String| match text.contains('=') {
            true => text.parse::<Override>(),
            false => Override::without(text),
        };
        let changes = self.set.iter().map(change).collect::<Result<Vec<Override>, Error>>()?;
        let mut recipe = recipe.with_overrides(&changes)?;
        recipe.seed = self.seed.unwrap_or(recipe.seed);
        if let Some([rows, columns]) = self.grid {
            recipe = recipe.with_grid(rows, columns)?;
        }
        if let Some(name) = &self.acquisition {
            let table = recipe.acquisition.unwrap_or_default();
            recipe.acquisition = Some(AcquisitionTable { profile: Some(profile(name)?), ..table });
        }
        Ok(recipe)
    }
}

/// Resolves, changes and checks a recipe. Returns it as TOML.
#[pyfunction]
pub fn resolve_recipe(py: Python<'_>, source: RecipeSource, changes: Changes) -> PyResult<String> {
    let resolved = py.detach(|| -> Result<String, Fault> {
        Ok(changes.apply(source.recipe()?)?.checked()?.to_toml())
    });
    resolved.or_raise(py)
}

/// Reads a resolved recipe.
///
/// # Errors
/// Errors of the recipe.
pub fn checked(toml: &str) -> Result<CheckedRecipe, Fault> {
    Ok(Recipe::from_toml_str("recipe", toml, None)?.checked()?)
}

/// Lists the shipped recipes with their tiers.
#[pyfunction]
pub fn recipes(py: Python<'_>) -> PyResult<Vec<(String, Vec<String>)>> {
    let tiers = |name: &'static str| {
        let tiers = Recipe::tiers(name)?;
        Ok((name.to_owned(), tiers.iter().map(|tier| tier.name().to_owned()).collect()))
    };
    let all = Recipe::built_in().map(tiers).collect::<Result<_, Error>>();
    all.or_raise(py)
}

/// Returns the derived values of a recipe: a dict of pixels, field and places.
#[pyfunction]
pub fn describe_recipe(py: Python<'_>, toml: &str) -> PyResult<String> {
    let recipe = checked(toml).or_raise(py)?;
    let field = &recipe.field;
    let shape = field.pixels(field.built_grid());
    let facts = serde_json::json!({
        "id": recipe.id,
        "tier": recipe.tier.map(|tier| tier.name()),
        "seed": recipe.seed,
        "grid": field.built_grid(),
        "shape": shape,
        "pixel_nm": field.pixel_nm(),
        "fov_nm": shape.map(|n| n as f64 * field.pixel_nm()),
        "configurations": recipe.phonons.configurations.max(1),
        "dose_electrons_per_angstrom2": recipe.dose.electrons_per_angstrom2,
    });
    Ok(facts.to_string())
}
