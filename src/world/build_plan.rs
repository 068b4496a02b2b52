//! The plan of a build: its size, memory, time and disk space.

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

/// Processor time in s for each pixel of a field that laying out, noise and writing take. Measured: 0.7e-6 to 0.9e-6 (SrTiO3, whole
/// fields).
const PIXEL_S: [f64; 2] = [0.4e-6, 1.2e-6];

/// Memory, time and threads of a build.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BuildNeeds {
    /// Memory in bytes.
    pub memory_bytes: u64,
    /// Longest time in s that is expected on the threads of this process.
    pub longest_s: f64,
    /// Number of the threads of this process.
    pub threads: usize,
}

/// The plan of a build: its size, memory, time and disk space.
#[derive(Debug, Clone, Serialize)]
pub struct WorldPlan {
    /// Name of the recipe.
    pub material: String,
    /// Zone axis along the beam.
    pub zone_axis: String,
    /// Number of tiles: [rows, columns].
    pub tiles: [usize; 2],
    /// Number of pixels: [rows, columns].
    pub pixels: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Height and width of the field in nm.
    pub fov_nm: [f64; 2],
    /// Thickness of the specimen in nm.
    pub thickness_nm: f64,
    /// Electrons per square Angstrom.
    pub dose_electrons_per_angstrom2: f64,
    /// Number of sub-tiles.
    pub subtiles: usize,
    /// Height and width of a sub-tile in nm.
    pub subtile_nm: [f64; 2],
    /// Distance of probes (x, y) in Angstrom.
    pub probe_step_angstrom: [f64; 2],
    /// The simulation of a sub-tile or of the library; memory, time and warnings of the whole build.
    #[serde(flatten)]
    pub plan: PlanReport,
    /// Cost of the library of a mosaic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mosaic: Option<MosaicCost>,
    /// Whether the field is made from the mosaic.
    #[serde(skip)]
    pub mosaic_used: bool,
    /// Number of probes for particles on a film.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub particle_probes: Option<usize>,
    /// Least and greatest time in s of the audit; the estimated time includes it.
    pub audit_range_s: [f64; 2],
    /// Largest number of bytes on the disk.
    pub disk_bytes: u64,
    /// The file that would be written.
    pub output: PathBuf,
}

impl WorldPlan {
    /// Plans the build.
    ///
    /// # Errors
    /// Errors of the build's plan.
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

    /// Lists the warnings of a build without its estimate of time, which would measure the speed of the machine.
    ///
    /// # Errors
    /// Errors of the build's plan.
    pub fn warnings(build: &WorldBuild) -> Result<Vec<String>> {
        let (subtile, _) = build.subtile_plan()?;
        Ok(report(&SimulationRuns { runs: 0, ..subtile }).warnings)
    }

    /// Returns what the build needs, with the memory for `threads` threads.
    pub fn needs(&self, threads: usize) -> BuildNeeds {
        let more = threads as f64 / self.plan.threads as f64;
        // Memory that threads share is counted for each thread: the result is at most a little too large.
        let memory = self.plan.memory_bytes as f64 * more.max(1.0);
        BuildNeeds {
            memory_bytes: memory as u64,
            longest_s: self.plan.estimated_range_s[1],
            threads: self.plan.threads,
        }
    }

    /// Returns the time in s that is expected on the threads of this process.
    pub fn expected_s(&self) -> f64 {
        self.plan.estimated_time_s
    }

    /// Whether the build simulates a library before the field.
    pub fn has_library(&self) -> bool {
        self.mosaic_used && self.mosaic.as_ref().is_some_and(|m| m.missing > 0)
    }
}
