//! `stemgen patterns`.

use super::common::{Common, Force};
use super::imaging_args::{MicroscopeArgs, NumericsArgs, put_some};
use super::plan_text::{self, Lines};
use super::progress_bar::Reporter;
use super::request_file::RequestFile;
use super::scan_args::ScanArgs;
use super::structure_args::{StructureArgs, file_name, stem, with_frames};
use super::{hints, output, text, values};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stemgen::detect::{DetectorMtf, PatternDetector};
use stemgen::files::outputs::check_outputs;
use stemgen::files::{Shard, read_text};
use stemgen::io::{PatternFormat, PatternParts, PatternRun, WrittenPatterns};
use stemgen::progress::Progress;
use stemgen::render::image_pictures;
use stemgen::simulation::{PlanReport, SimulationJob, SimulationRequest};

const EXAMPLES: &str = "\
Examples:
  One unit cell of SrTiO3, 39 A thick: 20 x 20 probes, patterns of 64 x 64 pixels to 100 mrad:
    stemgen patterns srtio3.cif --repeat 8,8,10 --scan-start 15.62,15.62 --scan-end 19.525,19.525 \\
      --scan-points 20,20
  Counted electrons on a finer detector, eight phonon configurations, two thicknesses (two files):
    stemgen patterns srtio3.cif --repeat 8,8,20 --pixels 128 --max-angle 60 --dose 1e5 \\
      --phonons 8 --sigma 0.08 --thicknesses 39,78
  Rings of 1 mrad in place of pixels; `stemgen integrate` sums any annulus from them:
    stemgen patterns srtio3.cif --repeat 8,8,10 --radial 1 --max-angle 200
  A finite source, and a detector that spreads electrons over its pixels:
    stemgen patterns srtio3.cif --repeat 8,8,10 --source-size 0.8 --mtf 0.6 --dose 1e5
  One scan in four parts, on machines that share a file system; then the patterns:
    stemgen patterns srtio3.cif --repeat 8,8,10 --shard 0/4    # and 1/4, 2/4, 3/4
    stemgen patterns srtio3.cif --repeat 8,8,10
  Print time, memory and file size only:
    stemgen patterns mos2.xyz --energy 80 --semiangle 25 --dry-run
  Images from the patterns:
    stemgen integrate srtio3.emd --annulus ABF=10-21 --sectors 0-21:4 --com --icom --png

py4DSTEM, LiberTEM and HyperSpy open the file (.emd, HDF5): fractions of the beam, or electrons,
[y, x, ky, kx]. k = 0 is at pixel n / 2; x runs right and y down. `stemgen rerun FILE.emd` repeats
the simulation and compares.

Without --engine or --window, each probe is propagated in a window, a small box that holds the beam;
the part of the probe outside of it is added coherently.";

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
    /// Write all settings that decide the patterns to a file, and simulate nothing. `stemgen patterns FILE.toml` simulates them
    #[arg(long, value_name = "FILE.toml", help_heading = "Running")]
    write_request: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

/// Holds the options of the pixelated detector.
#[derive(Debug, Args)]
#[command(next_help_heading = "Pixelated detector")]
pub struct PatternArgs {
    /// Pixels along each edge of the detector [default: 64]
    #[arg(long, value_name = "N")]
    pixels: Option<usize>,
    /// Half the width of the detector, or the outer angle of the last ring with --radial, in mrad [default: 100]
    #[arg(long, value_name = "MRAD", value_parser = values::positive)]
    max_angle: Option<f64>,
    /// Sum patterns over rings of this width in mrad, up to --max-angle, in place of pixels. The file is small, and
    /// `stemgen integrate` sums any annulus from it
    #[arg(long, value_name = "MRAD", value_parser = values::positive, conflicts_with = "pixels")]
    radial: Option<f64>,
    /// Spread of the electrons of a pixel over its neighbours: the standard deviation of a Gaussian, in pixels, or a file with
    /// the modulation transfer function. Each line of the file holds cycles per pixel and transfer; the first is 0, 1
    /// [default: no spread]
    #[arg(long, value_name = "PIXELS|FILE", value_parser = mtf, conflicts_with = "radial", allow_negative_numbers = true)]
    mtf: Option<DetectorMtf>,
    /// Leave out the part of each probe outside its window
    #[arg(long)]
    no_coherent_tail: bool,
}

