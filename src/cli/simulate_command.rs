//! `stemgen simulate`.

use super::common::Common;
use super::imaging_args::{self, MicroscopeArgs, NumericsArgs};
use super::plan_report::{self, Lines, PlanReport};
use super::plane_wave::{self, Conventional};
use super::progress_bar::Reporter;
use super::scan_args::ScanArgs;
use super::structure_args::{Prepared, StructureArgs};
use super::{estimate, output, pictures, slips, text, values};
use anyhow::bail;
use clap::Args;
use ndarray::{ArrayView3, Axis};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::engine::{Cost, Images, Plan, ProbeRaster, Scan, Settings, simulate};
use stemgen::files::outputs::check_outputs;
use stemgen::io::image_file::{ExitWaves, ImageStack, Origin, write_images};
use stemgen::progress::Progress;

/// Edge of a cell in Angstrom below which a probe meets its own periodic images.
const NARROW_CELL_ANGSTROM: f64 = 10.0;

const EXAMPLES: &str = "\
Examples:
  HAADF image of one unit cell of silicon, 54 A thick, with a picture and a page for the browser:
    stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --png --html
  Two detectors, eight phonon configurations, at 20 and 39 A:
    stemgen simulate srtio3.cif --repeat 4,4,10 --detector HAADF=68-200 --detector ABF=10-21 \\
      --phonons 8 --sigma Sr=0.084,Ti=0.060,O=0.085 --thicknesses 20,39.05
  Along [110], with an aberrated probe; what would it take?
    stemgen simulate si.cif --zone 1,1,0 --repeat 4,3,20 --aberration C12=30@0.3 --dry-run
  High-resolution TEM image at Scherzer-like defocus:
    stemgen simulate si.cif --repeat 2,2,5 --plane-wave --semiangle 12 --aberration C30=1.2e7 \\
      --defocus 650

The file (HDF5) holds /images/NAME as float32 (thickness, y, x) in fractions of the incident beam,
the atoms that were simulated below /specimen, and the settings as attributes.";

/// Simulate images of a structure
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Simulate {
    #[command(flatten)]
    specimen: StructureArgs,
    #[command(flatten)]
    microscope: MicroscopeArgs,
    #[command(flatten)]
    scan: ScanArgs,
    #[command(flatten)]
    numerics: NumericsArgs,
    #[command(flatten)]
    results: Results,
    #[command(flatten)]
    common: Common,
}

/// What is written.
#[derive(Debug, Args)]
#[command(next_help_heading = "Results")]
struct Results {
    /// Thicknesses in A at which images are recorded, moved to slice boundaries [default: the whole]
    #[arg(long, value_name = "A,A,...", value_delimiter = ',', value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    thicknesses: Vec<f64>,
    /// Conventional imaging: the exit wave of a plane wave and its image through the lens
    #[arg(long)]
    #[arg(conflicts_with_all = ["detector", "scan_start", "scan_end", "scan_step", "scan_points"])]
    plane_wave: bool,
    /// File to write [default: name of the structure with .h5, in the current folder]
    #[arg(short, long, value_name = "FILE.h5")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    /// Also write a picture of every image, beside the file
    #[arg(long)]
    png: bool,
    /// Also write a page (HTML) that shows all images, beside the file; it works offline
    #[arg(long)]
    html: bool,
}

#[derive(Serialize)]
struct SimulateDryRun {
    structure: String,
    atoms: usize,
    composition: std::collections::BTreeMap<&'static str, usize>,
    box_angstrom: [f64; 3],
    scan: Option<ScanReport>,
    #[serde(flatten)]
    plan: PlanReport,
    output: PathBuf,
}

#[derive(Serialize)]
struct ScanReport {
    origin_angstrom: [f64; 2],
    step_angstrom: [f64; 2],
    rows: usize,
    columns: usize,
}

#[derive(Serialize)]
struct SimulateSummary {
    output: PathBuf,
    file_bytes: u64,
    pictures: Vec<PathBuf>,
    page: Option<PathBuf>,
    images: Vec<ImageSummary>,
    wall_time_s: f64,
}

#[derive(Serialize)]
struct ImageSummary {
    name: String,
    thickness_angstrom: f64,
    rows: usize,
    columns: usize,
    step_angstrom: [f64; 2],
    min: f32,
    mean: f32,
    max: f32,
}

