//! `stemgen import`.

use super::common::Common;
use super::hdf5_check;
use super::plan_text::Lines;
use super::{output, text, values};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use stemgen::files::outputs::check_outputs;
use stemgen::io::recorded::{self, ImageChoice};
use stemgen::progress::Progress;
use stemgen::replay::{PixelOrigin, ReplayFacts, ReplayOptions, ReplayWorld};

const EXAMPLES: &str = "\
Examples:
  An image of DigitalMicrograph, with the pixel size that the file states:
    stemgen import MoS2.dm3 -o mos2.h5
  Measure the pixel on planes that are 0.2737 nm apart, in the Fourier transform:
    stemgen import MoS2.dm3 --calibrate 0.2737 -o mos2.h5
  A file without a pixel size; its pixels are 0.0128 nm wide:
    stemgen import image.tif --pixel-size 0.0128 -o world.h5
  One image of several (without these options the error lists them):
    stemgen import scan.emd --dataset HAADF --index 3 -o world.h5
    stemgen import reconstruction.h5 --dataset /object/phase --pixel-size 0.02 -o world.h5

The command reads DM3 and DM4, Velox EMD, HyperSpy (.hspy, .hdf5), other HDF5 (Berkeley EMD,
Prismatic, NeXus, py4DSTEM ...), TIFF, .npy, .npz, zarr, and the HDF5 files of the BiFeO3 images of
the STEMGym paper with their unit cells. Axes that a file names x and y set the orientation of the
image. The noise of the recording is kept. Values that are not finite numbers become the median of
the image, and /valid_region marks them. docs/replay.md describes the formats.";

/// Convert a recorded image to a world file, for `view`, `tiles`, `verify` and `info`
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ImportImage {
    /// File with a recorded image
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Image to read, if the file holds several: its name, or the path of a dataset
    #[arg(long, value_name = "NAME", help_heading = "Image")]
    dataset: Option<String>,
    /// Frame to read, from 0, if the image has several
    #[arg(long, value_name = "N", help_heading = "Image")]
    index: Option<usize>,
    /// Edge of a pixel in nm [default: the size that the file states]
    #[arg(long, value_name = "NM", value_parser = values::positive, help_heading = "Scale")]
    #[arg(allow_hyphen_values = true)]
    pixel_size: Option<f64>,
    /// Measure the pixel on lattice planes that are this far apart, in nm. The program searches their peak in the Fourier
    /// transform, within 15 % of the position that follows from the file or from --pixel-size
    #[arg(long, value_name = "NM", value_parser = values::positive, help_heading = "Scale")]
    #[arg(allow_hyphen_values = true)]
    calibrate: Option<f64>,
    /// Percentiles of the recorded values that become 0 and 1. Values beyond them are cut off
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.1,99.9", help_heading = "Scale")]
    #[arg(value_parser = values::percentiles)]
    contrast: Percentiles,
    /// World to write
    #[arg(short, long, value_name = "WORLD.h5", help_heading = "Results")]
    output: PathBuf,
    /// Replace an existing file
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

/// Change of the pixel in per cent above which a calibration is doubtful: the sizes in files are seldom wrong by more.
const USUAL_PERCENT: f64 = 10.0;

/// Two numbers of one option.
type Percentiles = [f64; 2];

/// The summary that `--json` prints.
#[derive(Serialize)]
struct ImportSummary {
    input: PathBuf,
    output: PathBuf,
    /// `None` after a dry run.
    file_bytes: Option<u64>,
    #[serde(flatten)]
    facts: ReplayFacts,
}

impl ImportImage {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        check_outputs([&self.output], [&self.file], self.overwrite)?;
        if recorded::is_hdf5_inside(&self.file)? {
            hdf5_check::check(&self.file)?;
        }
        let choice = ImageChoice { dataset: self.dataset.clone(), index: self.index };
        let options = ReplayOptions {
            pixel_nm: self.pixel_size,
            spacing_nm: self.calibrate,
            percentiles: self.contrast,
        };
        let world = ReplayWorld::new(recorded::read(&self.file, &choice)?, &options)?;
        if !self.common.dry_run {
            world.write(&self.output, self.overwrite, &reporter)?;
        }
        let in_file = world.facts().pixel_size_in_file_nm;
        let change =
            in_file.map_or(0.0, |in_file| 100.0 * (world.facts().pixel_size_nm / in_file - 1.0));
        if world.facts().calibration.is_some() && change.abs() > USUAL_PERCENT {
            reporter.warn(&format!(
                "the calibration changes the file's pixel by {change:+.1} %, more than is usual: is {} nm the spacing that was found?",
                self.calibrate.unwrap_or_default()
            ));
        }
        let summary = ImportSummary {
            input: self.file,
            file_bytes: (!self.common.dry_run).then(|| output::size(&self.output)),
            output: self.output,
            facts: world.facts().clone(),
        };
        self.common.print(&summary, &summary.text())
    }
}

