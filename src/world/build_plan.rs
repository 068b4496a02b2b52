//! What a build would do and take.

use std::path::PathBuf;

use serde::Serialize;

use super::WorldBuild;
use super::footprint::PICTURE;
use super::image_plan::report;
use crate::engine::check_memory;
use crate::error::Result;
use crate::imaging::{MethodChoice, MosaicCost, SimulationRuns};
use crate::recipe::Recipe;
use crate::simulation::PlanReport;

/// Processor time in s that laying out, noise and writing take for each pixel of a field: SrTiO3, whole fields, 0.7e-6 to 0.9e-6.
const PIXEL_S: [f64; 2] = [0.4e-6, 1.2e-6];

/// What a build would do and take.
#[derive(Debug, Clone, Serialize)]
pub struct WorldPlan {
    /// Name of the recipe.
    pub material: String,
    /// Zone axis along the beam.
    pub zone_axis: String,
    /// Tiles, rows and columns.
    pub tiles: [usize; 2],
    /// Pixels, rows and columns.
    pub pixels: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Edges of the field, height and width, in nm.
    pub fov_nm: [f64; 2],
    /// Thickness of the specimen in nm.
    pub thickness_nm: f64,
    /// Electrons per square Angstrom.
    pub dose_electrons_per_angstrom2: f64,
    /// Number of sub-tiles.
    pub subtiles: usize,
    /// Edges of a sub-tile in nm.
    pub subtile_nm: [f64; 2],
    /// Distance of probes (x, y) in Angstrom.
    pub probe_step_angstrom: [f64; 2],
    /// The simulation of a sub-tile, or of the library; memory, time and warnings of all.
    #[serde(flatten)]
    pub plan: PlanReport,
    /// What the library of a mosaic takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mosaic: Option<MosaicCost>,
    /// Whether the mosaic is what is built.
    #[serde(skip)]
    pub mosaic_used: bool,
    /// Probes for particles on a film.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub particle_probes: Option<usize>,
    /// Part of the estimated time.
    pub audit_range_s: [f64; 2],
    /// Bytes on the disk at most.
    pub disk_bytes: u64,
    /// The file that would be written.
    pub output: PathBuf,
}

impl WorldPlan {
    /// Plans the build.
    ///
    /// # Errors
    /// Those of the build's plan.
    pub fn new(recipe: &Recipe, build: &WorldBuild, output: PathBuf) -> Result<Self> {
        let cost = build.cost()?;
        let field = &recipe.field;
        let pixels = field.pixels(field.built_grid());
        let pixel = field.pixel_nm();
        let (subtiles, shape) = build.subtiles();
        let mut plan = report(&cost.main);
        let (memory_bytes, remedy) = build.memory(&cost, plan.threads)?;
        plan.memory_bytes = memory_bytes;
        if let Some(more) = &cost.more {
            plan.add_time(report(more).estimated_range_s);
        }
        // The library of a mosaic is planned for single configurations.
        plan.configurations = recipe.phonons.configurations.max(1) as u32;
        let audit = build.audit_cost(&cost)?.map(|audit| report(&audit));
        let audit_range_s = audit.as_ref().map_or([0.0; 2], |a| a.estimated_range_s);
        plan.add_time(audit_range_s);
        plan.add_time(PIXEL_S.map(|s| s * (pixels[0] * pixels[1]) as f64));
        let library = cost.mosaic.as_ref().filter(|m| m.pays).map_or(0, |m| m.missing_bytes);
        let memory = check_memory(memory_bytes, remedy);
        plan.warnings.extend(memory.err().map(|e| e.to_string()));
        Ok(WorldPlan {
            material: recipe.id.clone(),
            zone_axis: recipe.zone_axis.clone(),
            tiles: field.built_grid(),
            pixels,
            pixel_nm: pixel,
            fov_nm: pixels.map(|n| n as f64 * pixel),
            thickness_nm: build.specimen().facts().thickness_nm,
            dose_electrons_per_angstrom2: recipe.dose.electrons_per_angstrom2,
            subtiles,
            subtile_nm: shape.map(|n| n as f64 * pixel),
            probe_step_angstrom: cost.probe_step_angstrom,
            plan,
            mosaic_used: build.policy().imaging.method == MethodChoice::Mosaic
                || cost.mosaic.as_ref().is_some_and(|m| m.pays),
            mosaic: cost.mosaic,
            particle_probes: cost.particle_probes,
            audit_range_s,
            disk_bytes: build.disk_bytes() + library + PICTURE,
            output,
        })
    }

    /// What is to be said before a build, without the time that an estimate takes.
    ///
    /// # Errors
    /// Those of the build's plan.
    pub fn warnings(build: &WorldBuild) -> Result<Vec<String>> {
        let (subtile, _) = build.subtile_plan()?;
        Ok(report(&SimulationRuns { runs: 0, ..subtile }).warnings)
    }

    /// Bytes of memory on so many threads, and the longest time in s that is expected on the threads of this process; and how many
    /// those are.
    pub fn takes(&self, threads: usize) -> (u64, f64, usize) {
        let more = threads as f64 / self.plan.threads as f64;
        // What threads share is counted for each: at most a little too much.
        let memory = self.plan.memory_bytes as f64 * more.max(1.0);
        (memory as u64, self.plan.estimated_range_s[1], self.plan.threads)
    }

    /// The time in s that is expected on the threads of this process.
    pub fn expected_s(&self) -> f64 {
        self.plan.estimated_time_s
    }

    /// Whether it simulates a library before the field.
    pub fn has_library(&self) -> bool {
        self.mosaic_used && self.mosaic.as_ref().is_some_and(|m| m.missing > 0)
    }
}
