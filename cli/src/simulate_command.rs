//! `stemgen simulate`.

use super::accuracy_report::AccuracyReport;
use super::common::{Common, Force};
use super::imaging_args::{MicroscopeArgs, NumericsArgs};
use super::plan_text::{self, Lines};
use super::progress_bar::Reporter;
use super::request_file::RequestFile;
use super::scan_args::ScanArgs;
use super::simulate_parts::ScanParts;
use super::simulate_results::SideFiles;
use super::structure_args::{StructureArgs, file_name, stem, with_frames};
use super::values::{self, Bits};
use super::{hints, output, text};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::engine::ProbeRaster;
use stemgen::files::outputs::check_outputs;
use stemgen::files::{OutputSet, Shard};
use stemgen::io::StoredImages;
use stemgen::progress::Progress;
use stemgen::simulation::{self, PlanReport, SimulationJob, SimulationRequest, noisy_name};

const EXAMPLES: &str = "\
Examples:
  HAADF image of one unit cell of silicon, 54 A thick, with a picture and a page for the browser:
    stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --png --html
  Two detectors, eight phonon configurations, thicknesses of 20 and 39 A:
    stemgen simulate srtio3.cif --repeat 4,4,10 --detector HAADF=68-200 --detector ABF=10-21 \\
      --phonons 8 --sigma Sr=0.084,Ti=0.060,O=0.085 --thicknesses 20,39.05
  Silicon along [110] with an astigmatic probe; print time and memory only:
    stemgen simulate si.cif --zone 1,1,0 --repeat 4,3,20 --aberration C12=30@0.3 --dry-run
  Mean over every fifth frame of a trajectory, from frame 10 to frame 200:
    stemgen simulate md.xyz --frames 10:200:5 --detector HAADF=68-200
  Defocus series with a finite source, counted electrons, and TIFF for ImageJ:
    stemgen simulate si.cif --repeat 3,3,10 --scan-end 5.431,5.431 --defocus 0:100:20 \\
      --source-size 0.8 --dose 1e4 --tiff 16
  One scan in four parts, on machines that share a file system; then the images:
    stemgen simulate md.xyz --frames 10:200:5 --shard 0/4    # and 1/4, 2/4, 3/4
    stemgen simulate md.xyz --frames 10:200:5
  Write all settings to a file (a request); then simulate it with another defocus:
    stemgen simulate si.cif --repeat 3,3,10 --write-request si.toml
    stemgen simulate si.toml --defocus 50
  High-resolution TEM image near Scherzer defocus:
    stemgen simulate si.cif --repeat 2,2,5 --plane-wave --semiangle 12 --aberration C30=1.2e7 \\
      --defocus 650

Without --engine the program takes the fastest method whose error is at most --accuracy.

The file (HDF5) holds each image as /images/NAME: float32, [thickness, y, x], fractions of the
incident beam. /specimen holds the simulated atoms; attributes hold the settings and the request.
NeXus readers find the images with their axes in /entry. `stemgen rerun FILE.h5` repeats the
simulation and compares. `stemgen patterns` simulates diffraction patterns (4D-STEM), and
`stemgen integrate` computes any detector and the centre of mass from them.";

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
    /// Write all settings that decide the images to a file, and simulate nothing. `stemgen simulate FILE.toml` simulates them
    #[arg(long, value_name = "FILE.toml", conflicts_with = "shard", help_heading = "Running")]
    write_request: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