/// Holds the options of the results.
#[derive(Debug, Args)]
#[command(next_help_heading = "Results")]
pub struct PatternResults {
    /// Thicknesses in A at which patterns are recorded, each in a separate file [default: the whole specimen]
    #[arg(long, value_name = "A,A,...", value_delimiter = ',', value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    thicknesses: Vec<f64>,
    /// File to write. Its ending sets the format: .emd; .hspy for HyperSpy; .toml for sparse counts (raw CSR of LiberTEM, with
    /// three files beside it); .raw for frames of the EMPAD (with .json and .xml) [default: name of the structure file with
    /// .emd, in the current folder]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    /// Dose in electrons per square Angstrom of the scan. The file then holds counted electrons; --seed seeds the noise
    #[arg(long, value_name = "E/A^2", value_parser = values::positive)]
    dose: Option<f64>,
    /// Simulate only part K of N, and store it: neighbouring rows of the scan. `slurm` takes K and N from a job array. The
    /// command without --shard then finds the parts and writes the patterns
    #[arg(long, value_name = "K/N|slurm", value_parser = values::shard, help_heading = "Running")]
    shard: Option<Shard>,
    /// Also write a picture (PNG) of the mean pattern, beside the file. It shows the fourth root of the intensities
    #[arg(long)]
    png: bool,
}

#[derive(Serialize)]
struct PatternsDryRun {
    structure: String,
    atoms: usize,
    scan: [usize; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    pixels: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rings: Option<usize>,
    max_angle_mrad: f64,
    file_bytes: u64,
    outputs: Vec<PathBuf>,
    #[serde(flatten)]
    plan: PlanReport,
}

/// The report of a shard at its end.
#[derive(Serialize)]
struct PatternPartReport {
    output: PathBuf,
    /// Its number, from 0, and the number of shards.
    shard: [usize; 2],
    /// Rows of the simulated scan, of all defoci.
    rows: usize,
    rows_resumed: usize,
    wall_time_s: f64,
}

impl PatternPartReport {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let [index, count] = self.shard;
        lines.add("shard", format!("{index}/{count} of {}", self.output.display()));
        let was = match self.rows_resumed {
            0 => String::new(),
            n => format!(", {n} of which were stored already"),
        };
        lines.add("rows", format!("{}{was}", self.rows));
        let next =
            "when all shards are done, run the command without --shard: it writes the patterns";
        lines.add("next", next);
        lines.add("time", text::duration(self.wall_time_s));
        lines.text()
    }
}

/// The summary of a run.
#[derive(Serialize)]
pub struct PatternsSummary {
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
    #[serde(skip_serializing_if = "Option::is_none")]
    pixels: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rings: Option<usize>,
    /// Mean over patterns: the share of the beam on the detector, or the number of electrons.
    mean_sum: f64,
    #[serde(skip)]
    counted: bool,
}

/// Reads a standard deviation, or the table in a file.
fn mtf(text: &str) -> Result<DetectorMtf, String> {
    let found = match text.trim().parse::<f64>() {
        Ok(_) => DetectorMtf::parse(text),
        Err(_) => read_text(Path::new(text), MOST_MTF_BYTES).and_then(|t| DetectorMtf::parse(&t)),
    };
    found.map_err(|e| e.to_string())
}

/// Most bytes of a file with a transfer function.
const MOST_MTF_BYTES: usize = 1 << 20;

