//! `stemgen integrate`.

use super::common::Common;
use super::plan_text::Lines;
use super::{hdf5_check, output, text};
use anyhow::bail;
use clap::Args;
use ndarray::{Array2, Array3, Axis};
use serde::Serialize;
use std::path::PathBuf;
use stemgen::detect::{
    VirtualDetector, centre_of_mass_mrad, integrated_centre_of_mass, weighted_sum,
};
use stemgen::files::outputs::check_outputs;
use stemgen::io::{ImageSeries, ImageStack, Origin, PatternFile, write_images, write_tiff};
use stemgen::progress::Progress;
use stemgen::render::image_pictures;

use super::values::Bits;

const EXAMPLES: &str = "\
Examples:
  Images of two annular detectors, with pictures:
    stemgen integrate srtio3.emd --annulus ABF=10-21 --annulus ADF=40-90 --png
  A quadrant detector turned by 45 degrees, and the centre of mass of every pattern:
    stemgen integrate srtio3.emd --sectors DPC=0-21:4@45 --com
  Two annuli from a file of rings (`stemgen patterns --radial 1 --max-angle 200`):
    stemgen integrate rings.emd --annulus HAADF=68-200 --annulus 90-150
  The integrated centre of mass (the phase of a thin specimen), as TIFF for ImageJ:
    stemgen integrate srtio3.emd --icom --tiff 32

The file (HDF5) has the layout of `stemgen simulate`: /images/NAME, [thickness, y, x]. Azimuths
count from +x (right) towards +y (down). A pixel at the edge of a detector counts with the share of
its area on the detector. An annulus of rings has to begin and end at edges of rings.";

/// Compute images from diffraction patterns: rings, sectors, centre of mass
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Integrate {
    /// File of diffraction patterns, written by `stemgen patterns`
    #[arg(value_name = "FILE.emd", help_heading = None)]
    file: PathBuf,
    /// Sum each pattern over a ring from INNER to OUTER mrad (repeatable)
    #[arg(long, value_name = "[NAME=]INNER-OUTER", help_heading = "Detectors")]
    annulus: Vec<String>,
    /// Sum each pattern over N equal sectors of a ring in mrad (repeatable): images NAME_0, NAME_1, ... The first sector begins
    /// at DEGREES
    #[arg(long, value_name = "[NAME=]INNER-OUTER:N[@DEGREES]", help_heading = "Detectors")]
    sectors: Vec<String>,
    /// Compute the centre of mass of every pattern, in mrad: images com_x and com_y
    #[arg(long, help_heading = "Detectors")]
    com: bool,
    /// Integrate the centre of mass, in radians: image icom. The scan is treated as periodic
    #[arg(long, help_heading = "Detectors")]
    icom: bool,
    /// File to write [default: FILE_images.h5]
    #[arg(short, long, value_name = "FILE.h5", help_heading = "Results")]
    output: Option<PathBuf>,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    /// Also write a picture (PNG) of every image, beside the file
    #[arg(long, help_heading = "Results")]
    png: bool,
    /// Also write every image as TIFF of 8, 16 or 32 bits. ImageJ reads its pixel size and its values
    #[arg(long, value_name = "BITS", help_heading = "Results")]
    tiff: Option<Bits>,
    #[command(flatten)]
    common: Common,
}

/// An image with the units of its values, and its ring if it is the image of one.
struct VirtualImage {
    name: String,
    units: &'static str,
    annulus_mrad: Option<[f64; 2]>,
    sector_degrees: Option<[f64; 2]>,
    data: Array2<f32>,
}

#[derive(Serialize)]
struct IntegrateSummary {
    output: PathBuf,
    images: Vec<ImageLine>,
    pictures: Vec<PathBuf>,
    tiffs: Vec<PathBuf>,
}

#[derive(Serialize)]
struct ImageLine {
    name: String,
    units: &'static str,
    rows: usize,
    columns: usize,
    min: f32,
    mean: f32,
    max: f32,
}

