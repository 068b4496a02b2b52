//! The contents of a world file in numbers.

use serde::Serialize;

use crate::acquisition::Acquisition;
use crate::detect::Detector;
use crate::error::Result;
use crate::imaging::Audit;
use crate::io::{RecordedSource, WorldFile};
use crate::recipe::{Difficulty, Recipe};

/// The contents of a world file in numbers. A value that the file does not state is `None`.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct WorldFacts {
    /// Material or identifier of the recipe.
    pub material: Option<String>,
    /// Tier of the recipe.
    pub tier: Option<Difficulty>,
    /// Seed of all random numbers.
    pub seed: Option<u64>,
    /// Origin of the data that readers should state: `synthetic_replay`.
    pub source: Option<String>,
    /// Direction of the beam in the crystal.
    pub zone_axis: Option<String>,
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Height and width in pixels.
    pub pixels: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_size_nm: f64,
    /// Rows and columns of tiles.
    pub tiles: [usize; 2],
    /// Edge of a tile in pixels.
    pub tile_size_px: usize,
    /// Pixels that neighbouring tiles share.
    pub overlap_px: usize,
    /// Thickness of the specimen in nm.
    pub thickness_nm: Option<f64>,
    /// Energy of the electrons in keV.
    pub energy_kev: Option<f64>,
    /// Convergence semiangle in mrad.
    pub convergence_mrad: Option<f64>,
    /// The detectors, the main one first.
    pub detectors: Vec<Detector>,
    /// Number of phonon configurations that the image averages.
    pub phonon_configurations: Option<usize>,
    /// Electrons per square Angstrom.
    pub dose_electrons_per_angstrom2: Option<f64>,
    /// Whether the tiles hold the noise of the dose.
    pub noise: Option<bool>,
    /// Whether the file holds the noise-free image too.
    pub noise_free_image: bool,
    /// The settings of the recording, if the tiles were recorded.
    pub recording: Option<RecordingFacts>,
    /// Origin of the image, if it was recorded at a microscope and not simulated.
    pub recorded: Option<RecordedSource>,
    /// Lattice sites, vacant ones included.
    pub sites: usize,
    /// Vacant sites.
    pub vacancies: u64,
    /// Sites with another element.
    pub substitutions: u64,
    /// Projected atomic columns.
    pub columns: usize,
    /// Lines between grains.
    pub grain_boundaries: usize,
    /// Lines between phases.
    pub phase_boundaries: usize,
    /// Names of the phases, in the order of their codes; empty for a single phase.
    pub phases: Vec<String>,
    /// Particles that reach into the image.
    pub particles: usize,
    /// Name of the engine that simulated the image.
    pub engine: Option<String>,
    /// Settings of the engine.
    pub engine_parameters: Option<serde_json::Value>,
    /// The audit before the build, with the error that it found.
    pub audit: Option<Audit>,
    /// Version of stemgen that built it.
    pub stemgen_version: Option<String>,
    /// Version of the numerics, which changes when pixel values change.
    pub numerics_version: Option<u32>,
    /// Time that the last run of the build took, in s.
    pub wall_time_s: Option<f64>,
}

/// The settings that the tiles of a world were recorded with.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct RecordingFacts {
    /// Current of the beam in pA.
    pub beam_current_pa: Option<f64>,
    /// Settings of scan and detector.
    pub acquisition: Acquisition,
}

impl WorldFacts {
    /// Reads the facts from a world.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a damaged file.
    pub fn of(world: &WorldFile) -> Result<Self> {
        let (m, making) = (world.metadata(), world.making());
        let columns = world.columns()?;
        let sum = |count: fn(&crate::io::WorldColumn) -> i32| -> u64 {
            columns.iter().map(|c| u64::try_from(count(c)).unwrap_or_default()).sum()
        };
        let recipe = m.recipe.as_deref();
        let recipe = recipe.and_then(|text| Recipe::from_toml_str("recipe", text, None).ok());
        let of_recipe = recipe.as_ref().map(|r| r.detector.all()).unwrap_or_default();
        let acquisition = making.acquisition.and_then(|json| serde_json::from_str(&json).ok());
        Ok(WorldFacts {
            material: m.material.clone(),
            tier: recipe.as_ref().and_then(|r| r.tier),
            seed: m.seed,
            source: m.source.clone(),
            zone_axis: recipe.as_ref().map(|r| r.zone_axis.clone()),
            fov_nm: m.fov_nm,
            pixels: world.shape(),
            pixel_size_nm: m.pixel_size_nm,
            tiles: m.grid_shape,
            tile_size_px: m.tile_size_px,
            overlap_px: m.overlap_px,
            thickness_nm: m.thickness_nm,
            energy_kev: recipe.as_ref().map(|r| r.optics.energy_kv),
            convergence_mrad: recipe.as_ref().map(|r| r.optics.convergence_mrad),
            detectors: if m.detectors.is_empty() { of_recipe } else { m.detectors.clone() },
            phonon_configurations: recipe.as_ref().map(|r| r.phonons.configurations),
            dose_electrons_per_angstrom2: m.dose_electrons_per_angstrom2,
            noise: m.noise,
            noise_free_image: world.has_clean(),
            recording: acquisition.map(|acquisition| RecordingFacts {
                beam_current_pa: making.beam_current_pa,
                acquisition,
            }),
            recorded: making.recorded,
            sites: world.site_count()?,
            vacancies: sum(|c| c.vacancies),
            substitutions: sum(|c| c.substitutions),
            columns: columns.len(),
            grain_boundaries: world.boundaries()?.len(),
            phase_boundaries: world.phase_boundaries()?.len(),
            phases: world.phase_names()?,
            particles: world.particles()?.diameters.len(),
            engine: m.engine.clone(),
            engine_parameters: m.engine_parameters.as_deref().and_then(json),
            audit: making.audit.and_then(|a| serde_json::from_str(&a).ok()),
            stemgen_version: m.version.clone(),
            numerics_version: making.numerics_version,
            wall_time_s: m.wall_time_s,
        })
    }
}

fn json(text: &str) -> Option<serde_json::Value> {
    serde_json::from_str(text).ok()
}
