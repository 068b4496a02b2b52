//! `stemgen patterns`.

use super::common::{Common, Force};
use super::imaging_args::{MicroscopeArgs, NumericsArgs};
use super::plan_text::{self, Lines};
use super::progress_bar::Reporter;
use super::scan_args::ScanArgs;
use super::structure_args::{StructureArgs, file_name, stem, with_frames};
use super::{hints, output, text, values};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stemgen::files::outputs::check_outputs;
use stemgen::io::pattern_file::data_bytes;
use stemgen::io::pattern_run::{PatternRun, WrittenPatterns};
use stemgen::progress::Progress;
use stemgen::render::image_pictures;
use stemgen::simulation::{PlanReport, SimulationJob, SimulationRequest};

const EXAMPLES: &str = "\
Examples:
  Patterns of 64 x 64 pixels to 100 mrad of a unit cell of SrTiO3, 39 A thick, 20 x 20 probes:
    stemgen patterns srtio3.cif --repeat 8,8,10 --scan-start 15.62,15.62 --scan-end 19.525,19.525 \\
      --scan-points 20,20
  Counted electrons on a finer detector, eight phonon configurations, at two thicknesses (two files):
    stemgen patterns srtio3.cif --repeat 8,8,20 --pixels 128 --max-angle 60 --dose 1e5 \\
      --phonons 8 --sigma 0.08 --thicknesses 39,78
  What would it take?
    stemgen patterns mos2.xyz --energy 80 --semiangle 25 --dry-run
  Images from the patterns, afterwards:
    stemgen integrate srtio3.emd --annulus ABF=10-21 --sectors 0-21:4 --com --icom --png

The file (.emd, HDF5) opens in py4DSTEM, LiberTEM and HyperSpy: fractions of the beam, or electrons, (y, x, ky, kx); k = 0 is
at pixel n / 2, x runs right and y down. Probes are propagated in windows that hold the beam, unless --engine or --window say
otherwise; what a window cuts off the probe is added coherently.";

