//! `stemgen show-recipe`.

use super::recipe_args::RecipeArgs;
use super::text;
use clap::Args;

const EXAMPLES: &str = "\
Examples:
  Print all keys and values of a tier:
    stemgen show-recipe srtio3 --difficulty hard
  Check a change, and print the changed recipe:
    stemgen show-recipe srtio3 --difficulty hard --set vacancies.rate=0.02 --grid 2x2
  Write a recipe file to start from, and build it:
    stemgen show-recipe srtio3 --difficulty easy > mine.toml
    stemgen build --recipe mine.toml";

/// Print a recipe as TOML, with its tier and all changes applied
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ShowRecipe {
    #[command(flatten)]
    recipe: RecipeArgs,
}

impl ShowRecipe {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        text::print(self.recipe.resolve()?.to_toml().trim_end())
    }
}
