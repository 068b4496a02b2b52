//! The options that a world was built with, reconstructed from the metadata of its file.

use super::world_build::WorldBuild;
use crate::engine::{Algorithm, Expansion, Settings};
use crate::error::Result;
use crate::imaging::film::film_imager::film_settings;
use crate::imaging::{Audit, Cache, MethodChoice};
use crate::io::WorldFile;
use crate::recipe::CheckedRecipe;
use crate::world::build_options::{BuildMethod, BuildOptions, BuildProfile};

/// Lengths whose difference in nm is below this value count as equal.
const SAME_NM: f64 = 1e-9;

impl BuildOptions {
    /// Finds the options with the fewest settings that build the tiles and the truth of a world, whose recipe is `recipe`. `None` where the
    /// file does not name its engine, or where no options lead to that engine: with a largest error, the exact engine may have made the
    /// world. Files without the size of sub-tiles are taken to have the usual size.
    ///
    /// # Errors
    /// Errors of laying out the specimen.
    pub fn of_world(world: &WorldFile, recipe: &CheckedRecipe) -> Result<Option<Self>> {
        let (metadata, making) = (world.metadata(), world.making());
        let parameters = metadata.engine_parameters.as_deref();
        let settings = parameters.and_then(|json| serde_json::from_str::<Settings>(json).ok());
        let (Some(engine), Some(settings)) = (metadata.engine.as_deref(), settings) else {
            return Ok(None);
        };
        let audit = making.audit.as_deref().and_then(|a| serde_json::from_str::<Audit>(a).ok());
        let shares = matches!(engine, "mosaic" | "film");
        let regions = audit.map_or(0, |audit| audit.regions.len());
        let (audit_regions, audit_direct) = match regions {
            0 if !shares => (1, false),
            1 if shares => (1, false),
            n => (n, n > 0),
        };
        let usual = BuildOptions {
            noise: metadata.noise.unwrap_or(true),
            keep_clean: world.has_clean(),
            audit_regions,
            audit_direct,
            cache: Cache::none(),
            ..BuildOptions::default()
        };
        for options in usual.variants(engine, &settings) {
            let options = options.with_subtiles(recipe, making.subtile_nm);
            if options.leads_to(recipe, engine, &settings)? {
                return Ok(Some(options));
            }
        }
        Ok(None)
    }

    /// Lists these options with all settings that may have led to an engine, the fewest settings first.
    fn variants(&self, engine: &str, settings: &Settings) -> Vec<BuildOptions> {
        let method = match engine {
            "mosaic" | "film" => BuildMethod::Mosaic,
            "window" => BuildMethod::Window,
            "prism" => BuildMethod::Prism,
            _ => BuildMethod::Multislice,
        };
        let (window, interpolation) = match settings.algorithm {
            Algorithm::Window { width_angstrom } => (Some(width_angstrom), None),
            Algorithm::Prism { interpolation } => (None, Some(interpolation)),
            Algorithm::Multislice => (None, None),
        };
        let mut variants = Vec::new();
        for expansion in [Expansion::Auto, settings.expansion] {
            for number in [false, true] {
                for method in [BuildMethod::Auto, method] {
                    let window_angstrom = window.filter(|_| number);
                    let interpolation = interpolation.filter(|_| number);
                    let own = BuildOptions { expansion, method, ..self.clone() };
                    variants.push(BuildOptions { window_angstrom, interpolation, ..own });
                }
            }
        }
        variants.push(BuildOptions { profile: BuildProfile::Published, ..self.clone() });
        variants
    }

    /// Returns these options with sub-tiles of the given width and overlap.
    fn with_subtiles(self, recipe: &CheckedRecipe, wanted_nm: Option<[f64; 2]>) -> Self {
        let Some([width, overlap]) = wanted_nm else { return self };
        let gives = |options: &BuildOptions| {
            options.policy(recipe).is_ok_and(|policy| {
                let [w, o] = policy.subtile_nm;
                (w - width).abs() < SAME_NM && (o - overlap).abs() < SAME_NM
            })
        };
        let wide = BuildOptions { subtile_nm: Some(width), ..self.clone() };
        let both = BuildOptions { subtile_overlap_nm: Some(overlap), ..wide.clone() };
        [self, wide].into_iter().find(gives).unwrap_or(both)
    }

    /// Whether these options make the images of a recipe with the given engine and settings.
    fn leads_to(&self, recipe: &CheckedRecipe, engine: &str, settings: &Settings) -> Result<bool> {
        // Options that contradict each other cannot have built a world.
        let Ok(policy) = self.policy(recipe) else { return Ok(false) };
        let own = policy.imaging.simulator.settings();
        let own = if engine == "film" { film_settings(own) } else { own.clone() };
        if own != *settings {
            return Ok(false);
        }
        let shares = matches!(engine, "mosaic" | "film");
        Ok(match policy.imaging.method {
            MethodChoice::Direct => !shares && policy.imaging.simulator.name() == engine,
            MethodChoice::Mosaic => shares,
            MethodChoice::Auto if engine == "film" => true,
            MethodChoice::Auto => {
                let library = WorldBuild::new(recipe, self)?.library()?;
                library.is_some() == (engine == "mosaic")
            }
        })
    }
}
