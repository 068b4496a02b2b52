//! Runs the simulations of `stemgen simulate`, and writes their files.

use super::accuracy_report::AccuracyReport;
use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::rerun_command::ImageDifference;
use super::simulate_command::SimulateRun;
use super::text;
use ndarray::{Array3, ArrayD, Axis};
use num_complex::Complex32;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::files::atomic_write;
use stemgen::files::outputs::work_folder;
use stemgen::files::{OutputLock, OutputSet};
use stemgen::io::{
    ExitWaves, HspyFacts, ImageCounts, ImageSeries, ImageStack, Origin, write_complex_npy,
    write_hspy, write_images, write_tiff,
};
use stemgen::render::image_pictures::{self, GreyScale};
use stemgen::simulation::SimulatedImage;

/// Files beside the file with all images.
pub struct SideFiles {
    /// Pictures: image, thickness (index), file.
    pub pictures: Vec<(String, usize, PathBuf)>,
    /// TIFF: name of a series of images, and file.
    pub tiffs: Vec<(String, PathBuf)>,
    /// File for HyperSpy.
    pub hspy: Option<PathBuf>,
    /// Exit waves of the probes.
    pub exit_waves: Option<PathBuf>,
    /// Page for the browser.
    pub page: Option<PathBuf>,
}

impl SideFiles {
    /// Returns all files.
    pub fn paths(&self) -> impl Iterator<Item = &PathBuf> {
        let pictures = self.pictures.iter().map(|(_, _, path)| path);
        let tiffs = self.tiffs.iter().map(|(_, path)| path);
        pictures.chain(tiffs).chain(&self.hspy).chain(&self.exit_waves).chain(&self.page)
    }
}

/// The grey scale of a picture.
#[derive(Serialize)]
struct PictureLine {
    file: PathBuf,
    /// The values of black and white, equal for all pictures of a series.
    grey_from_to: [f32; 2],
    /// The share of pixels in per cent whose values lie beyond black and white.
    clipped_percent: f64,
}

#[derive(Serialize)]
struct SimulateSummary {
    output: PathBuf,
    file_bytes: u64,
    pictures: Vec<PathBuf>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    grey_scales: Vec<PictureLine>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tiffs: Vec<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hspy: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exit_waves: Option<PathBuf>,
    page: Option<PathBuf>,
    images: Vec<ImageSummary>,
    /// The accuracy that was asked for and found; a list for a series.
    #[serde(skip_serializing_if = "Option::is_none")]
    accuracy: Option<serde_json::Value>,
    #[serde(skip)]
    accuracies: Vec<AccuracyReport>,
    /// The comparison with the images of an earlier file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    compared: Vec<ImageDifference>,
    wall_time_s: f64,
}

#[derive(Serialize)]
struct ImageSummary {
    name: String,
    thickness_angstrom: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    electrons: Option<u64>,
    rows: usize,
    columns: usize,
    step_angstrom: [f64; 2],
    min: f32,
    mean: f32,
    max: f32,
}

impl SimulateRun {
    /// Simulates and writes. Returns whether the images equal the images of the file that they are compared with; true without one.
    pub(super) fn execute(&self, files: &SideFiles, reporter: &Reporter) -> anyhow::Result<bool> {
        let begun = Instant::now();
        let path = self.output.clone();
        // Other processes may be writing their parts to the work folder.
        let _lock = work_folder(&path).is_dir().then(|| OutputLock::hold(&path)).transpose()?;
        let (images, waves) = self.images(reporter)?;
        let noisy: Vec<SimulatedImage> = match self.job.electrons_per_pixel() {
            Some(per_pixel) => images.iter().filter_map(|i| i.noisy(per_pixel)).collect(),
            None => Vec::new(),
        };
        let thicknesses = self.job.plans()[0].thicknesses_angstrom();
        let stack = |image| self.stack(image, &thicknesses);
        let stacks: Vec<ImageStack> = images.iter().map(stack).collect();
        let all: Vec<ImageStack> = stacks.iter().cloned().chain(noisy.iter().map(stack)).collect();
        let counted = images.iter().zip(&stacks).filter_map(|(image, stack)| {
            Some(ImageCounts {
                stack,
                data: image.counts.as_ref()?.view(),
                electrons_per_pixel: self.job.electrons_per_pixel()?,
                seed: self.job.request().specimen.seed,
            })
        });
        let counted: Vec<ImageCounts> = counted.collect();
        let step_angstrom = self.job.scan().step_angstrom;
        let waves = waves.as_ref().map(|w| ExitWaves { data: w.view(), step_angstrom });
        let wall_time_s = begun.elapsed().as_secs_f64();
        let origin = self.origin()?;
        let probe_waves =
            files.exit_waves.as_ref().map(|_| self.probe_waves(reporter)).transpose()?;
        let mut set = OutputSet::of(&path, &text::command_line(), self.results.overwrite);
        if files.paths().next().is_some() {
            set.begin()?;
        }
        write_images(&path, set.replaces(), &origin, &all, &counted, waves)?;
        let grey_scales = self.write_beside(files, &all, set.replaces())?;
        if let (Some(path), Some(waves)) = (&files.exit_waves, &probe_waves) {
            write_complex_npy(path, set.replaces(), waves.view())?;
        }
        set.finish()?;
        self.parts()?.remove()?;
        let counts = images.iter().filter_map(|image| image.counts.as_ref());
        let electrons: Vec<u64> = counts.flat_map(electrons).collect();
        let summary = SimulateSummary {
            file_bytes: super::output::size(&path),
            output: path,
            pictures: files.pictures.iter().map(|p| p.2.clone()).collect(),
            grey_scales,
            tiffs: files.tiffs.iter().map(|p| p.1.clone()).collect(),
            hspy: files.hspy.clone(),
            exit_waves: files.exit_waves.clone(),
            page: files.page.clone(),
            images: summaries(&stacks, &electrons),
            accuracy: AccuracyReport::value(&self.accuracies)?,
            accuracies: self.accuracies.clone(),
            compared: self.compared(&images)?,
            wall_time_s,
        };
        let same = summary.compared.iter().all(ImageDifference::same);
        self.common.print(&summary, &summary.text())?;
        Ok(same)
    }

