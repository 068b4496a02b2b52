//! What `stemgen build` would do and take.

use super::show::{Lines, PlanReport};
use super::{estimate, text};
use serde::Serialize;
use std::path::PathBuf;
use stemgen::engine::{Cost, Plan};
use stemgen::world::film::{BLOCK_PROBES, FilmImage};
use stemgen::world::footprint::world_bytes;
use stemgen::world::mosaic::{BLOCK_PX, Mosaic, MosaicEngine, Outlook};
use stemgen::world::subtiles::Partition;
use stemgen::world::{Recipe, Region, Simulator, Specimen, estimated_sites, specimen};

/// Edge of the surroundings of a column that only it shows, in Angstrom.
const UNIQUE_ANGSTROM: f64 = 3.0;
/// What is to be built, and how.
pub struct Request<'a> {
    /// The recipe.
    pub recipe: &'a Recipe,
    /// Simulates sub-tiles.
    pub simulator: &'a Simulator,
    /// Makes the image in place of it, if it is to be looked at.
    pub mosaic: Option<MosaicEngine>,
    /// Width and overlap of sub-tiles.
    pub subtile_nm: [f64; 2],
    /// Whether to estimate the time.
    pub timed: bool,
    /// Whether the noiseless image is kept.
    pub keep_clean: bool,
    /// The file.
    pub output: PathBuf,
}

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
    mosaic: Option<Outlook>,
    #[serde(skip_serializing_if = "Option::is_none")]
    particle_probes: Option<usize>,
    disk_bytes: u64,
    output: PathBuf,
}

impl DryRun {
    /// Plans the build.
    pub fn new(request: Request) -> anyhow::Result<Self> {
        let Request { recipe, simulator, .. } = request;
        let field = &recipe.field;
        let pixels = field.pixels(field.built_grid());
        let pixel = field.pixel_nm();
        let [size, overlap] = request.subtile_nm;
        let partition = Partition::new(pixels, pixel, size, overlap)?;
        let [rows, columns] = partition.subtiles().next().map_or([1, 1], |t| t.shape());
        let specimen = specimen(recipe)?;
        let plan = subtile_plan(&*specimen, recipe, simulator, [rows, columns])?;
        let sites = estimated_sites(&*specimen, field);
        let runs = if request.timed { partition.len() } else { 0 };
        let probes = simulator.probes(&plan, [rows, columns], 10.0 * pixel)?;
        let cost = Cost::new(&plan, probes.scan());
        let mut step_angstrom = probes.scan().step_angstrom;
        let (mut particle_probes, mut mosaic) = (None, None);
        let mut instead = None;
        if let Some(engine) = &request.mosaic {
            match FilmImage::prepare(engine, &*specimen, recipe)? {
                Some(film) => {
                    let probes = film.particle_probes();
                    let runs = probes.div_ceil(BLOCK_PROBES);
                    let block = film.block_plan()?;
                    let block = block.as_ref().map_or((&plan, cost), |b| (&b.plan, b.cost));
                    let cost = block.1.for_probes(probes.min(BLOCK_PROBES));
                    instead = Some(PlanReport::new(block.0, &cost, runs));
                    particle_probes = Some(probes);
                    step_angstrom = [film.step_angstrom(); 2];
                }
                None => mosaic = Some(Mosaic::outlook(engine, &*specimen, recipe)?),
            }
        }
        if let Some(mosaic) = mosaic.as_ref().filter(|m| m.pays) {
            instead = mosaic_report(mosaic, &*specimen, recipe, simulator)?;
        }
        // Each report with an estimate measures the speed.
        let subtile = || PlanReport::new(&plan, &cost, runs);
        let mut report = instead.unwrap_or_else(subtile);
        let remedy = "a smaller --subtile or fewer --threads take less";
        report.warnings.extend(estimate::memory_warning(report.memory_bytes, remedy));
        Ok(DryRun {
            material: recipe.id.clone(),
            zone_axis: recipe.zone_axis.clone(),
            tiles: field.built_grid(),
            pixels,
            pixel_nm: pixel,
            fov_nm: pixels.map(|n| n as f64 * pixel),
            thickness_nm: field.thickness_nm,
            dose_electrons_per_angstrom2: recipe.dose.electrons_per_angstrom2,
            subtiles: partition.len(),
            subtile_nm: [rows, columns].map(|n| n as f64 * pixel),
            probe_step_angstrom: step_angstrom,
            plan: report,
            mosaic,
            particle_probes,
            disk_bytes: world_bytes(field, sites, request.keep_clean),
            output: request.output,
        })
    }

