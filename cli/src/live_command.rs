//! `stemgen live`.

use super::acquire_command::AcquisitionName;
use super::common::{CacheArgs, Common};
use super::hints::hinted;
use super::plan_text::Lines;
use super::recipe_args::RecipeArgs;
use super::{image_plan_text, output, text, values};
use anyhow::{anyhow, bail};
use clap::Args;
use ndarray::Axis;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::acquisition::{Acquisition, Profile};
use stemgen::files::OutputSet;
use stemgen::files::atomic_write;
use stemgen::files::outputs::check_outputs;
use stemgen::live::{
    DoseSeries, LiveAcquisition, LiveOptions, LiveRequest, LiveWorld, check_recordings,
};
use stemgen::progress::Progress;
use stemgen::recipe::CheckedRecipe;
use stemgen::render::{Contrast, FRAME_S, Picture, animated_png};
use stemgen::world::{BuildOptions, Electrons, ImagePlan, RecordedPart};

const EXAMPLES: &str = "\
Examples:
  MoS2 at 120 kV loses sulphur: 10 recordings at 1e5 electrons per square Angstrom, animated:
    stemgen live mos2 --difficulty easy --grid 1x1 --set optics.energy_kv=120 --dose-series 10 \\
      --dose 1e5 -o dying.h5 --animation
  Silicon at 200 kV, which knocks its atoms out, with the profile of a good microscope:
    stemgen live sige --difficulty easy --grid 4x4 --set alloy.rate=0 --profile routine \\
      --dose-series 30 --dose 2e5 -o silicon.h5 --animation
  Oxygen with a knock-on threshold of 25 eV, and without losses by ionisation:
    stemgen live srtio3 --difficulty easy --grid 4x4 --set damage.threshold_ev.O=25 \\
      --unset damage.radiolysis_barn --dose-series 10 --dose 1e5 -o knock-on.h5
  Read the series in Python:
    import h5py
    f = h5py.File(\"dying.h5\")
    f[\"recording\"][:], f[\"series/ideal\"][:]    # counts, noise-free images [recording, row, column]
    f[\"series/dose_before\"][:], f[\"series/lost/O\"][:]    # one value for each recording
    f[\"series/vacancies\"][:]                            # [recording, column of atoms]

The table [damage] of the recipe sets which elements the beam removes (docs/live.md). From Rust,
`stemgen::live::LiveWorld` records any place, in any order.";

/// Record one place of a specimen many times, while the beam removes its atoms
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Live {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Number of recordings
    #[arg(long, value_name = "N", default_value_t = 20, help_heading = "Recording")]
    dose_series: usize,
    /// Dose of each recording in electrons per square Angstrom, all frames together [default: the dose of the recipe]
    #[arg(long, value_name = "D", value_parser = values::positive, help_heading = "Recording")]
    dose: Option<f64>,
    /// Beam current in pA, in place of --dose
    #[arg(long, value_name = "I", value_parser = values::positive, conflicts_with = "dose")]
    #[arg(help_heading = "Recording")]
    current_pa: Option<f64>,
    /// Middle of the place, in nm from the centre of the first pixel. The place has as many pixels as a tile [default: the middle
    /// of the field]
    #[arg(long, value_name = "X,Y", value_parser = values::point, help_heading = "Recording")]
    #[arg(allow_hyphen_values = true)]
    at: Option<[f64; 2]>,
    /// Factor by which pixels are finer than in the recipe [default: 1]
    #[arg(long, value_name = "Z", value_parser = values::positive, help_heading = "Recording")]
    zoom: Option<f64>,
    /// Profile of the microscope, a named set of values. --set acquisition.KEY=VALUE changes single values [default: the profile
    /// of the recipe, or ideal]
    #[arg(long, value_name = "NAME", help_heading = "Recording")]
    profile: Option<AcquisitionName>,
    /// Detector of the recipe that records, by the name of its table or its image. May be given several times [default: all
    /// detectors]
    #[arg(long, value_name = "NAME", help_heading = "Recording")]
    detector: Vec<String>,
    /// Largest dose that any place may receive, in electrons per square Angstrom. A larger value needs more simulations before the
    /// first recording [default: 1.2 times the dose of the whole series]
    #[arg(long, value_name = "D", value_parser = values::positive, help_heading = "Recording")]
    most_dose: Option<f64>,
    #[command(flatten)]
    kept: CacheArgs,
    /// File to write
    #[arg(short, long, value_name = "FILE.h5", help_heading = "Results")]
    output: PathBuf,
    /// Also write an animation (animated PNG) of the first detector, beside the file
    #[arg(long, help_heading = "Results")]
    animation: bool,
    /// Time that the animation shows each recording, in s
    #[arg(long, value_name = "S", default_value_t = 0.2, value_parser = values::positive)]
    #[arg(help_heading = "Results")]
    frame_s: f64,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct LiveSummary {
    output: PathBuf,
    file_bytes: u64,
    animation: Option<PathBuf>,
    recordings: usize,
    shape: [usize; 2],
    pixel_nm: f64,
    dose_electrons_per_angstrom2: f64,
    total_dose_electrons_per_angstrom2: f64,
    beam_current_pa: f64,
    lost: BTreeMap<String, u64>,
    columns: usize,
    detectors: Vec<String>,
    history: Vec<LiveAcquisition>,
    wall_time_s: f64,
}

/// The plan of a series.
#[derive(Serialize)]
struct LivePlan {
    recordings: usize,
    shape: [usize; 2],
    pixel_nm: f64,
    /// The library, and the image when the series begins. The image is put together again for every recording that follows a loss.
    image: ImagePlan,
    output: PathBuf,
}

impl Live {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let begun = Instant::now();
        let reporter = self.common.start()?;
        if !self.output.extension().is_some_and(|e| e == "h5" || e == "hdf5") {
            let name = self.output.with_extension("h5");
            bail!("--output {}: did you mean {}?", self.output.display(), name.display());
        }
        check_recordings(self.dose_series)?;
        if !FRAME_S.contains(&self.frame_s) {
            let [least, most] = [FRAME_S.start(), FRAME_S.end()];
            bail!("--frame-s {}: write {least} to {most} seconds", self.frame_s);
        }
        let recipe = self.recipe.resolve()?;
        let animation = self.animation.then(|| self.output.with_extension("png"));
        let outputs = std::iter::once(&self.output).chain(&animation);
        let command_line = text::command_line();
        let mut set = OutputSet::of(&self.output, &command_line, self.overwrite);
        set.warning().iter().for_each(|warning| reporter.warn(warning));
        if !self.common.dry_run {
            check_outputs(outputs, self.recipe.inputs(&recipe), set.replaces())?;
        }
        let request = self.request(&recipe);
        let options = self.options(&request)?;
        if self.common.dry_run {
            let image = LiveWorld::plan(&recipe, recipe.seed, &options, &request.part)?;
            return self.planned(image, &request);
        }
        let mut world = LiveWorld::new(&recipe, recipe.seed, &options, &reporter)?;
        if world.specimen().is_lasting() {
            text::complain(
                "warning: the beam removes no atom at this energy: the recipe has no table [damage], or its thresholds are too high",
            );
        }
        let series = world.dose_series(&request, self.dose_series, &reporter)?;
        series.clipping_warnings().iter().for_each(|warning| reporter.warn(warning));
        if animation.is_some() {
            set.begin()?;
        }
        series.write(&self.output, set.replaces(), &world, &command_line)?;
        if let Some(path) = &animation {
            atomic_write::write(path, &self.animated(&series)?)?;
        }
        set.finish()?;
        let summary = self.summary(series, animation, begun);
        self.common.print(&summary, &summary.text())
    }

    /// Prints the plan of the series.
    fn planned(&self, image: ImagePlan, request: &LiveRequest) -> anyhow::Result<()> {
        let plan = LivePlan {
            recordings: self.dose_series,
            shape: request.part.pixels_of(request.part.pixel_nm),
            pixel_nm: request.part.pixel_nm,
            image,
            output: self.output.clone(),
        };
        let mut lines = Lines::default();
        let [rows, columns] = plan.shape;
        let pixels = format!("{rows} x {columns} pixels of {:.5} nm", plan.pixel_nm);
        lines.add("recordings", format!("{} of {pixels}", plan.recordings));
        image_plan_text::add(&plan.image, &mut lines);
        image_plan_text::output(&plan.output, &mut lines);
        self.common.print(&plan, &lines.text())
    }

    fn request(&self, recipe: &CheckedRecipe) -> LiveRequest {
        let mut table = recipe.acquisition.unwrap_or_default();
        table.profile = self.profile.map(Profile::from).or(table.profile);
        let field = &recipe.field;
        let pixel_nm = field.pixel_nm() / self.zoom.unwrap_or(1.0);
        let shape = field.pixels(field.built_grid());
        let middle = [shape[1], shape[0]].map(|n| 0.5 * (n as f64 - 1.0) * field.pixel_nm());
        let dose = self.dose.unwrap_or(recipe.dose.electrons_per_angstrom2);
        LiveRequest {
            part: RecordedPart {
                centre_nm: self.at.unwrap_or(middle),
                size_nm: [field.tile_px as f64 * pixel_nm; 2],
                pixel_nm,
            },
            electrons: self.current_pa.map_or(Electrons::Dose(dose), Electrons::CurrentPa),
            acquisition: table.resolved(),
            keep_frames: false,
        }
    }

    fn options(&self, request: &LiveRequest) -> anyhow::Result<LiveOptions> {
        let acquisition: &Acquisition = &request.acquisition;
        let one = match request.electrons {
            Electrons::Dose(dose) => dose,
            Electrons::CurrentPa(current) => {
                let pixel = 10.0 * request.part.pixel_nm;
                let (dwell, frames) = (acquisition.dwell_us, acquisition.frames);
                stemgen::acquisition::Exposure::of_current(current, dwell, frames, pixel)?.dose()
            }
        };
        // Drift can bring lines together, so that some places receive more than the mean dose.
        let all = 1.2 * one * self.dose_series as f64;
        let most_dose = self.most_dose.unwrap_or(all.min(1e12));
        if most_dose < one * self.dose_series as f64 * (1.0 - 1e-9) {
            let total = one * self.dose_series as f64;
            let fault = anyhow!(
                "--most-dose {most_dose}: the dose of the whole series is {total:.4} electrons per square Angstrom"
            );
            return Err(hinted(
                fault,
                "give a larger --most-dose, or a smaller --dose or --dose-series",
            ));
        }
        let cache = self.kept.cache();
        let imaging = BuildOptions { cache, ..BuildOptions::default() };
        let detectors = (!self.detector.is_empty()).then(|| self.detector.clone());
        Ok(LiveOptions { imaging, most_dose, detectors, ..LiveOptions::default() })
    }

    /// Draws the recordings as an animated PNG, with one contrast for all and the dose before each.
    fn animated(&self, series: &DoseSeries) -> anyhow::Result<Vec<u8>> {
        let images = series.data.mapv(|v| v as f32);
        let all: Vec<f32> = images.iter().copied().collect();
        let [rows, columns] = series.first.frame.shape;
        let whole = Picture::new(&all, [rows * images.len_of(Axis(0)), columns])?;
        let [min, max] = whole.limits()?;
        let pictures = images.outer_iter().zip(&series.dose_before).map(|(image, dose)| {
            let values: Vec<f32> = image.iter().copied().collect();
            let mut picture = Picture::new(&values, [rows, columns])?;
            picture.max_side = 512;
            picture.contrast = Contrast::Range { min, max: max.max(min + 1.0) };
            picture.pixel_angstrom = Some(10.0 * series.first.frame.pixel_nm);
            picture.caption = Some(format!("{} e/A2", text::significant(*dose, 3)));
            picture.render()
        });
        let pictures: Vec<_> = pictures.collect::<stemgen::Result<_>>()?;
        Ok(animated_png(&pictures, self.frame_s)?)
    }

    fn summary(
        &self,
        series: DoseSeries,
        animation: Option<PathBuf>,
        begun: Instant,
    ) -> LiveSummary {
        let mut lost = BTreeMap::new();
        for one in &series.history {
            one.lost.iter().for_each(|(e, n)| *lost.entry(e.clone()).or_default() += n);
        }
        let dose = series.first.exposure.dose();
        LiveSummary {
            file_bytes: output::size(&self.output),
            output: self.output.clone(),
            animation,
            recordings: series.history.len(),
            shape: series.first.frame.shape,
            pixel_nm: series.first.frame.pixel_nm,
            dose_electrons_per_angstrom2: dose,
            total_dose_electrons_per_angstrom2: dose * series.history.len() as f64,
            beam_current_pa: series.first.exposure.current_pa(),
            lost,
            columns: series.first.columns.len(),
            detectors: series.first.images().map(|(detector, _)| detector.name.clone()).collect(),
            history: series.history,
            wall_time_s: begun.elapsed().as_secs_f64(),
        }
    }
}

impl LiveSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let [rows, columns] = self.shape;
        let pixels = format!("{rows} x {columns} pixels of {:.5} nm", self.pixel_nm);
        lines.add("recordings", format!("{} of {pixels}", self.recordings));
        if self.detectors.len() > 1 {
            lines.add("detectors", self.detectors.join(", "));
        }
        let numbers = [
            self.dose_electrons_per_angstrom2,
            self.total_dose_electrons_per_angstrom2,
            self.beam_current_pa,
        ];
        let [one, all, current] = numbers.map(|v| text::significant(v, 4));
        lines.add("dose", format!("{one} e/A2 each, {all} in all; {current} pA"));
        let lost: Vec<String> =
            self.lost.iter().map(|(e, n)| format!("{} {e}", text::count(*n))).collect();
        let lost = if lost.is_empty() { "nothing".into() } else { lost.join(", ") };
        let columns = text::count(self.columns as u64);
        lines.add("lost", format!("{lost}; the first image shows {columns} columns"));
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        if let Some(path) = &self.animation {
            lines.add("animation", path.display().to_string());
        }
        lines.text()
    }
}