/// What a run has to write.
struct Picturable {
    name: String,
    thickness: f64,
    path: PathBuf,
}

impl Simulate {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let specimen = self.specimen.prepare()?;
        let thicknesses = self.results.thicknesses.clone();
        let phonons = self.specimen.options.phonons();
        let mut settings =
            imaging_args::settings(&self.microscope, &self.numerics, phonons, thicknesses)?;
        if self.results.plane_wave {
            settings = plane_wave::settings(settings)?;
        }
        let accuracy = self.numerics.accuracy;
        let warning = imaging_args::choose_window(accuracy, &mut settings, specimen.size[2])?;
        let plan = Plan::new(&settings, specimen.size, &specimen.heights)?;
        let scan = self.scan(&plan, &specimen)?;
        let mut warnings = plan.warnings.clone();
        warnings.extend(warning.into_iter().chain(specimen.warnings.clone()));
        warnings.extend(self.warnings(&plan, &specimen, &scan));
        if self.common.dry_run {
            slips::check_hdf5_name(&self.output())?;
            return self.dry_run(&plan, &specimen, &scan, warnings);
        }
        let names: Vec<&str> = match self.results.plane_wave {
            true => vec!["lens"],
            false => settings.detectors.iter().map(|d| d.name.as_str()).collect(),
        };
        let pictures = self.pictures(&names, &plan);
        let (output, page) = (self.output(), self.page());
        let pictured = pictures.iter().map(|p| p.path.as_path());
        let outputs = std::iter::once(output.as_path()).chain(pictured).chain(page.as_deref());
        check_outputs(outputs, [&self.specimen.structure], self.results.overwrite)?;
        slips::check_hdf5_name(&self.output())?;
        warnings.iter().for_each(|w| reporter.warn(w));
        self.execute(&plan, &specimen, &scan, &pictures, &reporter)
    }

    fn output(&self) -> PathBuf {
        let stem = self.specimen.stem();
        self.results.output.clone().unwrap_or_else(|| {
            let mut name = stem.into_os_string();
            name.push(".h5");
            PathBuf::from(name)
        })
    }

    /// Name of the page, if one is wanted.
    fn page(&self) -> Option<PathBuf> {
        self.results.html.then(|| self.output().with_extension("html"))
    }

    /// Probe positions; the pixels of the grid for a plane wave.
    fn scan(&self, plan: &Plan, specimen: &Prepared) -> anyhow::Result<Scan> {
        let [x, y, _] = specimen.size;
        if self.results.plane_wave {
            let [nx, ny] = plan.wave_grid.points;
            let step_angstrom = plan.wave_grid.sampling_angstrom();
            return Ok(Scan { origin_angstrom: [0.0; 2], step_angstrom, shape: [ny, nx] });
        }
        let scan = self.scan.scan([x, y], &plan.settings.optics)?;
        slips::check_scan(scan.origin_angstrom, extent(&scan), [x, y])?;
        Ok(scan)
    }

    /// Warnings about the specimen and memory.
    fn warnings(&self, plan: &Plan, specimen: &Prepared, scan: &Scan) -> Vec<String> {
        let mut warnings = Vec::new();
        let [x, y, _] = specimen.size;
        if !self.results.plane_wave {
            let left = slips::check_scan(scan.origin_angstrom, extent(scan), [x, y]);
            warnings.extend(left.ok().flatten());
        }
        if !self.results.plane_wave && x.min(y) < NARROW_CELL_ANGSTROM {
            let times = [x, y].map(|l| (1.5 * NARROW_CELL_ANGSTROM / l).ceil());
            let given = self.specimen.options.repeat.unwrap_or([1; 3]);
            let [nx, ny] = [0, 1].map(|i| times[i] * given[i] as f64);
            warnings.push(format!(
                "the cell of {x:.2} x {y:.2} A is narrow: a probe meets its own periodic images; \
                 --repeat {nx},{ny},{} --scan-end {x:.4},{y:.4} scans the same area of a wider cell",
                given[2]
            ));
        }
        let needed = Cost::new(plan, scan).memory_bytes(estimate::threads());
        let remedy = "a smaller cell, fewer --threads or less --oversampling take less";
        warnings.extend(estimate::memory_warning(needed, remedy));
        warnings
    }

    fn dry_run(
        &self,
        plan: &Plan,
        specimen: &Prepared,
        scan: &Scan,
        warnings: Vec<String>,
    ) -> anyhow::Result<()> {
        let raster = ProbeRaster::new(plan, scan)?;
        let waves = if self.results.plane_wave { 1 } else { raster.scan().len() };
        let cost = Cost::with_atoms(plan, scan, &specimen.sites).for_probes(waves);
        let report = PlanReport { warnings, ..PlanReport::new(plan, &cost, 1) };
        let scan_report = ScanReport {
            origin_angstrom: scan.origin_angstrom,
            step_angstrom: scan.step_angstrom,
            rows: scan.shape[0],
            columns: scan.shape[1],
        };
        let all = SimulateDryRun {
            structure: self.specimen.file_name(),
            atoms: specimen.sites.len(),
            composition: specimen.composition(),
            box_angstrom: specimen.size,
            scan: (!self.results.plane_wave).then_some(scan_report),
            plan: report,
            output: self.output(),
        };
        let mut lines = Lines::default();
        let parts = all.composition.iter().map(|(symbol, n)| format!("{symbol} {n}"));
        let parts = parts.collect::<Vec<_>>().join(", ");
        lines.add("structure", format!("{}: {} atoms ({parts})", all.structure, all.atoms));
        let [x, y, z] = all.box_angstrom;
        lines.add("box", format!("{x:.3} x {y:.3} x {z:.3} A"));
        all.plan.lines(&mut lines);
        match self.results.plane_wave {
            true => lines.add("beam", "a plane wave along the beam axis"),
            false => lines.add("probes", plan_report::scan(raster.scan())),
        }
        if !self.results.plane_wave && raster.interpolates() {
            lines.add("interpolated to", plan_report::scan(scan));
        }
        all.plan.costs(&mut lines);
        lines.add("output", format!("{} (nothing was simulated or written)", all.output.display()));
        self.common.print(&all, &lines.text())
    }

    fn pictures(&self, names: &[&str], plan: &Plan) -> Vec<Picturable> {
        let thicknesses = plan.thicknesses_angstrom();
        let series = thicknesses.len() > 1;
        let each = |name: &str, thickness: f64| {
            let at = if series { format!("_{thickness:.1}A") } else { String::new() };
            let path = output::sibling(&self.output(), &format!("_{name}{at}.png"));
            Picturable { name: name.to_owned(), thickness, path }
        };
        if !self.results.png {
            return Vec::new();
        }
        names.iter().flat_map(|n| thicknesses.iter().map(|t| each(n, *t))).collect()
    }

    fn execute(
        &self,
        plan: &Plan,
        specimen: &Prepared,
        scan: &Scan,
        pictures: &[Picturable],
        reporter: &Reporter,
    ) -> anyhow::Result<()> {
        let begun = Instant::now();
        let thicknesses = plan.thicknesses_angstrom();
        let stack = |name, data, units, annulus_mrad| ImageStack {
            name,
            data,
            units,
            step_angstrom: scan.step_angstrom,
            origin_angstrom: scan.origin_angstrom,
            thicknesses_angstrom: &thicknesses,
            annulus_mrad,
        };
        if self.results.plane_wave {
            let Conventional { exit_waves, image } = plane_wave::run(plan, specimen, reporter)?;
            let units = "intensity; that of the incident wave is 1";
            let stacks = [stack("lens", image.view(), units, None)];
            let step_angstrom = scan.step_angstrom;
            let waves = ExitWaves { data: exit_waves.view(), step_angstrom };
            return self.write(plan, specimen, &stacks, Some(waves), pictures, begun);
        }
        let images: Images = simulate(plan, &specimen.sites, scan, reporter)?;
        let units = "fraction of the incident beam";
        let stacks = plan.settings.detectors.iter().enumerate().map(|(i, d)| {
            let data: ArrayView3<f32> = images.data.index_axis(Axis(1), i);
            stack(&d.name, data, units, Some([d.inner_mrad, d.outer_mrad]))
        });
        let stacks: Vec<_> = stacks.collect();
        self.write(plan, specimen, &stacks, None, pictures, begun)
    }

    fn write(
        &self,
        plan: &Plan,
        specimen: &Prepared,
        stacks: &[ImageStack],
        waves: Option<ExitWaves>,
        pictures: &[Picturable],
        begun: Instant,
    ) -> anyhow::Result<()> {
        let path = self.output();
        let wall_time_s = begun.elapsed().as_secs_f64();
        let origin =
            origin(&self.specimen.file_name(), &plan.settings, plan, specimen, wall_time_s)?;
        write_images(&path, self.results.overwrite, &origin, stacks, waves)?;
        for picture in pictures {
            let Some(stack) = stacks.iter().find(|s| s.name == picture.name) else {
                bail!("no image `{}`", picture.name);
            };
            let at = stack.thicknesses_angstrom.iter().position(|t| *t == picture.thickness);
            let image = stack.data.index_axis(Axis(0), at.unwrap_or(0));
            pictures::write(&picture.path, image, stack.step_angstrom)?;
        }
        let page = self.page();
        if let Some(page) = &page {
            let facts = self.facts(plan, specimen);
            pictures::write_page(page, &self.specimen.file_name(), facts, stacks)?;
        }
        let summary = SimulateSummary {
            file_bytes: output::size(&path),
            output: path,
            pictures: pictures.iter().map(|p| p.path.clone()).collect(),
            page,
            images: stacks.iter().flat_map(summaries).collect(),
            wall_time_s,
        };
        self.common.print(&summary, &summary.text())
    }
}

