//! How the images of a world were made, and how the images of a recipe would be made.

use crate::engine::Settings;
use crate::error::{Error, Result};
use crate::imaging::{Cache, ImagingChoice, MethodChoice, Simulator};
use crate::io::WorldFile;
use crate::recipe::{CheckedRecipe, Recipe};
use crate::world::BuildOptions;

/// How a world was made.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldEngine {
    /// Name of the engine.
    pub engine: String,
    /// Its settings.
    pub settings: Settings,
}

impl WorldEngine {
    /// Reads the recipe of a world, not yet checked, and how the world was made.
    ///
    /// # Errors
    /// [`Error::Parse`] for a world without a recipe, and for settings of another program.
    pub fn of_world(world: &WorldFile) -> Result<(Recipe, Option<Self>)> {
        let refused = |why: String| Error::parse(world.path(), 0, why);
        let metadata = world.metadata();
        let Some(text) = &metadata.recipe else {
            let why = "holds no recipe, so it cannot be simulated again: it was recorded, or made by another program";
            return Err(refused(why.into()));
        };
        let recipe = Recipe::from_toml_str(&world.path().display().to_string(), text, None)?;
        let settings = metadata.engine_parameters.as_deref().map(serde_json::from_str).transpose();
        let settings = settings.map_err(|e| {
            refused(format!("this version of the program cannot read its engine_parameters: {e}"))
        })?;
        let made = metadata.engine.clone().zip(settings);
        Ok((recipe, made.map(|(engine, settings)| WorldEngine { engine, settings })))
    }
}

/// Returns how the images of a world were made, or how the images of a recipe would be made.
///
/// # Errors
/// Errors of the policy of builds.
pub fn imaging_of(
    recipe: &CheckedRecipe,
    made: Option<&WorldEngine>,
    cache: Cache,
) -> Result<ImagingChoice> {
    let Some(made) = made else {
        return Ok(BuildOptions { cache, ..BuildOptions::default() }.policy(recipe)?.imaging);
    };
    let method = match made.engine.as_str() {
        "mosaic" | "film" => MethodChoice::Mosaic,
        _ => MethodChoice::Direct,
    };
    Ok(ImagingChoice { simulator: Simulator::of(made.settings.clone()), method, cache })
}

/// Returns the imaging of a world that has not been built: a mosaic or a film, with windows as builds choose them.
///
/// # Errors
/// Errors of the policy of builds.
pub(crate) fn planned_imaging(
    recipe: &CheckedRecipe,
    cache: Cache,
    window_angstrom: Option<f64>,
) -> Result<ImagingChoice> {
    let options = BuildOptions { cache, window_angstrom, ..BuildOptions::default() };
    let policy = options.policy(recipe)?;
    Ok(match policy.imaging.method {
        MethodChoice::Auto => ImagingChoice { method: MethodChoice::Mosaic, ..policy.imaging },
        _ => policy.imaging,
    })
}
