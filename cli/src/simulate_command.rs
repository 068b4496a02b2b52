//! `stemgen simulate`.

use super::accuracy_report::AccuracyReport;
use super::common::{Common, Force};
use super::imaging_args::{self, MicroscopeArgs, NumericsArgs};
use super::plan_report::{self, Lines, PlanReport};
use super::plane_wave;
use super::progress_bar::Reporter;
use super::scan_args::ScanArgs;
use super::simulate_parts::ScanParts;
use super::simulate_results::SideFiles;
use super::structure_args::{Prepared, StructureArgs};
use super::values::{self, Bits};
use super::{estimate, output, slips, text};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::engine::{Cost, Plan, ProbeRaster, Scan, check_memory};
use stemgen::files::outputs::check_outputs;
use stemgen::files::{OutputSet, Shard};
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
  Frozen phonons from a trajectory, every fifth frame from the tenth on:
    stemgen simulate md.xyz --frames 10:200:5 --detector HAADF=68-200
  A defocus series with a finite source, counted electrons, and TIFF for ImageJ:
    stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --defocus 0:100:20 \\
      --source-size 0.8 --dose 1e4 --tiff 16
  In parts, on machines that see the same files; then the images from them:
    stemgen simulate md.xyz --frames 10:200:5 --shard 0/4    # ... and 1/4, 2/4, 3/4
    stemgen simulate md.xyz --frames 10:200:5
  High-resolution TEM image at Scherzer-like defocus:
    stemgen simulate si.cif --repeat 2,2,5 --plane-wave --semiangle 12 --aberration C30=1.2e7 \\
      --defocus 650

The file (HDF5) holds /images/NAME as float32 (thickness, y, x) in fractions of the incident beam,
the atoms that were simulated below /specimen, and the settings as attributes. NeXus readers open
the images with their axes (/entry). Diffraction patterns (4D-STEM) and segmented detectors are not
offered: several annuli in one run come nearest.";

/// Simulate images of a structure
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Simulate {
    #[command(flatten)]
    pub(super) specimen: StructureArgs,
    #[command(flatten)]
    pub(super) microscope: MicroscopeArgs,
    #[command(flatten)]
    scan: ScanArgs,
    #[command(flatten)]
    numerics: NumericsArgs,
    #[command(flatten)]
    pub(super) results: Results,
    #[command(flatten)]
    pub(super) common: Common,
    #[command(flatten)]
    force: Force,
}

/// What is written.
#[derive(Debug, Args)]
#[command(next_help_heading = "Results")]
pub struct Results {
    /// Thicknesses in A at which images are recorded, moved to slice boundaries [default: the whole]
    #[arg(long, value_name = "A,A,...", value_delimiter = ',', value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    pub thicknesses: Vec<f64>,
    /// Conventional imaging: the exit wave of a plane wave and its image through the lens
    #[arg(long)]
    #[arg(conflicts_with_all = ["detector", "scan_start", "scan_end", "scan_step", "scan_points", "source_size"])]
    pub plane_wave: bool,
    /// File to write [default: name of the structure with .h5, in the current folder]
    #[arg(short, long, value_name = "FILE.h5")]
    pub output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    /// Simulate part K (from 0) of N of the probes, for several processes, and keep it in FILE.work; `slurm`: that of a task
    /// of a job array. The same command without it then writes the images
    #[arg(long, value_name = "K/N|slurm", value_parser = values::shard, conflicts_with = "plane_wave")]
    #[arg(help_heading = "Running")]
    pub shard: Option<Shard>,
    /// Also write a picture of every image, beside the file
    #[arg(long)]
    pub png: bool,
    /// Leave the scale bar out of pictures
    #[arg(long, requires = "png")]
    pub no_scale_bar: bool,
    /// Electrons per square Angstrom: also write the electrons counted (/counts/NAME) and the noisy image
    /// (NAME_noisy); --seed seeds the noise
    #[arg(long, value_name = "E/A^2", value_parser = values::positive)]
    pub dose: Option<f64>,
    /// Also write every image as TIFF of 8, 16 or 32 bits, with pixels and values calibrated for ImageJ
    #[arg(long, value_name = "BITS")]
    pub tiff: Option<Bits>,
    /// Also write a file for HyperSpy (.hspy), beside the file
    #[arg(long)]
    pub hspy: bool,
    /// Also write a page (HTML) that shows all images, beside the file; it works offline
    #[arg(long)]
    pub html: bool,
}

#[derive(Serialize)]
struct SimulateDryRun {
    structure: String,
    atoms: usize,
    composition: std::collections::BTreeMap<&'static str, usize>,
    box_angstrom: [f64; 3],
    scan: Option<ScanReport>,
    defocus_angstrom: Vec<f64>,
    #[serde(flatten)]
    plan: PlanReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    accuracy: Option<serde_json::Value>,
    output: PathBuf,
}

#[derive(Serialize)]
struct ScanReport {
    origin_angstrom: [f64; 2],
    step_angstrom: [f64; 2],
    rows: usize,
    columns: usize,
}