/// Holds the options of the results.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Results")]
pub struct Results {
    /// Thicknesses in A at which images are recorded, moved to slice boundaries [default: the whole specimen]
    #[arg(long, value_name = "A,A,...", value_delimiter = ',', value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    pub thicknesses: Vec<f64>,
    /// Simulate conventional imaging (TEM): the exit wave of a plane wave, and its image through the lens
    #[arg(long)]
    #[arg(conflicts_with_all = ["detector", "scan_start", "scan_end", "scan_step", "scan_points", "source_size"])]
    pub plane_wave: bool,
    /// File to write [default: name of the structure file with .h5, in the current folder]
    #[arg(short, long, value_name = "FILE.h5")]
    pub output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    pub overwrite: bool,
    /// Simulate part K (from 0) of N of the probes, and store it in FILE.work; `slurm` takes K and N from the Slurm job array.
    /// The command without --shard then finds the parts and writes the images
    #[arg(long, value_name = "K/N|slurm", value_parser = values::shard, conflicts_with = "plane_wave")]
    #[arg(help_heading = "Running")]
    pub shard: Option<Shard>,
    /// Also write a picture (PNG) of every image, beside the file. The pictures of a series have one grey scale
    #[arg(long)]
    pub png: bool,
    /// Draw the grey scale into pictures, with the values of black and white
    #[arg(long, requires = "png")]
    pub grey_bar: bool,
    /// Leave the scale bar out of pictures
    #[arg(long, requires = "png")]
    pub no_scale_bar: bool,
    /// Dose in electrons per square Angstrom. The file then also holds counted electrons (/counts/NAME) and the noisy image
    /// (NAME_noisy); --seed seeds the noise
    #[arg(long, value_name = "E/A^2", value_parser = values::positive)]
    pub dose: Option<f64>,
    /// Also write a TIFF file of 8, 16 or 32 bits for each detector. ImageJ reads its pixel size and its values; a series is a stack
    #[arg(long, value_name = "BITS")]
    pub tiff: Option<Bits>,
    /// Also write a file for HyperSpy (.hspy), beside the file
    #[arg(long)]
    pub hspy: bool,
    /// Also write the exit wave of every probe of the scan, beside the file: a NumPy array (complex64) with the axes defocus,
    /// configuration, scan row, scan column, thickness, y, x
    #[arg(long, conflicts_with_all = ["plane_wave", "shard"])]
    pub exit_waves: bool,
    /// Also write a page (HTML) with all images, beside the file. The page needs no network
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

/// A simulation, with the files that it writes.
pub struct SimulateRun {
    pub(super) job: SimulationJob,
    /// The accuracy found for each defocus, if an accuracy is asked for.
    pub(super) accuracies: Vec<AccuracyReport>,
    pub(super) results: Results,
    pub(super) output: PathBuf,
    pub(super) common: Common,
    /// A file with images of an equal request, for comparison.
    pub(super) again_of: Option<StoredImages>,
    pub(super) force: Force,
}

impl Simulate {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let request = self.request()?;
        if let Some(path) = &self.write_request {
            let inputs = [self.specimen.structure.clone()];
            let written =
                RequestFile { path, command: "simulate", overwrite: self.results.overwrite };
            return written.write(request, &inputs, &self.common);
        }
        let given = self.results.output.clone();
        // The structure file may lie in a folder that nobody may write to, so results go to the current folder.
        let output = given.unwrap_or_else(|| {
            let mut name = stem(&self.specimen.structure).into_os_string();
            name.push(".h5");
            PathBuf::from(name)
        });
        let inputs = [self.specimen.structure.clone()];
        let Simulate { results, common, force, .. } = self;
        let run = SimulateRun::new(request, results, output, (common, force))?;
        run.run(&inputs, &reporter).map(drop)
    }

    /// Returns the request that the options describe.
    fn request(&self) -> anyhow::Result<SimulationRequest> {
        let mut request = self.specimen.request()?;
        self.microscope.apply(&mut request.microscope);
        self.scan.apply(&mut request.scan);
        self.numerics.apply(&mut request.numerics)?;
        let Results { thicknesses, plane_wave, dose, .. } = &self.results;
        if !thicknesses.is_empty() {
            request.thicknesses_angstrom.clone_from(thicknesses);
        }
        request.plane_wave |= plane_wave;
        request.electrons_per_angstrom2 = dose.or(request.electrons_per_angstrom2);
        Ok(request)
    }
}

