//! `stemgen rerun`.

use super::common::{Common, Force};
use super::patterns_command::PatternsRun;
use super::progress_bar::Reporter;
use super::simulate_command::{Results, SimulateRun};
use super::structure_args::with_frames;
use super::validate_command::DIFFERENT;
use super::{hdf5_check, output};
use anyhow::{Context, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use stemgen::files::sha256_of_file;
use stemgen::io::{PatternFile, StoredImages};
use stemgen::simulation::{AtomsSource, SimulatedImage, SimulationJob, SimulationRequest};

const EXAMPLES: &str = "\
Examples:
  Simulate the images of a file again, and compare them with the stored ones:
    stemgen rerun si.h5
  Simulate the diffraction patterns of a file again:
    stemgen rerun srtio3.emd
  The structure file has moved; write pictures too:
    stemgen rerun si.h5 --structure data/si.cif -o again.h5 --png

With one version of the numerics, on one kind of processor, every pixel has identical bits.

Exit code: 0 if all pixels are identical, 3 if one differs, 1 on errors.";

/// Simulate the images or patterns of a file again, and compare every value
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Rerun {
    /// File of images or patterns, written by `stemgen simulate` or `stemgen patterns`
    #[arg(value_name = "FILE", help_heading = None)]
    file: PathBuf,
    /// Structure file [default: the file that the request names]
    #[arg(long, value_name = "FILE", help_heading = "Specimen")]
    structure: Option<PathBuf>,
    /// File to write [default: FILE_rerun.h5, or FILE_rerun.emd for patterns]
    #[arg(short, long, value_name = "FILE", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    /// Also write a picture (PNG) of every image, beside the file
    #[arg(long, help_heading = "Results")]
    png: bool,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

impl Rerun {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if a value differs.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        hdf5_check::check(&self.file)?;
        if let Some(stored) = PatternFile::open(&self.file)? {
            return self.patterns(&stored, &reporter);
        }
        let Some(stored) = StoredImages::open(&self.file)? else {
            bail!(
                "{}: holds no simulated images or patterns; `stemgen simulate` and `stemgen patterns` write such files",
                self.file.display()
            );
        };
        let request =
            self.request(stored.request.as_deref(), stored.structure_sha256.as_deref())?;
        let given = self.output.clone();
        let output = given.unwrap_or_else(|| output::sibling(&self.file, "_rerun.h5"));
        let mut inputs = vec![self.file.clone()];
        inputs.extend(request.structure.file().map(Path::to_owned));
        let results = Results { overwrite: self.overwrite, png: self.png, ..Results::default() };
        let run = SimulateRun::new(request, results, output, (self.common, self.force))?;
        let same = run.again_of(stored).run(&inputs, &reporter)?;
        Ok(if same { 0 } else { DIFFERENT })
    }

    /// Simulates the whole series of a file of patterns again, and compares the patterns of its thickness and defocus.
    fn patterns(self, stored: &PatternFile, reporter: &Reporter) -> anyhow::Result<u8> {
        // Windows and the draws of electrons depend on the whole series of thicknesses and defocus, so all of it is simulated again.
        let request =
            self.request(stored.request.as_deref(), stored.structure_sha256.as_deref())?;
        let header = stored.header();
        let mut inputs = vec![self.file.clone()];
        inputs.extend(request.structure.file().map(Path::to_owned));
        let given = self.output.clone();
        let output = given.unwrap_or_else(|| output::sibling(&self.file, "_rerun.emd"));
        if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("emd")) {
            bail!("--output {}: patterns are written as .emd", output.display());
        }
        let job = SimulationJob::new(request).map_err(with_frames)?;
        let run = PatternsRun { job, output, png: self.png };
        if self.common.dry_run {
            run.dry_run(&self.common)?;
            return Ok(0);
        }
        let summary = run.execute(&inputs, self.overwrite, (&self.force, reporter))?;
        let mut found = None;
        for path in summary.paths() {
            let Some(made) = PatternFile::open(path)? else { continue };
            let of = made.header();
            if of.thickness_angstrom == header.thickness_angstrom
                && of.defocus_angstrom == header.defocus_angstrom
            {
                found = Some(PatternDifference::between(&made, stored)?);
            }
        }
        let Some(difference) = found else {
            bail!(
                "{}: its request has another thickness or defocus than its patterns; simulate them again with `stemgen patterns`",
                self.file.display()
            );
        };
        let words = format!("{}{}\n", summary.text(), difference.text());
        self.common.print(&difference, &words)?;
        Ok(if difference.same() { 0 } else { DIFFERENT })
    }

    /// Returns the request of the file, and checks that the structure file is the one that it was made from.
    fn request(
        &self,
        text: Option<&str>,
        sha256: Option<&str>,
    ) -> anyhow::Result<SimulationRequest> {
        let file = self.file.display();
        let Some(text) = text else {
            bail!(
                "{file}: holds no request: it was not written by this program, or by an older version"
            );
        };
        let mut request: SimulationRequest = serde_json::from_str(text)
            .with_context(|| format!("{file}: holds a request that this version cannot read"))?;
        if let Some(structure) = &self.structure {
            request.structure = AtomsSource::File(structure.clone());
        }
        let Some(structure) = request.structure.file() else {
            bail!("{file}: its request names no structure file; give --structure FILE");
        };
        if !structure.exists() {
            bail!("{}: is not there; give --structure FILE, where it is now", structure.display());
        }
        let (digest, _) = sha256_of_file(structure)?;
        if sha256.is_some_and(|known| known != digest) {
            bail!(
                "{}: is not the file that {file} was made from (SHA-256 differs); give --structure FILE with that file",
                structure.display()
            );
        }
        Ok(request)
    }
}