    /// What is to be said of it.
    pub fn warnings(&self) -> &[String] {
        &self.plan.warnings
    }

    /// Name and value, line by line.
    pub fn text(&self) -> String {
        let mut lines = Lines::default();
        lines.add("material", format!("{} {}", self.material, self.zone_axis));
        let ([rows, columns], [ny, nx], [h, w]) = (self.tiles, self.pixels, self.fov_nm);
        let pixel = self.pixel_nm;
        lines.add("tiles", format!("{rows} x {columns}, {ny} x {nx} pixels of {pixel:.5} nm"));
        lines.add("field", format!("{h:.2} x {w:.2} nm, {} nm thick", self.thickness_nm));
        let [h, w] = self.subtile_nm;
        lines.add("sub-tiles", format!("{} of {h:.2} x {w:.2} nm", self.subtiles));
        let [x, y] = self.probe_step_angstrom;
        let number = match self.particle_probes {
            Some(n) => format!("{} for the particles", text::count(n as u64)),
            None => format!("{} per sub-tile", text::count(self.plan.probes as u64)),
        };
        lines.add("probes", format!("{number}, {x:.4} x {y:.4} A apart"));
        self.plan.lines(&mut lines);
        if let Some(mosaic) = &self.mosaic {
            lines.add("mosaic", mosaic_line(mosaic));
        } else if self.particle_probes.is_some() {
            lines.add("film", "each atom by itself");
        }
        self.plan.costs(&mut lines);
        lines.add("disk", format!("at most about {}", text::bytes(self.disk_bytes)));
        lines
            .add("output", format!("{} (nothing was simulated or written)", self.output.display()));
        lines.text()
    }
}

fn mosaic_line(mosaic: &Outlook) -> String {
    if !mosaic.pays {
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

/// What making a mosaic takes: the images that the library lacks, and the columns like no other, each in a block of its own.
fn mosaic_report(
    mosaic: &Outlook,
    specimen: &dyn Specimen,
    recipe: &Recipe,
    simulator: &Simulator,
) -> anyhow::Result<Option<PlanReport>> {
    let Some(largest) = &mosaic.plan else { return Ok(None) };
    let probes = mosaic.missing_probes.div_ceil(mosaic.missing.max(1));
    let cost = largest.cost.for_probes(probes);
    let mut report = PlanReport::new(&largest.plan, &cost, mosaic.missing);
    let pixel = 10.0 * recipe.field.pixel_nm();
    let unique = |edge: usize, runs: usize| -> anyhow::Result<PlanReport> {
        let plan = subtile_plan(specimen, recipe, simulator, [edge; 2])?;
        let probes = simulator.probes(&plan, [edge; 2], pixel)?;
        Ok(PlanReport::new(&plan, &Cost::new(&plan, probes.scan()), runs))
    };
    report.memory_bytes += mosaic.image_bytes;
    if mosaic.unique_columns > 0 {
        let edge = (UNIQUE_ANGSTROM / pixel).ceil() as usize;
        report.estimated_time_s += unique(edge, mosaic.unique_columns as usize)?.estimated_time_s;
        let memory = mosaic.image_bytes + unique(BLOCK_PX, 0)?.memory_bytes;
        report.memory_bytes = report.memory_bytes.max(memory);
    }
    Ok(Some(report))
}

/// The plan of a sub-tile of so many pixels.
fn subtile_plan(
    specimen: &dyn Specimen,
    recipe: &Recipe,
    simulator: &Simulator,
    [rows, columns]: [usize; 2],
) -> anyhow::Result<Plan> {
    let pixel = recipe.field.pixel_nm();
    let somewhere = Region::of_pixels(recipe.field.crop_origin_px(), [rows, columns], pixel);
    let z: Vec<f64> = specimen.sites(&somewhere).iter().map(|s| 10.0 * s.position_nm[2]).collect();
    let size = [columns, rows].map(|n| 10.0 * pixel * n as f64);
    Ok(simulator.plan(size, 10.0 * specimen.thickness_nm(), &z)?)
}