impl Patterns {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        let request = self.request()?;
        if let Some(path) = &self.write_request {
            let inputs = [self.specimen.structure.clone()];
            let written =
                RequestFile { path, command: "patterns", overwrite: self.results.overwrite };
            return written.write(request, &inputs, &self.common);
        }
        let job = SimulationJob::new(request).map_err(with_frames)?;
        let given = self.results.output.clone();
        let output = given.unwrap_or_else(|| {
            let mut name = stem(&self.specimen.structure).into_os_string();
            name.push(".emd");
            PathBuf::from(name)
        });
        let rings = job.pattern_settings().is_some_and(|s| s.detector.rings().is_some());
        if rings && self.results.png {
            bail!(
                "--png: sums over rings have no picture; `stemgen integrate` makes images of them"
            );
        }
        let run = PatternsRun { job, output, png: self.results.png };
        if self.common.dry_run {
            return run.dry_run(&self.common);
        }
        let inputs = [self.specimen.structure.clone()];
        if let Some(shard) = self.results.shard {
            run.check(&inputs, self.results.overwrite, (&self.force, &reporter))?;
            let part = run.part(shard, &reporter)?;
            return self.common.print(&part, &part.text());
        }
        let summary = run.execute(&inputs, self.results.overwrite, (&self.force, &reporter))?;
        self.common.print(&summary, &summary.text())
    }

    /// Returns the request that the options describe.
    fn request(&self) -> anyhow::Result<SimulationRequest> {
        if !self.microscope.detector.is_empty() {
            bail!(
                "--detector: is not for `stemgen patterns`, which records whole patterns; leave it out, and sum a ring afterwards: `stemgen integrate FILE.emd --annulus NAME=INNER-OUTER`"
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
        put_some(&self.detector.radial, &mut patterns.radial_mrad);
        put_some(&self.detector.mtf, &mut patterns.mtf);
        patterns.coherent_tail &= !self.detector.no_coherent_tail;
        Ok(request)
    }
}

/// A simulation of patterns, with the files that it writes.
pub struct PatternsRun {
    pub job: SimulationJob,
    pub output: PathBuf,
    pub png: bool,
}

impl PatternsRun {
    /// Checks, simulates and writes. `inputs` are files that must not be replaced.
    pub fn execute(
        &self,
        inputs: &[PathBuf],
        overwrite: bool,
        (force, reporter): (&Force, &Reporter),
    ) -> anyhow::Result<PatternsSummary> {
        self.check(inputs, overwrite, (force, reporter))?;
        let begun = Instant::now();
        let files = self.write(overwrite, reporter)?;
        Ok(PatternsSummary { files, wall_time_s: begun.elapsed().as_secs_f64() })
    }

    /// Simulates the part of one of several processes, and stores it.
    fn part(&self, shard: Shard, reporter: &Reporter) -> anyhow::Result<PatternPartReport> {
        let begun = Instant::now();
        let made = PatternParts::new(&self.job, &self.output, reporter)?.make(shard)?;
        Ok(PatternPartReport {
            output: self.output.clone(),
            shard: [shard.index(), shard.count()],
            rows: made.rows,
            rows_resumed: made.stored,
            wall_time_s: begun.elapsed().as_secs_f64(),
        })
    }

    fn check(
        &self,
        inputs: &[PathBuf],
        overwrite: bool,
        (force, reporter): (&Force, &Reporter),
    ) -> anyhow::Result<()> {
        let files = self.run("").files();
        let pictures = files.iter().filter(|_| self.png).map(|(path, _)| picture_of(path));
        let mut outputs = self.run("").outputs()?;
        outputs.extend(pictures);
        check_outputs(&outputs, inputs, overwrite)?;
        self.warnings().iter().for_each(|warning| reporter.warn(warning));
        for (bytes, remedy) in self.job.memory() {
            force.check_memory(bytes, remedy, reporter)?;
        }
        Ok(self.run("").check_space()?)
    }

    /// Returns the run that simulates and writes.
    fn run<'a>(&'a self, command_line: &'a str) -> PatternRun<'a> {
        PatternRun { job: &self.job, output: &self.output, command_line }
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings: Vec<String> =
            self.job.warnings().iter().map(hints::with_option).collect();
        let [x, y] = self.job.scan().step_angstrom;
        if (x / y - 1.0).abs() > 1e-3 {
            warnings.push(format!(
                "probes are {x:.4} A apart along x and {y:.4} A along y; py4DSTEM assumes equal distances: choose --scan-points that make \
                 them equal"
            ));
        }
        warnings
    }

    /// Prints the plan.
    pub fn dry_run(&self, common: &Common) -> anyhow::Result<()> {
        let mut plan = self.job.report()?;
        plan.warnings = self.warnings();
        self.run("").outputs()?;
        let files = self.run("").files();
        let Some((_, header)) = files.first() else { bail!("there is nothing to simulate") };
        let all = PatternsDryRun {
            structure: self.job.request().structure.file().map(file_name).unwrap_or_default(),
            atoms: self.job.specimen().sites.len(),
            scan: header.scan.shape,
            pixels: header.detector.pixels().map(|detector| detector.pixels),
            rings: header.detector.rings().map(|detector| detector.rings),
            max_angle_mrad: header.detector.max_angle_mrad(),
            file_bytes: PatternFormat::of(&self.output)?.bytes(header),
            outputs: files.iter().map(|(path, _)| path.clone()).collect(),
            plan,
        };
        let mut lines = Lines::default();
        lines.add("structure", format!("{}: {} atoms", all.structure, all.atoms));
        plan_text::all(&all.plan, &mut lines);
        lines.add("probes", plan_text::scan(self.job.scan()));
        lines.add("patterns", detector_text(&header.detector));
        let simulated = self.job.simulated_scan()?;
        if simulated != header.scan {
            lines.add("for the source", plan_text::scan(&simulated));
        }
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
        if let (Some(picture), Some(detector)) = (&picture, header.detector.pixels()) {
            let shown = mean.mapv(|v| v.max(0.0).powf(0.25) as f32);
            let pixel = detector.pixel_k(header.wavelength_angstrom);
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
            pixels: header.detector.pixels().map(|detector| detector.pixels),
            rings: header.detector.rings().map(|detector| detector.rings),
            mean_sum: mean.sum(),
            counted: header.counted.is_some(),
        })
    }
}