impl Simulate {
    /// What the page says about the images.
    fn facts(&self, plan: &Plan, specimen: &Prepared) -> Vec<(String, String)> {
        let [x, y, z] = specimen.size;
        let optics = &plan.settings.optics;
        let detectors = plan.settings.detectors.iter();
        let detectors =
            detectors.map(|d| format!("{} {}-{} mrad", d.name, d.inner_mrad, d.outer_mrad));
        let phonons = plan.settings.phonons.map_or("none; atoms as given".to_owned(), |p| {
            format!("{} configurations", p.configurations)
        });
        let mut facts = vec![
            ("atoms", specimen.sites.len().to_string()),
            ("box", format!("{x:.3} \u{d7} {y:.3} \u{d7} {z:.3} \u{c5}")),
            ("beam", format!("{} keV, {} mrad", 1e-3 * optics.energy_ev, optics.semiangle_mrad)),
            ("phonons", phonons),
            ("stemgen", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        if !self.results.plane_wave {
            facts.insert(3, ("detectors", detectors.collect::<Vec<_>>().join(", ")));
        }
        facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }
}

/// Width and height of a scan in Angstrom.
fn extent(scan: &Scan) -> [f64; 2] {
    [0, 1].map(|k| scan.step_angstrom[k] * scan.shape[1 - k] as f64)
}

fn origin<'a>(
    file: &str,
    settings: &Settings,
    plan: &Plan,
    specimen: &'a Prepared,
    wall_time_s: f64,
) -> anyhow::Result<Origin<'a>> {
    Ok(Origin {
        command_line: text::command_line(),
        settings: serde_json::to_string(settings)?,
        structure_file: file.to_owned(),
        wavelength_angstrom: settings.optics.wavelength_angstrom(),
        band_limit_mrad: plan.band_limit_mrad,
        wall_time_s,
        box_angstrom: specimen.size,
        sites: &specimen.sites,
    })
}