/// Simulate the diffraction pattern of every probe (4D-STEM)
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Patterns {
    #[command(flatten)]
    specimen: StructureArgs,
    #[command(flatten)]
    microscope: MicroscopeArgs,
    #[command(flatten)]
    detector: PatternArgs,
    #[command(flatten)]
    scan: ScanArgs,
    #[command(flatten)]
    numerics: NumericsArgs,
    #[command(flatten)]
    results: PatternResults,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

/// The pixelated detector.
#[derive(Debug, Args)]
#[command(next_help_heading = "Pixelated detector")]
pub struct PatternArgs {
    /// Pixels along each edge of the detector [default: 64]
    #[arg(long, value_name = "N")]
    pixels: Option<usize>,
    /// Half the width of the detector in mrad [default: 100]
    #[arg(long, value_name = "MRAD", value_parser = values::positive)]
    max_angle: Option<f64>,
    /// Leave out what windows cut off the probe
    #[arg(long)]
    no_coherent_tail: bool,
}

/// What is written.
#[derive(Debug, Args)]
#[command(next_help_heading = "Results")]
pub struct PatternResults {
    /// Thicknesses in A at which patterns are recorded, each to a file of its own [default: the whole]
    #[arg(long, value_name = "A,A,...", value_delimiter = ',', value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    thicknesses: Vec<f64>,
    /// File to write [default: name of the structure with .emd, in the current folder]
    #[arg(short, long, value_name = "FILE.emd")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    /// Electrons per square Angstrom of the scan, which are then counted; --seed seeds the noise
    #[arg(long, value_name = "E/A^2", value_parser = values::positive)]
    dose: Option<f64>,
    /// Also write a picture of the mean pattern, beside the file; it shows the fourth root of intensities
    #[arg(long)]
    png: bool,
}

#[derive(Serialize)]
struct PatternsDryRun {
    structure: String,
    atoms: usize,
    scan: [usize; 2],
    pixels: usize,
    max_angle_mrad: f64,
    file_bytes: u64,
    outputs: Vec<PathBuf>,
    #[serde(flatten)]
    plan: PlanReport,
}

#[derive(Serialize)]
struct PatternsSummary {
    files: Vec<WrittenFile>,
    wall_time_s: f64,
}

#[derive(Serialize)]
struct WrittenFile {
    output: PathBuf,
    file_bytes: u64,
    picture: Option<PathBuf>,
    thickness_angstrom: f64,
    defocus_angstrom: f64,
    rows: usize,
    columns: usize,
    pixels: usize,
    /// The mean share of the beam on the detector, or the mean number of electrons.
    mean_sum: f64,
    #[serde(skip)]
    counted: bool,
}

impl Patterns {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let job = SimulationJob::new(self.request()?).map_err(with_frames)?;
        let given = self.results.output.clone();
        let output = given.unwrap_or_else(|| {
            let mut name = stem(&self.specimen.structure).into_os_string();
            name.push(".emd");
            PathBuf::from(name)
        });
        if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("emd")) {
            bail!(
                "--output {}: patterns are written as .emd, which py4DSTEM, LiberTEM and HyperSpy know by its ending; did you \
                 mean {}?",
                output.display(),
                output.with_extension("emd").display()
            );
        }
        let run = PatternsRun { job, output, png: self.results.png };
        if self.common.dry_run {
            return run.dry_run(&self.common);
        }
        let files: Vec<PathBuf> = run.run("").files().into_iter().map(|(path, _)| path).collect();
        let pictures = files.iter().filter(|_| run.png).map(|path| picture_of(path));
        let outputs: Vec<PathBuf> = files.iter().cloned().chain(pictures).collect();
        check_outputs(&outputs, [&self.specimen.structure], self.results.overwrite)?;
        run.warnings().iter().for_each(|warning| reporter.warn(warning));
        for (bytes, remedy) in run.job.memory() {
            self.force.check_memory(bytes, remedy, &reporter)?;
        }
        run.run("").check_space()?;
        let begun = Instant::now();
        let files = run.write(self.results.overwrite, &reporter)?;
        let summary = PatternsSummary { files, wall_time_s: begun.elapsed().as_secs_f64() };
        self.common.print(&summary, &summary.text())
    }

    /// What is asked for.
    fn request(&self) -> anyhow::Result<SimulationRequest> {
        if !self.microscope.detector.is_empty() {
            bail!(
                "--detector: rings are chosen afterwards, from the patterns: `stemgen integrate FILE.emd --annulus NAME=INNER-OUTER`"
            );
        }
        let mut request = self.specimen.request()?;
        self.microscope.apply(&mut request.microscope);
        self.scan.apply(&mut request.scan);
        self.numerics.apply(&mut request.numerics)?;
        if !self.results.thicknesses.is_empty() {
            request.thicknesses_angstrom.clone_from(&self.results.thicknesses);
        }
        request.electrons_per_angstrom2 = self.results.dose.or(request.electrons_per_angstrom2);
        let patterns = request.patterns.get_or_insert_default();
        patterns.pixels = self.detector.pixels.unwrap_or(patterns.pixels);
        patterns.max_angle_mrad = self.detector.max_angle.unwrap_or(patterns.max_angle_mrad);
        patterns.coherent_tail &= !self.detector.no_coherent_tail;
        Ok(request)
    }
}

/// A simulation of patterns, with where they go.
struct PatternsRun {
    job: SimulationJob,
    output: PathBuf,
    png: bool,
}