/// The plans of a run: one for each defocus of a series.
pub struct PlannedSeries {
    /// At least one; they differ in defocus, and in what the accuracy asked for takes at each.
    pub plans: Vec<Plan>,
    /// The values of defocus in Angstrom.
    defocus_angstrom: Vec<f64>,
    /// What is known of the accuracy of each, where one is asked for.
    pub accuracies: Vec<AccuracyReport>,
}

impl Simulate {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let specimen = self.specimen.prepare()?;
        if self.results.plane_wave && !specimen.more_frames.is_empty() {
            bail!("--plane-wave images one structure; leave --frames out");
        }
        let (mut planned, scan) = self.plan(&specimen)?;
        self.check_noise(&planned, &scan)?;
        let files = self.side_files(&planned);
        let output = self.output();
        if !self.common.dry_run {
            let outputs = std::iter::once(&output).chain(files.paths());
            let set = OutputSet::of(&output, &text::command_line(), self.results.overwrite);
            set.told().iter().for_each(|told| reporter.warn(told));
            check_outputs(outputs, [&self.specimen.structure], set.replaces())?;
        }
        slips::check_hdf5_name(&output)?;
        self.make_accurate(&mut planned, &specimen, &scan, &reporter)?;
        let plan = &planned.plans[0];
        let mut warnings = plan.warnings.clone();
        let accuracies = planned.accuracies.iter().zip(&planned.plans);
        warnings.extend(accuracies.filter_map(|(a, plan)| a.warning(plan, &scan)));
        warnings.extend(specimen.warnings.clone());
        warnings.extend(self.warnings(plan, &specimen, &scan));
        if self.common.dry_run {
            return self.dry_run(&planned, &specimen, &scan, warnings);
        }
        warnings.iter().for_each(|w| reporter.warn(w));
        for plan in &planned.plans {
            let (needed, remedy) = self.memory(plan, &scan);
            self.force.check_memory(needed, remedy, &reporter)?;
        }
        if let Some(shard) = self.results.shard {
            let blur = self.source_blur(&scan, [specimen.size[0], specimen.size[1]])?;
            let wide = blur.as_ref().map_or(&scan, |b| b.scan());
            let parts = Self::parts(&planned, &specimen, wide, &output);
            let (told, report) = parts.make(shard, &reporter)?;
            return self.common.print(&report, &told);
        }
        self.execute(&planned, &specimen, &scan, &files, &reporter)
    }

    /// What several processes may share.
    pub(super) fn parts<'a>(
        planned: &'a PlannedSeries,
        specimen: &'a Prepared,
        scan: &Scan,
        output: &'a Path,
    ) -> ScanParts<'a> {
        let more = specimen.more_frames.iter().map(Vec::as_slice);
        let frames = std::iter::once(specimen.sites.as_slice()).chain(more).collect();
        ScanParts { plans: &planned.plans, frames, scan: *scan, output }
    }

    /// The plans before any accuracy is asked for, and the scan.
    fn plan(&self, specimen: &Prepared) -> anyhow::Result<(PlannedSeries, Scan)> {
        let defocus_angstrom = self.microscope.defocus.0.clone();
        let mut plans = Vec::new();
        for defocus in &defocus_angstrom {
            let thicknesses = self.results.thicknesses.clone();
            let phonons = self.specimen.options.phonons();
            let (microscope, numerics) = (&self.microscope, &self.numerics);
            let mut settings =
                imaging_args::settings_at(*defocus, microscope, numerics, phonons, thicknesses)?;
            if self.results.plane_wave {
                settings = plane_wave::settings(settings)?;
            }
            plans.push(Plan::new(&settings, specimen.size, &specimen.heights)?);
        }
        let scan = self.scan(&plans[0], specimen)?;
        Ok((PlannedSeries { plans, defocus_angstrom, accuracies: Vec::new() }, scan))
    }

    /// Makes the plans as accurate as asked.
    fn make_accurate(
        &self,
        planned: &mut PlannedSeries,
        specimen: &Prepared,
        scan: &Scan,
        reporter: &Reporter,
    ) -> anyhow::Result<()> {
        let asked = self.numerics.accuracy;
        for plan in &mut planned.plans {
            let mut settings = plan.settings.clone();
            let found = AccuracyReport::choose(asked, &mut settings, specimen, scan, reporter)?;
            if let Some(found) = found {
                *plan = Plan::new(&settings, specimen.size, &specimen.heights)?;
                planned.accuracies.push(found);
            }
        }
        Ok(())
    }

    pub(super) fn output(&self) -> PathBuf {
        let stem = self.specimen.stem();
        self.results.output.clone().unwrap_or_else(|| {
            let mut name = stem.into_os_string();
            name.push(".h5");
            PathBuf::from(name)
        })
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

    /// Warnings about the specimen.
    fn warnings(&self, plan: &Plan, specimen: &Prepared, scan: &Scan) -> Vec<String> {
        let aberrations = &self.microscope.aberration;
        let mut warnings: Vec<String> =
            aberrations.iter().filter_map(slips::azimuth_in_degrees).collect();
        let [x, y, _] = specimen.size;
        if !self.results.plane_wave {
            warnings.extend(plan.narrow_cell());
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
        warnings
    }

    /// Bytes that the run takes, and what takes less.
    fn memory(&self, plan: &Plan, scan: &Scan) -> (u64, &'static str) {
        let threads = estimate::threads();
        let probes = if self.results.plane_wave { 1 } else { scan.len() };
        let cost = Cost::new(plan, scan).for_probes(probes);
        (cost.memory_bytes(threads), cost.memory_remedy(threads))
    }

    fn dry_run(
        &self,
        planned: &PlannedSeries,
        specimen: &Prepared,
        scan: &Scan,
        warnings: Vec<String>,
    ) -> anyhow::Result<()> {
        let plan = &planned.plans[0];
        let [x, y, _] = specimen.size;
        let blur = self.source_blur(scan, [x, y])?;
        let scan = blur.as_ref().map_or(scan, |b| b.scan());
        let raster = ProbeRaster::new(plan, scan)?;
        let waves = if self.results.plane_wave { 1 } else { raster.scan().len() };
        let cost = Cost::with_atoms(plan, scan, &specimen.sites).for_probes(waves);
        let mut warnings = warnings;
        let (needed, remedy) = self.memory(plan, scan);
        warnings.extend(check_memory(needed, remedy).err().map(|e| e.to_string()));
        let frames = 1 + specimen.more_frames.len();
        let runs = if self.results.plane_wave { 1 } else { planned.plans.len() * frames };
        let report = PlanReport { warnings, ..PlanReport::new(plan, &cost, runs) };
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
            defocus_angstrom: planned.defocus_angstrom.clone(),
            plan: report,
            accuracy: AccuracyReport::value(&planned.accuracies)?,
            output: self.output(),
        };
        let mut lines = Lines::default();
        let parts = all.composition.iter().map(|(symbol, n)| format!("{symbol} {n}"));
        let parts = parts.collect::<Vec<_>>().join(", ");
        lines.add("structure", format!("{}: {} atoms ({parts})", all.structure, all.atoms));
        let [x, y, z] = all.box_angstrom;
        lines.add("box", format!("{x:.3} x {y:.3} x {z:.3} A"));
        all.plan.lines(&mut lines);
        planned.accuracies.iter().for_each(|a| a.line(&mut lines));
        match self.results.plane_wave {
            true => lines.add("beam", "a plane wave along the beam axis"),
            false => lines.add("probes", plan_report::scan(raster.scan())),
        }
        if !self.results.plane_wave && raster.interpolates() {
            lines.add("interpolated to", plan_report::scan(scan));
        }
        if planned.plans.len() > 1 {
            let values = all.defocus_angstrom.iter().map(f64::to_string);
            lines.add("defocus", format!("{} A", values.collect::<Vec<_>>().join(", ")));
        }
        all.plan.costs(&mut lines);
        lines.add("output", format!("{} (nothing was simulated or written)", all.output.display()));
        self.common.print(&all, &lines.text())
    }

    /// The files beside the one with all images.
    fn side_files(&self, planned: &PlannedSeries) -> SideFiles {
        let thicknesses = planned.plans[0].thicknesses_angstrom();
        let series = thicknesses.len() > 1;
        let beside =
            |name: &str, ending: &str| output::sibling(&self.output(), &format!("_{name}{ending}"));
        let names = self.image_names(planned);
        let picture = |name: &String, (n, thickness): (usize, &f64)| {
            let at = if series { format!("_{thickness:.1}A") } else { String::new() };
            (name.clone(), n, beside(name, &format!("{at}.png")))
        };
        let each = |name| thicknesses.iter().enumerate().map(move |t| picture(name, t));
        let results = &self.results;
        SideFiles {
            pictures: names.iter().filter(|_| results.png).flat_map(each).collect(),
            tiffs: match results.tiff {
                Some(_) => names.iter().map(|n| (n.clone(), beside(n, ".tif"))).collect(),
                None => Vec::new(),
            },
            hspy: results.hspy.then(|| self.output().with_extension("hspy")),
            page: results.html.then(|| self.output().with_extension("html")),
        }
    }

    /// The defocus of a plan, where there is a series.
    pub(super) fn series_defocus(&self, planned: &PlannedSeries, plan: &Plan) -> Option<f64> {
        let number = planned.plans.iter().position(|p| std::ptr::eq(p, plan))?;
        planned.defocus_angstrom.get(number).copied().filter(|_| planned.plans.len() > 1)
    }
}

/// Width and height of a scan in Angstrom.
fn extent(scan: &Scan) -> [f64; 2] {
    [0, 1].map(|k| scan.step_angstrom[k] * scan.shape[1 - k] as f64)
}