impl SimulateRun {
    /// Prepares a run that writes `output`.
    pub fn new(
        request: SimulationRequest,
        results: Results,
        output: PathBuf,
        (common, force): (Common, Force),
    ) -> anyhow::Result<Self> {
        if request.patterns.is_some() {
            bail!(
                "the request is for diffraction patterns: `stemgen patterns FILE.toml` simulates them"
            );
        }
        let job = SimulationJob::new(request).map_err(with_frames)?;
        let (accuracies, again_of) = (Vec::new(), None);
        Ok(SimulateRun { job, accuracies, results, output, common, again_of, force })
    }

    /// Has the run compare its images with the images of a file.
    #[must_use]
    pub fn again_of(self, stored: StoredImages) -> Self {
        SimulateRun { again_of: Some(stored), ..self }
    }

    /// Checks and simulates, or prints the plan. `inputs` are files that must not be replaced. Returns whether the images equal the
    /// images of the file that they are compared with; true without such a file.
    pub fn run(mut self, inputs: &[PathBuf], reporter: &Reporter) -> anyhow::Result<bool> {
        if self.results.exit_waves {
            self.job.check_exit_waves()?;
        }
        let files = self.side_files();
        if !self.common.dry_run {
            let outputs = std::iter::once(&self.output).chain(files.paths());
            let set = OutputSet::of(&self.output, &text::command_line(), self.results.overwrite);
            set.warning().iter().for_each(|warning| reporter.warn(warning));
            check_outputs(outputs, inputs, set.replaces())?;
        }
        simulation::check_hdf5_name(&self.output)?;
        self.choose_accuracy(reporter)?;
        let warnings = self.warnings();
        if self.common.dry_run {
            return self.dry_run(warnings).map(|()| true);
        }
        warnings.iter().for_each(|w| reporter.warn(w));
        for (bytes, remedy) in self.job.memory() {
            self.force.check_memory(bytes, remedy, reporter)?;
        }
        if let Some(shard) = self.results.shard {
            let parts = self.parts()?;
            let (text, report) = parts.make(shard, reporter)?;
            return self.common.print(&report, &text).map(|()| true);
        }
        self.execute(&files, reporter)
    }