impl Integrate {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let reporter = self.common.start()?;
        hdf5_check::check(&self.file)?;
        let Some(patterns) = PatternFile::open(&self.file)? else {
            bail!("{}: is no file of patterns that `stemgen patterns` wrote", self.file.display());
        };
        let detectors = self.detectors()?;
        if patterns.header().detector.pixels().is_none() && (self.com || self.icom) {
            bail!(
                "{}: holds sums over rings, which have no centre of mass; simulate pixels: `stemgen patterns` without --radial",
                self.file.display()
            );
        }
        if detectors.is_empty() && !self.com && !self.icom {
            bail!("no image is asked for; give --annulus, --sectors, --com or --icom");
        }
        let given = self.output.clone();
        let output = given.unwrap_or_else(|| output::sibling(&self.file, "_images.h5"));
        stemgen::simulation::check_hdf5_name(&output)?;
        let names = self.names(&detectors)?;
        let beside = |on: bool, ending: &str| -> Vec<PathBuf> {
            let path = |name: &String| output::sibling(&output, &format!("_{name}.{ending}"));
            names.iter().filter(|_| on).map(path).collect()
        };
        let (pictures, tiffs) = (beside(self.png, "png"), beside(self.tiff.is_some(), "tif"));
        let all = std::iter::once(&output).chain(&pictures).chain(&tiffs);
        check_outputs(all, [&self.file], self.overwrite)?;
        if self.common.dry_run {
            let mut lines = Lines::default();
            lines.add("images", names.join(", "));
            lines.add("output", format!("{} (nothing was written)", output.display()));
            return self.common.print(&names, &lines.text());
        }
        let made = self.images(&patterns, &detectors, &reporter)?;
        self.write(&patterns, &made, (&output, &pictures, &tiffs))?;
        let summary = IntegrateSummary {
            images: made.iter().map(ImageLine::of).collect(),
            output,
            pictures,
            tiffs,
        };
        self.common.print(&summary, &summary.text())
    }

    fn detectors(&self) -> stemgen::Result<Vec<VirtualDetector>> {
        let mut all = Vec::new();
        for ring in &self.annulus {
            all.push(VirtualDetector::annulus(ring)?);
        }
        for ring in &self.sectors {
            all.extend(VirtualDetector::sectors(ring)?);
        }
        Ok(all)
    }

    fn names(&self, detectors: &[VirtualDetector]) -> anyhow::Result<Vec<String>> {
        let mut names: Vec<String> = detectors.iter().map(|d| d.name.clone()).collect();
        if self.com {
            names.extend(["com_x", "com_y"].map(str::to_owned));
        }
        names.extend(self.icom.then(|| "icom".to_owned()));
        for (n, name) in names.iter().enumerate() {
            if names[..n].contains(name) {
                bail!(
                    "two images have the name {name}; give one of the detectors another name: NAME=INNER-OUTER"
                );
            }
        }
        Ok(names)
    }

    fn images(
        &self,
        patterns: &PatternFile,
        detectors: &[VirtualDetector],
        progress: &dyn Progress,
    ) -> stemgen::Result<Vec<VirtualImage>> {
        let header = patterns.header();
        let weights: Vec<Array2<f32>> =
            detectors.iter().map(|d| header.detector.weights(d)).collect::<stemgen::Result<_>>()?;
        let [rows, columns] = header.scan.shape;
        let mut sums = vec![Array2::zeros((rows, columns)); weights.len()];
        let mut com = [Array2::zeros((rows, columns)), Array2::zeros((rows, columns))];
        progress.start("reading", "rows", rows as u64);
        for y in 0..rows {
            if progress.interrupted() {
                return Err(stemgen::Error::Interrupted);
            }
            let row = patterns.rows(y..y + 1)?;
            for (x, pattern) in row.index_axis(Axis(0), 0).outer_iter().enumerate() {
                for (sum, weights) in sums.iter_mut().zip(&weights) {
                    sum[[y, x]] = weighted_sum(pattern, weights);
                }
                if let Some(pixels) = header.detector.pixels().filter(|_| self.com || self.icom) {
                    let [cx, cy] = centre_of_mass_mrad(pattern, pixels);
                    (com[0][[y, x]], com[1][[y, x]]) = (cx, cy);
                }
            }
            progress.advance(1);
        }
        progress.finish();
        let units =
            if header.counted.is_some() { "electrons" } else { "fraction of the incident beam" };
        let of_detector = |(d, data): (&VirtualDetector, Array2<f32>)| VirtualImage {
            name: d.name.clone(),
            units,
            annulus_mrad: Some(d.annulus_mrad),
            sector_degrees: d.sector_degrees,
            data,
        };
        let mut made: Vec<VirtualImage> = detectors.iter().zip(sums).map(of_detector).collect();
        let phase = match self.icom {
            true => {
                let (step, wavelength) = (header.scan.step_angstrom, header.wavelength_angstrom);
                Some(integrated_centre_of_mass([&com[0], &com[1]], step, wavelength)?)
            }
            false => None,
        };
        let plain = |name: &str, units, data| VirtualImage {
            name: name.to_owned(),
            units,
            annulus_mrad: None,
            sector_degrees: None,
            data,
        };
        if self.com {
            let [x, y] = com;
            made.extend([plain("com_x", "mrad", x), plain("com_y", "mrad", y)]);
        }
        made.extend(phase.map(|phase| plain("icom", "radians", phase)));
        Ok(made)
    }

    fn write(
        &self,
        patterns: &PatternFile,
        made: &[VirtualImage],
        (output, pictures, tiffs): (&PathBuf, &[PathBuf], &[PathBuf]),
    ) -> stemgen::Result<()> {
        let header = patterns.header();
        let stored: Vec<Array3<f32>> =
            made.iter().map(|image| image.data.clone().insert_axis(Axis(0))).collect();
        let thicknesses = [header.thickness_angstrom];
        let stack = |(image, data)| {
            let (image, data): (&VirtualImage, &Array3<f32>) = (image, data);
            ImageStack {
                name: &image.name,
                data: data.view(),
                units: image.units,
                step_angstrom: header.scan.step_angstrom,
                origin_angstrom: header.scan.origin_angstrom,
                thicknesses_angstrom: &thicknesses,
                defocus_angstrom: Some(header.defocus_angstrom),
                annulus_mrad: image.annulus_mrad,
                sector_degrees: image.sector_degrees,
                electrons_per_pixel: None,
            }
        };
        let stacks: Vec<ImageStack> = made.iter().zip(&stored).map(stack).collect();
        let origin = Origin {
            command_line: text::command_line(),
            request: None,
            structure_sha256: patterns.structure_sha256.clone(),
            settings: String::from("{}"),
            structure_file: self.file.file_name().unwrap_or_default().display().to_string(),
            wavelength_angstrom: header.wavelength_angstrom,
            band_limit_mrad: header.detector.max_angle_mrad(),
            source: None,
            accuracy: None,
            box_angstrom: [0.0; 3],
            strain_percent: None,
            sites: &[],
        };
        write_images(output, self.overwrite, &origin, &stacks, &[], None)?;
        for (path, image) in pictures.iter().zip(made) {
            image_pictures::write(path, image.data.view(), header.scan.step_angstrom, true)?;
        }
        for ((path, stack), depth) in tiffs.iter().zip(&stacks).zip(self.tiff.iter().cycle()) {
            write_tiff(path, self.overwrite, &ImageSeries::of_one(stack), (*depth).into())?;
        }
        Ok(())
    }
}

impl ImageLine {
    fn of(image: &VirtualImage) -> Self {
        let data = &image.data;
        ImageLine {
            name: image.name.clone(),
            units: image.units,
            rows: data.nrows(),
            columns: data.ncols(),
            min: data.iter().copied().fold(f32::INFINITY, f32::min),
            mean: (data.iter().map(|v| f64::from(*v)).sum::<f64>() / data.len() as f64) as f32,
            max: data.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        }
    }
}

impl IntegrateSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        for i in &self.images {
            let [min, mean, max] =
                [i.min, i.mean, i.max].map(|v| text::significant(f64::from(v), 3));
            let words = format!(
                "{}: {} x {} pixels, {min} to {max} ({}), mean {mean}",
                i.name, i.columns, i.rows, i.units
            );
            lines.add("image", words);
        }
        lines.add("file", self.output.display().to_string());
        self.pictures.iter().for_each(|p| lines.add("picture", p.display().to_string()));
        self.tiffs.iter().for_each(|p| lines.add("TIFF", p.display().to_string()));
        lines.text()
    }
}
