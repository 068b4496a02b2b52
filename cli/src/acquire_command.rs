//! `stemgen acquire`.

use super::common::{CacheArgs, Common};
use super::plan_text::Lines;
use super::recipe_args::RecipeArgs;
use super::{image_plan_text, output, text, values};
use anyhow::bail;
use clap::{Args, ValueEnum};
use ndarray::Axis;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stemgen::acquisition::{Acquisition, Profile};
use stemgen::detect::Detector;
use stemgen::files::OutputSet;
use stemgen::files::outputs::check_outputs;
use stemgen::progress::Progress;
use stemgen::render::image_pictures;
use stemgen::world::{FieldRecording, ImagePlan, RecordedFrom, RecordingJob, RecordingRequest};

const EXAMPLES: &str = "\
Examples:
  A tile in the middle of a world, with the profile of a good microscope, and a picture:
    stemgen acquire worlds/srtio3_easy_2x2.h5 --profile routine -o tile.h5 --png
  Twenty fast frames of one place, stored one by one, from a recipe (no world is needed):
    stemgen acquire srtio3 --difficulty easy --profile routine --region 20,20,24,24 \\
      --current-pa 30 --dwell-us 1 --frames 20 --keep-frames -o frames.h5
  A tile with pixels four times finer than in the world:
    stemgen acquire worlds/srtio3_easy_2x2.h5 --at 2.5,2.5 --zoom 4 --dose 1e5 -o closer.h5
  One effect alone: a drift of 0.5 nm/s along x:
    stemgen acquire srtio3 --difficulty easy --set acquisition.drift_nm_per_s=[0.5,0] -o drift.h5
  Read the recording in Python:
    import h5py
    f = h5py.File(\"tile.h5\")
    f[\"recording\"][:], f[\"ideal\"][:]                        # counts, and the noise-free image
    f[\"ground_truth/columns/position_in_image\"][:]         # place of each column, (x, y) in pixels

The keys of [acquisition] set drift, line jitter, fly-back, mains hum, scale and shear,
contamination, DQE, late light, saturation, gain and bits. docs/acquisition.md explains them. To
print their values: `stemgen show-recipe srtio3 --difficulty easy --set acquisition.profile=routine`";

/// Profile of a microscope: a named set of values.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum AcquisitionName {
    /// Only Poisson noise
    Ideal,
    /// A well-kept, corrected microscope
    Routine,
    /// A microscope on a bad day: drift, hum, an old detector
    Poor,
}

impl From<AcquisitionName> for Profile {
    fn from(name: AcquisitionName) -> Self {
        match name {
            AcquisitionName::Ideal => Profile::Ideal,
            AcquisitionName::Routine => Profile::Routine,
            AcquisitionName::Poor => Profile::Poor,
        }
    }
}

/// Record a place of a world or recipe as a microscope does, with the errors of scan and detector
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Acquire {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Profile of the microscope, a named set of values. --set acquisition.KEY=VALUE changes single values [default: the profile
    /// of the recipe, or ideal]
    #[arg(long, value_name = "NAME", help_heading = "Recording")]
    profile: Option<AcquisitionName>,
    /// Part to record: its left, upper, right and lower edge in nm [default: one tile]
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = values::rectangle)]
    #[arg(allow_hyphen_values = true, conflicts_with = "at", help_heading = "Recording")]
    region: Option<[f64; 4]>,
    /// Middle of the part, in nm from the centre of the first pixel. The part has as many pixels as a tile [default: the middle of
    /// the field]
    #[arg(long, value_name = "X,Y", value_parser = values::point, help_heading = "Recording")]
    #[arg(allow_hyphen_values = true)]
    at: Option<[f64; 2]>,
    /// Factor by which pixels are finer than in the world [default: 1]
    #[arg(long, value_name = "Z", value_parser = values::positive, help_heading = "Recording")]
    zoom: Option<f64>,
    /// Edge of a pixel in nm, in place of --zoom
    #[arg(long, value_name = "NM", value_parser = values::positive, conflicts_with = "zoom")]
    #[arg(help_heading = "Recording")]
    pixel_nm: Option<f64>,
    /// Dose in electrons per square Angstrom, all frames together [default: the dose of the recipe]
    #[arg(long, value_name = "D", value_parser = values::positive, help_heading = "Recording")]
    #[arg(allow_hyphen_values = true)]
    dose: Option<f64>,
    /// Beam current in pA, in place of --dose
    #[arg(long, value_name = "I", value_parser = values::positive, conflicts_with = "dose")]
    #[arg(help_heading = "Recording")]
    current_pa: Option<f64>,
    /// Dwell time on each pixel in microseconds [default: the value of the recipe or the profile]
    #[arg(long, value_name = "US", value_parser = values::finite, help_heading = "Recording")]
    #[arg(allow_hyphen_values = true)]
    dwell_us: Option<f64>,
    /// Number of frames, recorded one after the other [default: the value of the recipe or the profile]
    #[arg(long, value_name = "N", help_heading = "Recording", allow_hyphen_values = true)]
    frames: Option<usize>,
    /// Store every frame, in place of their sum
    #[arg(long, help_heading = "Recording")]
    keep_frames: bool,
    /// Seed of electrons, noise, jitter and random drift
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Recording")]
    #[arg(allow_hyphen_values = true)]
    scan_seed: u64,
    /// Detector of the recipe or the world that records, by the name of its table or its image. May be given several times [default:
    /// all detectors]
    #[arg(long, value_name = "NAME", help_heading = "Recording")]
    detector: Vec<String>,
    /// Also store the stages of the recording: the noise-free image at the real places of the beam, and the electrons on the
    /// detector
    #[arg(long, help_heading = "Results")]
    stages: bool,
    #[command(flatten)]
    kept: CacheArgs,
    /// File to write
    #[arg(short, long, value_name = "FILE.h5", help_heading = "Results")]
    output: PathBuf,
    /// Also write a picture (PNG) of each detector, beside the file
    #[arg(long, help_heading = "Results")]
    png: bool,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct AcquireSummary {
    output: PathBuf,
    file_bytes: u64,
    shape: [usize; 2],
    frames: usize,
    pixel_nm: f64,
    origin_nm: [f64; 2],
    dose_electrons_per_angstrom2: f64,
    beam_current_pa: f64,
    electrons_per_pixel: f64,
    duration_s: f64,
    drift_nm: [f64; 2],
    columns: usize,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    carbon_nm: Vec<f64>,
    clipped_pixels: u64,
    detectors: Vec<DetectorSummary>,
    source: &'static str,
    acquisition: Acquisition,
    wall_time_s: f64,
}

/// One of the detectors of a recording.
#[derive(Serialize)]
struct DetectorSummary {
    name: String,
    units: &'static str,
    clipped_pixels: u64,
}

/// The plan of a recording.
#[derive(Serialize)]
struct AcquirePlan {
    shape: [usize; 2],
    pixel_nm: f64,
    /// `null` if the world holds the image.
    image: Option<ImagePlan>,
    output: PathBuf,
}

impl Acquire {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let begun = Instant::now();
        let reporter = self.common.start()?;
        if !self.output.extension().is_some_and(|e| e == "h5" || e == "hdf5") {
            let name = self.output.with_extension("h5");
            bail!("--output {}: did you mean {}?", self.output.display(), name.display());
        }
        let (recipe, made) = self.recipe.resolve_or_world_with("acquisition")?;
        let request = self.request();
        let pictures = self.pictures(request.detectors_of(&recipe)?);
        let outputs = std::iter::once(&self.output).chain(&pictures);
        let command_line = text::command_line();
        let mut set = OutputSet::of(&self.output, &command_line, self.overwrite);
        set.warning().iter().for_each(|warning| reporter.warn(warning));
        if !self.common.dry_run {
            check_outputs(outputs, self.recipe.inputs(&recipe), set.replaces())?;
        }
        let job = RecordingJob::new(&recipe, (self.recipe.world(), made), &request)?;
        if self.common.dry_run {
            return self.dry_run(&job);
        }
        let (recording, from) = job.run(self.kept.cache(), &reporter)?;
        let (recipe, specimen) = (job.recipe(), job.specimen());
        if !pictures.is_empty() {
            set.begin()?;
        }
        recording.write(&self.output, set.replaces(), recipe, specimen, &command_line)?;
        let step = [10.0 * recording.frame.pixel_nm; 2];
        for (path, (_, data)) in pictures.iter().zip(recording.images()) {
            let image = data.index_axis(Axis(0), 0).mapv(|v| v as f32);
            image_pictures::write(path, image.view(), step, true)?;
        }
        set.finish()?;
        self.warn_of_clipping(&recording);
        let source = match from {
            RecordedFrom::World => "the noise-free image of the world",
            RecordedFrom::Recipe => "made from the recipe",
        };
        let summary = self.summary(&recording, source, begun);
        self.common.print(&summary, &summary.text())
    }

    /// Returns the pictures to write: that of the first detector has the name of the file.
    fn pictures(&self, detectors: Vec<Detector>) -> Vec<PathBuf> {
        let stem = self.output.file_stem().unwrap_or_default().to_string_lossy();
        let name = |(n, detector): (usize, Detector)| match n {
            0 => self.output.with_extension("png"),
            _ => self.output.with_file_name(format!("{stem}_{}.png", detector.name)),
        };
        let all = detectors.into_iter().enumerate().map(name);
        if self.png { all.collect() } else { Vec::new() }
    }

    /// Prints the plan of the recording.
    fn dry_run(&self, job: &RecordingJob) -> anyhow::Result<()> {
        let plan = AcquirePlan {
            shape: job.part().pixels_of(job.part().pixel_nm),
            pixel_nm: job.part().pixel_nm,
            image: job.plan(self.kept.cache())?,
            output: self.output.clone(),
        };
        let mut lines = Lines::default();
        let [rows, columns] = plan.shape;
        let pixels = format!("{rows} x {columns} pixels of {:.5} nm", plan.pixel_nm);
        lines.add("recording", pixels);
        match &plan.image {
            Some(image) => image_plan_text::add(image, &mut lines),
            None => lines.add("image", "the world holds it; nothing has to be simulated"),
        }
        image_plan_text::output(&plan.output, &mut lines);
        self.common.print(&plan, &lines.text())
    }

    /// Returns the request that the options describe.
    fn request(&self) -> RecordingRequest {
        RecordingRequest {
            region_nm: self.region,
            at_nm: self.at,
            zoom: self.zoom,
            pixel_nm: self.pixel_nm,
            profile: self.profile.map(Profile::from),
            electrons_per_angstrom2: self.dose,
            current_pa: self.current_pa,
            dwell_us: self.dwell_us,
            frames: self.frames,
            keep_frames: self.keep_frames,
            keep_stages: self.stages,
            seed: self.scan_seed,
            detectors: (!self.detector.is_empty()).then(|| self.detector.clone()),
        }
    }

    fn warn_of_clipping(&self, recording: &FieldRecording) {
        if self.common.quiet {
            return;
        }
        for warning in recording.clipping_warnings() {
            text::complain(&format!("warning: {warning}"));
        }
    }

    fn summary(
        &self,
        recording: &FieldRecording,
        source: &'static str,
        begun: Instant,
    ) -> AcquireSummary {
        let FieldRecording { frame, exposure, options, .. } = recording;
        let [_, x, y] = recording.drift.last().copied().unwrap_or_default();
        let lines = recording.drift.len() as f64;
        let acquisition = options.acquisition;
        let others = recording.others.iter().map(|one| (&one.detector, one.clipped));
        let detectors = std::iter::once((&recording.detector, recording.clipped)).chain(others);
        let detectors = detectors.map(DetectorSummary::of);
        AcquireSummary {
            file_bytes: output::size(&self.output),
            output: self.output.clone(),
            shape: frame.shape,
            frames: exposure.frames,
            pixel_nm: frame.pixel_nm,
            origin_nm: frame.origin_nm,
            dose_electrons_per_angstrom2: exposure.dose(),
            beam_current_pa: exposure.current_pa(),
            electrons_per_pixel: exposure.electrons_per_pixel,
            duration_s: acquisition.line_s(frame.shape[1]) * lines,
            drift_nm: [x, y],
            columns: recording.columns.len(),
            carbon_nm: recording.carbon_nm.clone(),
            clipped_pixels: recording.clipped,
            detectors: detectors.collect(),
            source,
            acquisition,
            wall_time_s: begun.elapsed().as_secs_f64(),
        }
    }
}

impl DetectorSummary {
    fn of((detector, clipped_pixels): (&Detector, u64)) -> Self {
        let units = if detector.is_deflection() { "mrad" } else { "counts" };
        DetectorSummary { name: detector.name.clone(), units, clipped_pixels }
    }
}

impl AcquireSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let [rows, columns] = self.shape;
        let frames =
            if self.frames > 1 { format!(", {} frames", self.frames) } else { String::new() };
        let pixels = format!("{rows} x {columns} pixels of {:.5} nm{frames}", self.pixel_nm);
        lines.add("recording", pixels);
        let [x, y] = self.origin_nm;
        lines.add("first pixel", format!("{x:.3}, {y:.3} nm"));
        if self.detectors.len() > 1 {
            let names: Vec<&str> = self.detectors.iter().map(|d| d.name.as_str()).collect();
            lines.add("detectors", names.join(", "));
        }
        lines.add("image", self.source);
        let numbers =
            [self.dose_electrons_per_angstrom2, self.beam_current_pa, self.electrons_per_pixel];
        let [dose, current, per_pixel] = numbers.map(|v| text::significant(v, 4));
        lines.add(
            "dose",
            format!("{dose} e/A2: {current} pA, {per_pixel} electrons on a pixel of a frame"),
        );
        let [x, y] = self.drift_nm;
        let scan = text::duration(self.duration_s);
        lines.add("scan", format!("{scan}; drift {x:.3}, {y:.3} nm until the last line"));
        if let Some(nm) = self.carbon_nm.last() {
            lines.add("carbon", format!("{nm:.3} nm under the last frame"));
        }
        lines.add("columns", text::count(self.columns as u64));
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", Path::new(&self.output).display()));
        lines.text()
    }
}