    fn compared(&self, images: &[SimulatedImage]) -> stemgen::Result<Vec<ImageDifference>> {
        let stored = self.again_of.iter();
        stored.flat_map(|s| images.iter().map(|i| ImageDifference::of(i, s))).collect()
    }

    /// Simulates the images, and for a plane wave also the exit waves.
    fn images(
        &self,
        reporter: &Reporter,
    ) -> anyhow::Result<(Vec<SimulatedImage>, Option<Array3<Complex32>>)> {
        if self.job.request().plane_wave {
            let (images, waves) = self.job.plane_wave(reporter)?;
            return Ok((images, Some(waves.exit_waves)));
        }
        let parts = self.parts()?.read(reporter)?;
        Ok((self.job.run_from(&parts, reporter)?, None))
    }

    /// Makes the exit waves of all probes of the scan: (defocus, configuration, scan row, scan column, thickness, y, x).
    fn probe_waves(&self, reporter: &Reporter) -> anyhow::Result<ArrayD<Complex32>> {
        let scan = self.job.scan();
        let places: Vec<[f64; 2]> = (0..scan.len()).map(|i| scan.position(i)).collect();
        let waves = self.job.exit_waves(&places, self.force.force, reporter)?;
        let views: Vec<_> = waves.iter().map(|w| w.view()).collect();
        let all = ndarray::stack(Axis(0), &views)?;
        let [rows, columns] = scan.shape;
        let (foci, configurations, _, thicknesses, ny, nx) = all.dim();
        let shape = [foci, configurations, rows, columns, thicknesses, ny, nx];
        Ok(all.into_shape_with_order(shape.as_slice())?)
    }

    fn stack<'a>(
        &self,
        image: &'a SimulatedImage,
        thicknesses_angstrom: &'a [f64],
    ) -> ImageStack<'a> {
        let scan = self.job.scan();
        ImageStack {
            name: &image.name,
            data: image.data.view(),
            units: image.units,
            step_angstrom: scan.step_angstrom,
            origin_angstrom: scan.origin_angstrom,
            thicknesses_angstrom,
            defocus_angstrom: (self.job.plans().len() > 1).then_some(image.defocus_angstrom),
            annulus_mrad: image.annulus_mrad,
            sector_degrees: image.sector_degrees,
            electrons_per_pixel: self.job.electrons_per_pixel().filter(|_| image.noisy),
        }
    }

    fn write_beside(
        &self,
        files: &SideFiles,
        stacks: &[ImageStack],
        overwrite: bool,
    ) -> anyhow::Result<Vec<PictureLine>> {
        let series = ImageSeries::group(stacks);
        let mut pictures = Vec::new();
        for series in &series {
            let of_series = |name: &String| series.stacks.iter().find(|s| s.name == name);
            let mut own = files.pictures.iter().filter_map(|p| Some((of_series(&p.0)?, p.1, &p.2)));
            let Some(first) = own.next() else { continue };
            let scale = GreyScale {
                scale_bar: !self.results.no_scale_bar,
                grey_bar: self.results.grey_bar,
                ..GreyScale::of_series(series)?
            };
            for (stack, thickness, path) in std::iter::once(first).chain(own) {
                let image = stack.data.index_axis(Axis(0), thickness);
                atomic_write::write(path, &scale.png(image, stack.step_angstrom)?)?;
                pictures.push(PictureLine {
                    file: path.clone(),
                    grey_from_to: scale.limits.unwrap_or_default(),
                    clipped_percent: 100.0 * scale.clipped(image),
                });
            }
        }
        for ((name, path), depth) in files.tiffs.iter().zip(self.results.tiff.iter().cycle()) {
            let Some(series) = series.iter().find(|s| s.name == *name) else { continue };
            write_tiff(path, overwrite, series, (*depth).into())?;
        }
        if let Some(path) = &files.hspy {
            let facts = HspyFacts::of_simulation(&self.job, &text::command_line());
            write_hspy(path, overwrite, stacks, &facts)?;
        }
        if let Some(page) = &files.page {
            image_pictures::write_page(page, &self.structure_name(), self.facts(), stacks)?;
        }
        Ok(pictures)
    }

    /// Returns names and values for the page.
    fn facts(&self) -> Vec<(String, String)> {
        let (request, specimen) = (self.job.request(), self.job.specimen());
        let [x, y, z] = specimen.size_angstrom;
        let settings = &self.job.plans()[0].settings;
        let optics = &settings.optics;
        let detectors = request.microscope.detectors.iter();
        let detectors =
            detectors.map(|d| format!("{} {}-{} mrad", d.name, d.inner_mrad, d.outer_mrad));
        let phonons = match (settings.phonons, specimen.more_frames.len()) {
            (Some(p), _) => format!("{} configurations", p.configurations),
            (None, 0) => "none; atoms as given".to_owned(),
            (None, more) => format!("{} frames of a trajectory", more + 1),
        };
        let mut facts = vec![
            ("atoms", specimen.sites.len().to_string()),
            ("box", format!("{x:.3} \u{d7} {y:.3} \u{d7} {z:.3} \u{c5}")),
            ("beam", format!("{} keV, {} mrad", optics.energy_kev, optics.semiangle_mrad)),
            ("phonons", phonons),
            ("stemgen", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        if !request.plane_wave {
            facts.insert(3, ("detectors", detectors.collect::<Vec<_>>().join(", ")));
        }
        let source = request.microscope.source_size_angstrom;
        facts.extend(source.map(|s| ("source", format!("{s} \u{c5} (FWHM)"))));
        if optics.tilt_mrad != [0.0; 2] {
            let [x, y] = optics.tilt_mrad;
            facts.push(("mistilt", format!("{x}, {y} mrad")));
        }
        if optics.focal_spread_angstrom > 0.0 {
            facts.push(("focal spread", format!("{} \u{c5}", optics.focal_spread_angstrom)));
        }
        let dose = request.electrons_per_angstrom2;
        facts.extend(dose.map(|d| ("dose", format!("{d} electrons per \u{c5}\u{b2}"))));
        facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }

    fn origin(&self) -> anyhow::Result<Origin<'_>> {
        let accuracy = AccuracyReport::json_of(&self.accuracies)?;
        Ok(Origin { accuracy, ..Origin::of_simulation(&self.job, &text::command_line())? })
    }
}

