//! What `stemgen build` would do and take.

use super::plan_report::{Lines, PlanReport};
use super::text;
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::engine::check_memory;
use stemgen::imaging::{MethodChoice, MosaicCost, SimulationRuns};
use stemgen::recipe::Recipe;
use stemgen::world::WorldBuild;
use stemgen::world::footprint::PICTURE;

/// Processor time in s that laying out, noise and writing take for each pixel of a field: SrTiO3, whole fields, 0.7e-6 to 0.9e-6.
const PIXEL_S: [f64; 2] = [0.4e-6, 1.2e-6];

/// What a build would do and take.
#[derive(Serialize)]
pub struct DryRun {
    material: String,
    zone_axis: String,
    tiles: [usize; 2],
    pixels: [usize; 2],
    pixel_nm: f64,
    fov_nm: [f64; 2],
    thickness_nm: f64,
    dose_electrons_per_angstrom2: f64,
    subtiles: usize,
    subtile_nm: [f64; 2],
    probe_step_angstrom: [f64; 2],
    #[serde(flatten)]
    plan: PlanReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    mosaic: Option<MosaicCost>,
    #[serde(skip)]
    mosaic_used: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    particle_probes: Option<usize>,
    /// Part of the estimated time.
    audit_range_s: [f64; 2],
    disk_bytes: u64,
    output: PathBuf,
}

impl DryRun {
    /// Plans the build.
    pub fn new(recipe: &Recipe, build: &WorldBuild, output: PathBuf) -> anyhow::Result<Self> {
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
        Ok(DryRun {
            material: recipe.id.clone(),
            zone_axis: recipe.zone_axis.clone(),
            tiles: field.built_grid(),
            pixels,
            pixel_nm: pixel,
            fov_nm: pixels.map(|n| n as f64 * pixel),
            thickness_nm: build.specimen().thickness_nm(),
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
    pub fn warnings(build: &WorldBuild) -> anyhow::Result<Vec<String>> {
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

    /// The file that would be written.
    pub fn output(&self) -> &Path {
        &self.output
    }

    /// Name and value, line by line.
    pub fn text(&self) -> String {
        let mut lines = Lines::default();
        lines.add("material", format!("{} {}", self.material, self.zone_axis));
        let ([rows, columns], [ny, nx], [h, w]) = (self.tiles, self.pixels, self.fov_nm);
        let pixel = self.pixel_nm;
        lines.add("tiles", format!("{rows} x {columns}, {ny} x {nx} pixels of {pixel:.5} nm"));
        lines.add("field", format!("{h:.2} x {w:.2} nm, {:.3} nm thick", self.thickness_nm));
        let [h, w] = self.subtile_nm;
        lines.add("sub-tiles", format!("{} of {h:.2} x {w:.2} nm", self.subtiles));
        let [x, y] = self.probe_step_angstrom;
        let number = match self.particle_probes {
            Some(n) => format!("{} for the particles", text::count(n as u64)),
            None => format!("{} per sub-tile", text::count(self.plan.probes as u64)),
        };
        lines.add("probes", format!("{number}, {x:.4} x {y:.4} A apart"));
        self.plan.numerics(&mut lines);
        if let Some(mosaic) = &self.mosaic {
            lines.add("mosaic", mosaic_line(mosaic, self.mosaic_used));
            for new in mosaic.new.iter().filter(|_| self.mosaic_used) {
                let images = text::count(new.images as u64);
                lines.add("new", format!("{images} images: {}", new.why));
            }
        } else if self.particle_probes.is_some() {
            lines.add("film", "each atom by itself");
        }
        self.plan.costs(&mut lines);
        if self.audit_range_s[1] > 0.0 {
            let time = text::duration_range(self.audit_range_s);
            lines.add("audit", format!("{time} of that"));
        }
        lines.add("disk", format!("at most about {}", text::bytes(self.disk_bytes)));
        lines
            .add("output", format!("{} (nothing was simulated or written)", self.output.display()));
        lines.text()
    }
}

fn mosaic_line(mosaic: &MosaicCost, used: bool) -> String {
    if !used {
        return "does not pay for so small a field: every sub-tile is simulated".into();
    }
    let count = |n: usize| text::count(n as u64);
    let unique = match mosaic.unique_columns {
        0 => String::new(),
        n => format!("; {} columns are like no other", text::count(n)),
    };
    format!(
        "library of {} images, {} of them to simulate ({} probes){unique}",
        count(mosaic.images),
        count(mosaic.missing),
        count(mosaic.missing_probes)
    )
}

/// Like simulations as a report; each with an estimate measures the speed.
fn report(simulations: &SimulationRuns) -> PlanReport {
    PlanReport::new(&simulations.plan, &simulations.cost, simulations.runs)
}