    /// Returns the scan, divided into parts for several processes.
    pub(super) fn parts(&self) -> anyhow::Result<ScanParts<'_>> {
        let (plans, frames) = (self.job.plans(), self.job.specimen().frames());
        Ok(ScanParts { plans, frames, scan: self.job.simulated_scan()?, output: &self.output })
    }

    fn choose_accuracy(&mut self, reporter: &Reporter) -> anyhow::Result<()> {
        let begun = Instant::now();
        match self.common.dry_run {
            true => self.job.choose_quickly(reporter)?,
            false => self.job.choose_accuracy(reporter)?,
        }
        let each_s = begun.elapsed().as_secs_f64() / self.job.accuracies().len().max(1) as f64;
        let foci = &self.job.request().microscope.defocus_angstrom;
        let of = |n: usize| foci.get(n).copied().filter(|_| foci.len() > 1);
        let found = self.job.accuracies().iter().cloned().enumerate();
        let report = |(n, found)| AccuracyReport::new(found, each_s, of(n));
        self.accuracies = found.map(report).collect();
        Ok(())
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings: Vec<String> =
            self.job.warnings().iter().map(hints::with_option).collect();
        let accuracies = self.accuracies.iter().zip(self.job.plans());
        warnings.extend(accuracies.filter_map(|(a, plan)| a.warning(plan, self.job.scan())));
        warnings
    }

    fn dry_run(&self, warnings: Vec<String>) -> anyhow::Result<()> {
        let (job, specimen) = (&self.job, self.job.specimen());
        let mut plan = job.report()?;
        let memory = plan.warnings.split_off(job.warnings().len());
        plan.warnings = warnings.into_iter().chain(memory).collect();
        let plane_wave = job.request().plane_wave;
        let scan = job.simulated_scan()?;
        let scan_report = ScanReport {
            origin_angstrom: scan.origin_angstrom,
            step_angstrom: scan.step_angstrom,
            rows: scan.shape[0],
            columns: scan.shape[1],
        };
        let all = SimulateDryRun {
            structure: self.structure_name(),
            atoms: specimen.sites.len(),
            composition: specimen.composition(),
            box_angstrom: specimen.size_angstrom,
            scan: (!plane_wave).then_some(scan_report),
            defocus_angstrom: job.request().microscope.defocus_angstrom.clone(),
            plan,
            accuracy: AccuracyReport::value(&self.accuracies)?,
            output: self.output.clone(),
        };
        let mut lines = Lines::default();
        let parts = all.composition.iter().map(|(symbol, n)| format!("{symbol} {n}"));
        let parts = parts.collect::<Vec<_>>().join(", ");
        lines.add("structure", format!("{}: {} atoms ({parts})", all.structure, all.atoms));
        let [x, y, z] = all.box_angstrom;
        lines.add("box", format!("{x:.3} x {y:.3} x {z:.3} A"));
        plan_text::all(&all.plan, &mut lines);
        self.accuracies.iter().for_each(|a| a.line(&mut lines));
        let raster = ProbeRaster::new(&job.plans()[0], &scan)?;
        match plane_wave {
            true => lines.add("beam", "a plane wave along the beam axis"),
            false => lines.add("probes", plan_text::scan(raster.scan())),
        }
        if !plane_wave && raster.interpolates() {
            lines.add("interpolated to", plan_text::scan(&scan));
        }
        if job.plans().len() > 1 {
            let values = all.defocus_angstrom.iter().map(f64::to_string);
            lines.add("defocus", format!("{} A", values.collect::<Vec<_>>().join(", ")));
        }
        plan_text::costs(&all.plan, &mut lines);
        lines.add("output", format!("{} (nothing was simulated or written)", all.output.display()));
        self.common.print(&all, &lines.text())
    }

    /// Returns the name of the structure file.
    pub(super) fn structure_name(&self) -> String {
        self.job.request().structure.file().map(file_name).unwrap_or_default()
    }

    /// Returns the names of the noise-free images, then of the noisy ones.
    fn image_names(&self) -> Vec<String> {
        let names = self.job.image_names();
        let noisy = names.iter().filter(|_| self.job.electrons_per_pixel().is_some());
        let noisy: Vec<String> = noisy.map(|name| noisy_name(name)).collect();
        names.into_iter().chain(noisy).collect()
    }

    /// Returns the names of the series: the names of the images without their defocus.
    fn series_names(&self) -> Vec<String> {
        let job = &self.job;
        let names = job.detector_names();
        let noisy = names.iter().filter(|_| job.electrons_per_pixel().is_some());
        let noisy: Vec<String> = noisy.map(|name| noisy_name(name)).collect();
        names.into_iter().chain(noisy).collect()
    }

    /// Returns the files that are written beside the file with all images.
    fn side_files(&self) -> SideFiles {
        let thicknesses = self.job.plans()[0].thicknesses_angstrom();
        let series = thicknesses.len() > 1;
        let beside =
            |name: &str, ending: &str| output::sibling(&self.output, &format!("_{name}{ending}"));
        let names = self.image_names();
        let picture = |name: &String, (n, thickness): (usize, &f64)| {
            let at = if series { format!("_{thickness:.1}A") } else { String::new() };
            (name.clone(), n, beside(name, &format!("{at}.png")))
        };
        let each = |name| thicknesses.iter().enumerate().map(move |t| picture(name, t));
        let results = &self.results;
        SideFiles {
            pictures: names.iter().filter(|_| results.png).flat_map(each).collect(),
            tiffs: match results.tiff {
                Some(_) => {
                    let series = self.series_names().into_iter();
                    series.map(|name| (name.clone(), beside(&name, ".tif"))).collect()
                }
                None => Vec::new(),
            },
            hspy: results.hspy.then(|| self.output.with_extension("hspy")),
            exit_waves: results.exit_waves.then(|| beside("exit_waves", ".npy")),
            page: results.html.then(|| self.output.with_extension("html")),
        }
    }
}