/// Returns the electrons counted at each thickness.
fn electrons(counts: &Array3<u32>) -> Vec<u64> {
    counts.outer_iter().map(|c| c.iter().map(|n| u64::from(*n)).sum()).collect()
}

fn summaries(stacks: &[ImageStack], electrons: &[u64]) -> Vec<ImageSummary> {
    let images = stacks.iter().flat_map(|s| {
        s.data.outer_iter().zip(s.thicknesses_angstrom).map(move |(image, t)| (s, image, *t))
    });
    let each = |(n, (stack, image, thickness_angstrom)): (
        usize,
        (&ImageStack, ndarray::ArrayView2<f32>, f64),
    )| {
        ImageSummary {
            name: stack.name.to_owned(),
            thickness_angstrom,
            electrons: electrons.get(n).copied(),
            rows: image.nrows(),
            columns: image.ncols(),
            step_angstrom: stack.step_angstrom,
            min: image.iter().copied().fold(f32::INFINITY, f32::min),
            mean: (image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64) as f32,
            max: image.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        }
    };
    images.enumerate().map(each).collect()
}

impl PictureLine {
    fn text(&self) -> String {
        let [from, to] = self.grey_from_to.map(|v| text::significant(f64::from(v), 3));
        let clipped = match self.clipped_percent {
            0.0 => "no pixel is clipped".to_owned(),
            percent => format!("{} % of its pixels are clipped", text::significant(percent, 2)),
        };
        format!("{}: grey from {from} to {to}; {clipped}", self.file.display())
    }
}

impl SimulateSummary {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        for i in &self.images {
            let [min, mean, max] =
                [i.min, i.mean, i.max].map(|v| text::significant(f64::from(v), 3));
            let [x, y] = i.step_angstrom;
            let counted = i.electrons.map(|n| format!(", {} electrons counted", text::count(n)));
            lines.add(
                "image",
                format!(
                    "{} at {:.2} A: {} x {} pixels of {x:.4} x {y:.4} A, {min} to {max}, mean {mean}{}",
                    i.name,
                    i.thickness_angstrom,
                    i.columns,
                    i.rows,
                    counted.unwrap_or_default()
                ),
            );
        }
        self.accuracies.iter().for_each(|a| a.line(&mut lines));
        self.compared.iter().for_each(|difference| lines.add("compared", difference.text()));
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        self.grey_scales.iter().for_each(|p| lines.add("picture", p.text()));
        self.tiffs.iter().for_each(|p| lines.add("TIFF", p.display().to_string()));
        self.hspy.iter().for_each(|p| lines.add("HyperSpy", p.display().to_string()));
        self.exit_waves.iter().for_each(|p| lines.add("exit waves", p.display().to_string()));
        self.page.iter().for_each(|p| lines.add("page", p.display().to_string()));
        lines.text()
    }
}