/// The difference between new patterns and the patterns of a file.
#[derive(Debug, serde::Serialize)]
struct PatternDifference {
    /// Number of values with other bits; `None` if the patterns have another size.
    values: Option<u64>,
    /// The largest difference in units of the maximum.
    largest: f32,
}

impl PatternDifference {
    fn between(made: &PatternFile, stored: &PatternFile) -> stemgen::Result<Self> {
        let (a, b) = (made.header(), stored.header());
        if a.detector != b.detector || a.scan.shape != b.scan.shape {
            return Ok(PatternDifference { values: None, largest: f32::INFINITY });
        }
        let (mut values, mut off, mut highest) = (0, 0.0_f32, f32::MIN_POSITIVE);
        for row in 0..a.scan.shape[0] {
            let [ours, theirs] = [made.rows(row..row + 1)?, stored.rows(row..row + 1)?];
            for (x, y) in ours.iter().zip(&theirs) {
                values += u64::from(x.to_bits() != y.to_bits());
                off = off.max((x - y).abs());
                highest = highest.max(*x);
            }
        }
        Ok(PatternDifference { values: Some(values), largest: off / highest })
    }

    fn same(&self) -> bool {
        self.values == Some(0)
    }

    fn text(&self) -> String {
        match self.values {
            Some(0) => "patterns: the same bits".to_owned(),
            Some(n) => format!(
                "patterns: {n} values DIFFER, by at most {:.1e} of the maximum",
                self.largest
            ),
            None => "patterns: DIFFER in their size".to_owned(),
        }
    }
}

/// The difference between a new image and the image in a file.
#[derive(Debug, serde::Serialize)]
pub struct ImageDifference {
    name: String,
    /// Number of pixels with other bits, over all thicknesses; `None` if the file has no such image.
    pixels: Option<usize>,
    /// The largest difference in units of the image's maximum.
    largest: Option<f32>,
}

impl ImageDifference {
    /// Compares an image with the image in a file, at every thickness.
    pub fn of(image: &SimulatedImage, stored: &StoredImages) -> stemgen::Result<Self> {
        let none = ImageDifference { name: image.name.clone(), pixels: None, largest: None };
        if !stored.names.contains(&image.name) {
            return Ok(none);
        }
        let (mut pixels, mut largest) = (0, 0.0_f32);
        let highest = image.data.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        for (n, made) in image.data.outer_iter().enumerate() {
            let known = stored.image(&image.name, Some(n))?;
            if known.values.dim() != made.dim() || known.of != image.data.shape()[0] {
                return Ok(none);
            }
            for (a, b) in made.iter().zip(&known.values) {
                pixels += usize::from(a.to_bits() != b.to_bits());
                largest = largest.max((a - b).abs() / highest);
            }
        }
        Ok(ImageDifference { pixels: Some(pixels), largest: Some(largest), ..none })
    }

    /// Whether all bits are identical.
    pub fn same(&self) -> bool {
        self.pixels == Some(0)
    }

    /// Returns the difference as text.
    pub fn text(&self) -> String {
        match (self.pixels, self.largest) {
            (Some(0), _) => format!("{}: the same bits", self.name),
            (Some(n), Some(most)) => format!(
                "{}: DIFFERS in {n} pixels, by at most {most:.1e} of its maximum",
                self.name
            ),
            _ => format!("{}: DIFFERS: the file has no such image of this size", self.name),
        }
    }
}