impl ImportSummary {
    fn text(&self) -> String {
        let f = &self.facts;
        let mut lines = Lines::default();
        let [rows, columns] = f.recorded_px;
        let about = [f.image.as_str(), f.detector.as_deref().unwrap_or_default()];
        let mut about: Vec<String> =
            about.into_iter().filter(|t| !t.is_empty()).map(str::to_owned).collect();
        about.dedup();
        about.extend(f.energy_kev.map(|kev| format!("{kev} keV")));
        let about = about.iter().map(|t| format!(", {t}")).collect::<String>();
        lines.add("image", format!("{}{about}, {rows} x {columns} pixels", f.format));
        let [rows, columns] = f.tiles;
        let [height, width] = f.pixels;
        lines.add("tiles", format!("{rows} x {columns}, of its first {height} x {width} pixels"));
        lines.add("pixel", self.pixel());
        if let Some(c) = &f.calibration {
            let peak = |p: &stemgen::replay::CalibrationPeak| {
                format!("{:.3} px at {:.1} degrees", p.spacing_px, p.direction_deg)
            };
            let peaks: Vec<String> = c.peaks.iter().map(peak).collect();
            lines.add("measured on", format!("{} nm: {}", c.spacing_nm, peaks.join(", ")));
        }
        for note in &f.notes {
            lines.add("note", note.clone());
        }
        let [low, high] = f.range.map(|v| text::significant(v, 5));
        let [below, above] = f.cut_off.map(|share| text::significant(100.0 * share, 2));
        lines.add(
            "scaling",
            format!("{low} to {high} become 0 to 1; {below} % below, {above} % above"),
        );
        if f.invalid_pixels > 0 {
            let count = text::count(f.invalid_pixels as u64);
            lines.add("gaps", format!("{count} pixels without a value have the median"));
        }
        if f.sites + f.sites_left_out > 0 {
            let out = text::count(f.sites_left_out as u64);
            lines.add("places", format!("{}, left out: {out}", text::count(f.sites as u64)));
        }
        if !f.phases.is_empty() {
            lines.add("phases", f.phases.join(", "));
        }
        let path = self.output.display();
        match self.file_bytes {
            Some(bytes) => lines.add("world", format!("{path} ({})", text::bytes(bytes))),
            None => lines.add("world", format!("{path} would be written")),
        }
        lines.text()
    }

    fn pixel(&self) -> String {
        let f = &self.facts;
        let nm = |v: f64| text::significant(v, 5);
        let pixel = nm(f.pixel_size_nm);
        let in_file = match f.pixel_size_in_file_nm {
            Some(in_file) if f.pixel_size_from != PixelOrigin::File => {
                let change = 100.0 * (f.pixel_size_nm / in_file - 1.0);
                format!("; the file says {} nm ({change:+.2} % to here)", nm(in_file))
            }
            _ => String::new(),
        };
        let from = match f.pixel_size_from {
            PixelOrigin::File => ", as the file says",
            PixelOrigin::Given => ", as given",
            PixelOrigin::Calibrated => ", calibrated",
        };
        format!("{pixel} nm{from}{in_file}")
    }
}