fn summaries<'a>(stack: &'a ImageStack) -> impl Iterator<Item = ImageSummary> + 'a {
    let each = |(image, thickness): (ndarray::ArrayView2<f32>, &f64)| ImageSummary {
        name: stack.name.to_owned(),
        thickness_angstrom: *thickness,
        rows: image.nrows(),
        columns: image.ncols(),
        step_angstrom: stack.step_angstrom,
        min: image.iter().copied().fold(f32::INFINITY, f32::min),
        mean: (image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64) as f32,
        max: image.iter().copied().fold(f32::NEG_INFINITY, f32::max),
    };
    stack.data.outer_iter().zip(stack.thicknesses_angstrom).map(each)
}

impl SimulateSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        for i in &self.images {
            let [min, mean, max] =
                [i.min, i.mean, i.max].map(|v| text::significant(f64::from(v), 3));
            let [x, y] = i.step_angstrom;
            lines.add(
                "image",
                format!(
                    "{} at {:.2} A: {} x {} pixels of {x:.4} x {y:.4} A, {min} to {max}, mean {mean}",
                    i.name, i.thickness_angstrom, i.columns, i.rows
                ),
            );
        }
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        self.pictures.iter().for_each(|p| lines.add("picture", p.display().to_string()));
        self.page.iter().for_each(|p| lines.add("page", p.display().to_string()));
        lines.text()
    }
}
