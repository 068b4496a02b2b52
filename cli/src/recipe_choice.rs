//! Several recipes at once: materials and tiers.

use stemgen::recipe::{Difficulty, Recipe};

/// Returns the program's recipes of some materials, or of all, at one tier or at all tiers, ordered by material and tier. If a tier is
/// asked for, a recipe without tiers is returned only if its material is named.
pub fn recipes(
    materials: &[String],
    difficulty: Option<Difficulty>,
) -> anyhow::Result<Vec<Recipe>> {
    let all: Vec<String> = Recipe::built_in().map(str::to_owned).collect();
    let names = if materials.is_empty() { &all } else { materials };
    let mut chosen = Vec::new();
    for name in names {
        let tiers = Recipe::tiers(name)?;
        let tiers: Vec<Option<Difficulty>> = match tiers.is_empty() {
            true if difficulty.is_some() && materials.is_empty() => Vec::new(),
            true => vec![None],
            false => tiers
                .into_iter()
                .map(Some)
                .filter(|t| difficulty.is_none() || *t == difficulty)
                .collect(),
        };
        for tier in tiers {
            chosen.push(Recipe::load(name, tier)?);
        }
    }
    Ok(chosen)
}

/// Returns the name of the world of a recipe: `srtio3_hard`, or `test` for a recipe without tiers.
pub fn world_name(recipe: &Recipe) -> String {
    let tier = recipe.tier.map(|t| format!("_{}", t.name())).unwrap_or_default();
    format!("{}{tier}", recipe.id)
}
