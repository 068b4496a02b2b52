//! A recipe expressed as changes of a recipe that is installed with the program.

use toml::{Table, Value};

use super::difficulty::Difficulty;
use super::overrides::Override;
use super::resolved_recipe::Recipe;
use crate::error::Result;

/// A change of a recipe that is installed with the program.
#[derive(Debug, Clone, PartialEq)]
pub enum RecipeChange {
    /// Sets a value, as text: `vacancies.rate=0.02`.
    Set(String),
    /// Removes a value or a table.
    Unset(String),
}

/// A recipe that is installed with the program, and the changes that turn it into another recipe.
#[derive(Debug, Clone, PartialEq)]
pub struct ShippedRecipe {
    /// Name of the installed recipe.
    pub material: String,
    /// Tier of the installed recipe, if it has tiers.
    pub tier: Option<Difficulty>,
    /// Changes in their order: removed values first.
    pub changes: Vec<RecipeChange>,
    /// Seed, if it is changed.
    pub seed: Option<u64>,
    /// Rows and columns of the central tiles, if not the whole field is taken.
    pub grid: Option<[usize; 2]>,
}

impl Recipe {
    /// Expresses this recipe as changes of the installed recipe of its name. `None` if there is none, or if a difference cannot be written
    /// on one line, for example a crystal of the user.
    pub fn as_shipped(&self) -> Option<ShippedRecipe> {
        let shipped = Recipe::load(&self.id, self.tier).ok()?;
        let table = |recipe: &Recipe| toml::from_str::<Table>(&recipe.to_toml()).ok();
        let (mut base, mut wanted) = (table(&shipped)?, table(self)?);
        for table in [&mut base, &mut wanted] {
            table.remove("seed");
            table.get_mut("field").and_then(Value::as_table_mut).map(|field| field.remove("crop"));
        }
        let mut changes = Vec::new();
        differences("", &base, &wanted, &mut changes)?;
        changes.sort_by_key(|change| matches!(change, RecipeChange::Set(_)));
        let shipped = ShippedRecipe {
            material: self.id.clone(),
            tier: self.tier,
            changes,
            seed: (self.seed != shipped.seed).then_some(self.seed),
            grid: self.field.crop,
        };
        (shipped.recipe().ok()? == *self).then_some(shipped)
    }
}

impl ShippedRecipe {
    /// Returns the recipe that results from the changes.
    ///
    /// # Errors
    /// Errors of [`Recipe::load`], [`Recipe::with_overrides`] and [`Recipe::with_grid`].
    pub(crate) fn recipe(&self) -> Result<Recipe> {
        let changes = self.changes.iter().map(RecipeChange::to_override);
        let shipped = Recipe::load(&self.material, self.tier)?;
        let mut recipe = shipped.with_overrides(&changes.collect::<Result<Vec<_>>>()?)?;
        recipe.seed = self.seed.unwrap_or(recipe.seed);
        match self.grid {
            Some([rows, columns]) => recipe.with_grid(rows, columns),
            None => Ok(recipe),
        }
    }
}

impl RecipeChange {
    fn to_override(&self) -> Result<Override> {
        match self {
            RecipeChange::Set(text) => text.parse(),
            RecipeChange::Unset(key) => Override::without(key),
        }
    }
}

/// Adds the changes that turn the table `base` into `wanted`, below the dotted key `within`; `None` if a change cannot be written on one
/// line.
fn differences(
    within: &str,
    base: &Table,
    wanted: &Table,
    changes: &mut Vec<RecipeChange>,
) -> Option<()> {
    let dotted = |key: &str| match within {
        "" => key.to_owned(),
        _ => format!("{within}.{key}"),
    };
    let gone = base.keys().filter(|key| !wanted.contains_key(*key));
    changes.extend(gone.map(|key| RecipeChange::Unset(dotted(key))));
    for (key, value) in wanted {
        let empty = Table::new();
        match (base.get(key), value) {
            (Some(old), new) if old == new => {}
            (Some(Value::Table(old)), Value::Table(new)) => {
                differences(&dotted(key), old, new, changes)?;
            }
            // Separate values are easier to read than a table on one line.
            (None, Value::Table(new)) if !new.is_empty() => {
                differences(&dotted(key), &empty, new, changes)?;
            }
            (_, new) => changes.push(RecipeChange::Set(setting(&dotted(key), new)?)),
        }
    }
    Some(())
}

/// Writes `key=value`, with a word without quotes if that has the same meaning.
fn setting(key: &str, value: &Value) -> Option<String> {
    if let Value::String(word) = value {
        let plain = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
        let short = format!("{key}={word}");
        if !word.is_empty() && word.chars().all(plain) && means(&short, value) {
            return Some(short);
        }
    }
    let long = format!("{key}={value}");
    means(&long, value).then_some(long)
}

/// Whether a change sets its key to exactly that value.
fn means(change: &str, value: &Value) -> bool {
    let key = change.split('=').next().unwrap_or_default();
    let mut table = Table::new();
    let applied = change.parse::<Override>().and_then(|o| o.apply(&mut table));
    let set = key.split('.').try_fold(&Value::Table(table), |v, part| v.get(part)).cloned();
    applied.is_ok() && set.as_ref() == Some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped(material: &str, tier: Option<Difficulty>, changes: &[&str]) -> ShippedRecipe {
        let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
        let recipe = Recipe::load(material, tier).unwrap().with_overrides(&changes).unwrap();
        let shipped = recipe.as_shipped().unwrap();
        assert_eq!(shipped.recipe().unwrap(), recipe);
        shipped
    }

    #[test]
    fn recipes_are_named_by_their_differences() {
        let easy = Some(Difficulty::Easy);
        assert_eq!(shipped("srtio3", easy, &[]).changes, []);
        let set = |text: &str| RecipeChange::Set(text.into());
        let changed =
            shipped("srtio3", easy, &["vacancies.rate=0.02", "vacancies.element=Ti", "seed=9"]);
        assert_eq!(changed.changes, [set("vacancies.element=Ti"), set("vacancies.rate=0.02")]);
        assert_eq!((changed.seed, changed.grid), (Some(9), None));
        let surface = shipped("srtio3", easy, &["surface.entrance_nm=1.0"]);
        assert!(surface.changes.contains(&set("surface.entrance_nm=1.0")), "{surface:?}");
        let two = "detector=[{name=\"A\", inner_mrad=68.0, outer_mrad=200.0}, {name=\"B\", inner_mrad=10.0, outer_mrad=21.0}]";
        assert_eq!(shipped("gan", easy, &[two]).changes.len(), 1);
        let recipe = Recipe::load("test", None).unwrap().with_grid(1, 2).unwrap();
        let recipe = recipe.with_overrides(&[Override::without("vacancies").unwrap()]).unwrap();
        let shipped = recipe.as_shipped().unwrap();
        assert_eq!(shipped.changes, [RecipeChange::Unset("vacancies".into())]);
        assert_eq!((shipped.grid, shipped.recipe().unwrap()), (Some([1, 2]), recipe));
    }

    #[test]
    fn what_is_no_variant_of_a_shipped_recipe_is_not_named() {
        let mut recipe = Recipe::load("test", None).unwrap();
        recipe.id = "mine".into();
        assert_eq!(recipe.as_shipped(), None);
        let mut recipe = Recipe::load("test", None).unwrap();
        recipe.crystal.name = "own.cif".into();
        recipe.crystal.text = Some("# first\ndata_own\n".into());
        assert_eq!(recipe.as_shipped(), None);
    }
}