fn detector_text(detector: &PatternDetector) -> String {
    match detector {
        PatternDetector::Pixels(d) => format!(
            "{0} x {0} pixels to {1} mrad, {2:.3} mrad each",
            d.pixels,
            d.max_angle_mrad,
            d.pixel_mrad()
        ),
        PatternDetector::Rings(d) => {
            format!("{} rings of {} mrad to {} mrad", d.rings, d.width_mrad, d.max_angle_mrad())
        }
    }
}

fn picture_of(path: &Path) -> PathBuf {
    output::sibling(path, "_mean.png")
}

impl PatternsSummary {
    /// Returns the files that were written.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|file| file.output.as_path())
    }

    /// Returns the summary as text.
    pub fn text(&self) -> String {
        let mut lines = Lines::default();
        for file in &self.files {
            let sum = match file.counted {
                true => format!("{:.1} electrons in the mean", file.mean_sum),
                false => format!("{:.2} % of the beam in the mean", 100.0 * file.mean_sum),
            };
            let values = match (file.pixels, file.rings) {
                (Some(pixels), _) => format!("{pixels} x {pixels} pixels"),
                (None, rings) => format!("{} rings", rings.unwrap_or(0)),
            };
            lines.add(
                "patterns",
                format!(
                    "{} x {} probes, {values}, at {:.2} A: {sum}",
                    file.columns, file.rows, file.thickness_angstrom
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
