//! Options that choose a recipe and change it.

use super::hdf5_check;
use super::hints::hinted;
use super::recipe_choice::world_name;
use super::values::{self, Tier};
use anyhow::anyhow;
use clap::Args;
use std::path::{Path, PathBuf};
use stemgen::io::WorldFile;
use stemgen::recipe::{CheckedRecipe, Difficulty, Override, Recipe, is_atoms_file};
use stemgen::world::WorldEngine;

/// Holds the options that choose a recipe and change it.
#[derive(Debug, Args)]
#[command(next_help_heading = "Recipe")]
pub struct RecipeArgs {
    /// Recipe of the program (`stemgen list` prints them), or your own file: a recipe (.toml), or atoms (.xyz, .extxyz, .cif,
    /// POSCAR). A recipe describes a specimen and its microscope. `acquire`, `audit` and `tiles` also take a world file (.h5)
    #[arg(value_name = "MATERIAL", required_unless_present = "recipe", help_heading = None)]
    material: Option<String>,
    /// Tier of the recipe: how many defects, and how much dose. Needed if the recipe has tiers
    #[arg(long, value_name = "TIER")]
    difficulty: Option<Tier>,
    /// Recipe file (TOML), in place of MATERIAL. Leave out --difficulty if it has no tiers
    #[arg(long, value_name = "FILE", conflicts_with = "material")]
    recipe: Option<PathBuf>,
    /// Change a value of the recipe, such as vacancies.rate=0.02 (repeatable). `stemgen show-recipe` prints all keys
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Remove a value or a table of the recipe, such as vacancies or boundaries.sigma (repeatable)
    #[arg(long, value_name = "KEY")]
    unset: Vec<String>,
    /// Use only the central tiles of the field, rows x columns [default: the whole field]
    #[arg(long, value_name = "RxC", value_parser = values::rows_columns)]
    grid: Option<[usize; 2]>,
    /// Seed of all random numbers [default: the seed of the recipe]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

impl RecipeArgs {
    /// Returns the chosen recipe, changed and checked.
    pub fn resolve(&self) -> anyhow::Result<CheckedRecipe> {
        self.changed(self.chosen()?)
    }

    /// Applies the other options to a recipe, and checks it.
    pub fn changed(&self, recipe: Recipe) -> anyhow::Result<CheckedRecipe> {
        let mut recipe = recipe.with_overrides(&self.changes()?)?;
        recipe.seed = self.seed.unwrap_or(recipe.seed);
        if let Some([rows, columns]) = self.grid {
            recipe = recipe.with_grid(rows, columns)?;
        }
        Ok(recipe.checked()?)
    }

    /// Returns the chosen recipe, or the recipe of a world file that is named in place of a material, with the engine of that world.
    pub fn resolve_or_world(&self) -> anyhow::Result<(CheckedRecipe, Option<WorldEngine>)> {
        self.resolve_or_world_but(None)
    }

    /// Does the work of [`RecipeArgs::resolve_or_world`], and lets `--set` and `--unset` change one table of a world's recipe that its
    /// specimen and image do not depend on.
    pub fn resolve_or_world_with(
        &self,
        table: &'static str,
    ) -> anyhow::Result<(CheckedRecipe, Option<WorldEngine>)> {
        self.resolve_or_world_but(Some(table))
    }

    fn resolve_or_world_but(
        &self,
        free: Option<&'static str>,
    ) -> anyhow::Result<(CheckedRecipe, Option<WorldEngine>)> {
        let Some(file) = self.world() else {
            return Ok((self.resolve()?, None));
        };
        let is_free = |change: &String| {
            let key = change.split(['.', '=']).next().unwrap_or_default();
            free.is_some_and(|table| key.trim() == table)
        };
        let changes = self.set.iter().chain(&self.unset);
        if self.difficulty.is_some()
            || !changes.clone().all(is_free)
            || self.grid.is_some()
            || self.seed.is_some()
        {
            let but = free.map(|table| format!(" (but of [{table}])")).unwrap_or_default();
            anyhow::bail!(
                "{}: a world has its recipe; leave out --difficulty, --set{but}, --unset, --grid and --seed",
                file.display()
            );
        }
        hdf5_check::check(&file)?;
        let world = WorldFile::open(&file)?;
        let (recipe, made) = WorldEngine::of_world(&world)?;
        Ok((recipe.with_overrides(&self.changes()?)?.checked()?, made))
    }

    /// Opens the world that is named in place of a material, if its file holds no recipe: a recorded image, or an image of another
    /// program.
    pub fn world_without_recipe(&self) -> anyhow::Result<Option<WorldFile>> {
        let Some(file) = self.world().filter(|file| file.is_file()) else { return Ok(None) };
        hdf5_check::check(&file)?;
        let world = WorldFile::open(&file)?;
        if world.metadata().recipe.is_some() {
            return Ok(None);
        }
        if self.difficulty.is_some()
            || !(self.set.is_empty() && self.unset.is_empty())
            || self.grid.is_some()
            || self.seed.is_some()
        {
            anyhow::bail!(
                "{}: is a world without a recipe; leave out --difficulty, --set, --unset, --grid and --seed",
                file.display()
            );
        }
        Ok(Some(world))
    }