impl PatternsRun {
    /// What is simulated, and where it goes.
    fn run<'a>(&'a self, command_line: &'a str) -> PatternRun<'a> {
        PatternRun { job: &self.job, output: &self.output, command_line }
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings: Vec<String> =
            self.job.warnings().iter().map(hints::with_option).collect();
        let [x, y] = self.job.scan().step_angstrom;
        if (x / y - 1.0).abs() > 1e-3 {
            warnings.push(format!(
                "probes are {x:.4} A apart along x and {y:.4} A along y; py4DSTEM takes them for equal: give --scan-points that make \
                 them so"
            ));
        }
        warnings
    }

    fn dry_run(&self, common: &Common) -> anyhow::Result<()> {
        let mut plan = self.job.report()?;
        plan.warnings = self.warnings();
        let files = self.run("").files();
        let Some((_, header)) = files.first() else { bail!("there is nothing to simulate") };
        let all = PatternsDryRun {
            structure: self.job.request().structure.file().map(file_name).unwrap_or_default(),
            atoms: self.job.specimen().sites.len(),
            scan: header.scan.shape,
            pixels: header.detector.pixels,
            max_angle_mrad: header.detector.max_angle_mrad,
            file_bytes: data_bytes(header),
            outputs: files.iter().map(|(path, _)| path.clone()).collect(),
            plan,
        };
        let mut lines = Lines::default();
        lines.add("structure", format!("{}: {} atoms", all.structure, all.atoms));
        plan_text::all(&all.plan, &mut lines);
        lines.add("probes", plan_text::scan(self.job.scan()));
        lines.add(
            "patterns",
            format!(
                "{0} x {0} pixels to {1} mrad, {2:.3} mrad each",
                all.pixels,
                all.max_angle_mrad,
                header.detector.pixel_mrad()
            ),
        );
        plan_text::costs(&all.plan, &mut lines);
        for path in &all.outputs {
            let size = text::bytes(all.file_bytes);
            let words = "nothing was simulated or written";
            lines.add("output", format!("{} ({size}; {words})", path.display()));
        }
        common.print(&all, &lines.text())
    }

    /// Simulates and writes.
    fn write(&self, overwrite: bool, reporter: &Reporter) -> anyhow::Result<Vec<WrittenFile>> {
        let written = self.run(&text::command_line()).write(overwrite, reporter)?;
        written.into_iter().map(|file| self.written(file)).collect()
    }

    fn written(&self, file: WrittenPatterns) -> anyhow::Result<WrittenFile> {
        let WrittenPatterns { path, header, mean } = file;
        let picture = self.png.then(|| picture_of(&path));
        if let Some(picture) = &picture {
            let shown = mean.mapv(|v| v.max(0.0).powf(0.25) as f32);
            let pixel = header.detector.pixel_k(header.wavelength_angstrom);
            image_pictures::write(picture, shown.view(), [pixel; 2], false)?;
        }
        let [rows, columns] = header.scan.shape;
        Ok(WrittenFile {
            file_bytes: output::size(&path),
            output: path,
            picture,
            thickness_angstrom: header.thickness_angstrom,
            defocus_angstrom: header.defocus_angstrom,
            rows,
            columns,
            pixels: header.detector.pixels,
            mean_sum: mean.sum(),
            counted: header.counted.is_some(),
        })
    }
}

fn picture_of(path: &Path) -> PathBuf {
    output::sibling(path, "_mean.png")
}

impl PatternsSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        for file in &self.files {
            let sum = match file.counted {
                true => format!("{:.1} electrons in the mean", file.mean_sum),
                false => format!("{:.2} % of the beam in the mean", 100.0 * file.mean_sum),
            };
            lines.add(
                "patterns",
                format!(
                    "{} x {} probes, {} x {} pixels, at {:.2} A: {sum}",
                    file.columns, file.rows, file.pixels, file.pixels, file.thickness_angstrom
                ),
            );
            let size = text::bytes(file.file_bytes);
            lines.add("file", format!("{} ({size})", file.output.display()));
            file.picture.iter().for_each(|p| lines.add("picture", p.display().to_string()));
        }
        lines.add("time", text::duration(self.wall_time_s));
        lines.text()
    }
}