    /// Returns the changes of `--unset` and `--set`, in this order.
    fn changes(&self) -> anyhow::Result<Vec<Override>> {
        let removed = self.unset.iter().map(|key| Override::without(key));
        let changed = self.set.iter().map(|text| text.parse());
        Ok(removed.chain(changed).collect::<stemgen::Result<_>>()?)
    }

    /// Returns the world file that is named in place of a material.
    pub fn world(&self) -> Option<PathBuf> {
        self.material.as_ref().map(PathBuf::from).filter(|f| is_world(f))
    }

    /// Returns the file of the recipe, unless it is a recipe of the program.
    fn file(&self) -> Option<PathBuf> {
        let named = || self.material.as_deref().filter(|m| is_recipe_file(m)).map(PathBuf::from);
        self.recipe.clone().or_else(named)
    }

    fn chosen(&self) -> anyhow::Result<Recipe> {
        let difficulty = self.difficulty.map(Difficulty::from);
        if let Some(file) = self.file() {
            return Ok(Recipe::from_file(&file, difficulty)?);
        }
        let Some(material) = &self.material else {
            anyhow::bail!("no recipe is named; give MATERIAL or --recipe FILE");
        };
        let tiers = Recipe::tiers(material)?;
        if difficulty.is_none() && !tiers.is_empty() {
            let names: Vec<&str> = tiers.iter().map(|t| t.name()).collect();
            let fault = anyhow!("{material} comes in tiers, and none is chosen");
            return Err(hinted(fault, format!("add --difficulty {}", names.join("|"))));
        }
        Ok(Recipe::load(material, difficulty)?)
    }

    /// Returns the files that a recipe is read from: the recipe file, and the files of its crystals and atoms.
    pub fn files(&self, recipe: &Recipe) -> Vec<PathBuf> {
        let Some(file) = self.file() else { return Vec::new() };
        let folder = file.parent().unwrap_or(Path::new(""));
        let second = recipe.domains.iter().map(|d| &d.crystal);
        let end = recipe.alloy.iter().map(|a| &a.end_member);
        let crystals = std::iter::once(&recipe.crystal).chain(second).chain(end);
        let crystals = crystals.filter(|c| c.text.is_some()).map(|c| folder.join(&c.name));
        let atoms = recipe.atoms.iter().map(|atoms| PathBuf::from(&atoms.file));
        std::iter::once(file.clone()).chain(crystals).chain(atoms).collect()
    }

    /// Returns the files of the recipe, and a world file that is named in place of a material.
    pub fn inputs(&self, recipe: &Recipe) -> Vec<PathBuf> {
        self.files(recipe).into_iter().chain(self.world()).collect()
    }

    /// Returns `MATERIAL[_TIER][_RxC][_seedN]`, the default name of a result without its ending.
    pub fn stem(&self, recipe: &Recipe) -> String {
        self.stem_of(recipe, self.chosen().ok().map(|r| r.seed))
    }

    /// Returns the default name of a result for a recipe file with the seed `own`.
    pub fn stem_of(&self, recipe: &Recipe, own: Option<u64>) -> String {
        let grid = self.grid.map(|[r, c]| format!("_{r}x{c}")).unwrap_or_default();
        let seed = (own != Some(recipe.seed)).then(|| format!("_seed{}", recipe.seed));
        format!("{}{grid}{}", world_name(recipe), seed.unwrap_or_default())
    }

    /// Returns the file of atoms that is named in place of a material.
    pub fn atoms_file(&self) -> Option<PathBuf> {
        self.material.as_ref().map(PathBuf::from).filter(|file| is_atoms_file(file))
    }

    /// Whether options change the recipe, apart from its seed.
    pub fn changes_recipe(&self) -> bool {
        let changed = !(self.set.is_empty() && self.unset.is_empty());
        changed || self.difficulty.is_some() || self.grid.is_some()
    }

    /// Returns the seed that is asked for.
    pub fn seed(&self) -> Option<u64> {
        self.seed
    }

    /// Returns the tier that is asked for.
    pub fn difficulty(&self) -> Option<Difficulty> {
        self.difficulty.map(Difficulty::from)
    }
}

/// Whether a name is the name of a recipe file, or of a file of atoms, from which a recipe is made.
pub fn is_recipe_file(name: &str) -> bool {
    let path = Path::new(name);
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) || is_atoms_file(path)
}

fn is_world(file: &Path) -> bool {
    file.extension().is_some_and(|e| e == "h5" || e == "hdf5")
}
