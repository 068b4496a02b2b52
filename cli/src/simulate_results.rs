//! What `stemgen simulate` makes and writes.

use super::accuracy_report::AccuracyReport;
use super::plan_report::Lines;
use super::plane_wave::{self, Conventional};
use super::progress_bar::Reporter;
use super::simulate_command::{PlannedSeries, Simulate};
use super::structure_args::Prepared;
use super::{output, pictures, text};
use anyhow::bail;
use ndarray::{Array3, Axis};
use num_complex::Complex32;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use stemgen::engine::{Scan, SourceBlur, simulate_series_from};
use stemgen::files::{OutputLock, OutputSet};
use stemgen::io::hspy_file::write_hspy;
use stemgen::io::image_file::{ExitWaves, ImageCounts, ImageStack, Origin, write_images};
use stemgen::io::tiff_file::write_tiff;
use stemgen::world::{MOST_ELECTRONS_PER_PIXEL, Noise, work_folder};

/// What images of scans are measured in.
const FRACTION: &str = "fraction of the incident beam";

/// An image of one detector and defocus.
struct MadeImage {
    name: String,
    /// (thickness, y, x)
    data: Array3<f32>,
    units: &'static str,
    defocus_angstrom: Option<f64>,
    annulus_mrad: Option<[f64; 2]>,
}

/// Files that go beside the one with all images.
pub struct SideFiles {
    /// Pictures: image, thickness (index), file.
    pub pictures: Vec<(String, usize, PathBuf)>,
    /// TIFF: image and file.
    pub tiffs: Vec<(String, PathBuf)>,
    /// For HyperSpy.
    pub hspy: Option<PathBuf>,
    /// A page for the browser.
    pub page: Option<PathBuf>,
}

impl SideFiles {
    /// All of them.
    pub fn paths(&self) -> impl Iterator<Item = &PathBuf> {
        let pictures = self.pictures.iter().map(|(_, _, path)| path);
        let tiffs = self.tiffs.iter().map(|(_, path)| path);
        pictures.chain(tiffs).chain(&self.hspy).chain(&self.page)
    }
}

#[derive(Serialize)]
struct SimulateSummary {
    output: PathBuf,
    file_bytes: u64,
    pictures: Vec<PathBuf>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tiffs: Vec<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hspy: Option<PathBuf>,
    page: Option<PathBuf>,
    images: Vec<ImageSummary>,
    /// What was asked and found; a list for a series.
    #[serde(skip_serializing_if = "Option::is_none")]
    accuracy: Option<serde_json::Value>,
    #[serde(skip)]
    accuracies: Vec<AccuracyReport>,
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

impl Simulate {
    /// Names of the images: those without noise, then with.
    pub(super) fn image_names(&self, planned: &PlannedSeries) -> Vec<String> {
        let mut names = Vec::new();
        for plan in &planned.plans {
            let defocus = self.series_defocus(planned, plan);
            let detectors = plan.settings.detectors.iter().map(|d| d.name.as_str());
            let detectors: Vec<&str> =
                if self.results.plane_wave { vec!["lens"] } else { detectors.collect() };
            names.extend(detectors.into_iter().map(|d| name_of(d, defocus)));
        }
        let noisy = names.iter().filter(|_| self.results.dose.is_some());
        let noisy: Vec<String> = noisy.map(|n| noisy_name(n)).collect();
        names.into_iter().chain(noisy).collect()
    }

    /// Simulates and writes.
    pub(super) fn execute(
        &self,
        planned: &PlannedSeries,
        specimen: &Prepared,
        scan: &Scan,
        files: &SideFiles,
        reporter: &Reporter,
    ) -> anyhow::Result<()> {
        let begun = Instant::now();
        let path = self.output();
        // Others may be about to write their parts.
        let _lock = work_folder(&path).is_dir().then(|| OutputLock::hold(&path)).transpose()?;
        let (images, waves) = match self.results.plane_wave {
            true => self.conventional(planned, specimen, reporter)?,
            false => (self.scanned(planned, specimen, scan, reporter)?, None),
        };
        let thicknesses = planned.plans[0].thicknesses_angstrom();
        let stacks: Vec<ImageStack> = images.iter().map(|i| i.stack(scan, &thicknesses)).collect();
        let noise = self.noise(scan);
        let counts: Vec<Array3<u32>> = match &noise {
            Some(noise) => images.iter().enumerate().map(|(n, i)| counted(noise, n, i)).collect(),
            None => Vec::new(),
        };
        let noisy: Vec<MadeImage> = match &noise {
            Some(noise) => images.iter().zip(&counts).map(|(i, c)| i.noisy(c, noise)).collect(),
            None => Vec::new(),
        };
        let all: Vec<ImageStack> = stacks
            .iter()
            .cloned()
            .chain(noisy.iter().map(|i| i.stack(scan, &thicknesses)))
            .collect();
        let counted = stacks.iter().zip(&counts);
        let counted = noise.iter().flat_map(|noise| {
            counted.clone().map(|(stack, data)| ImageCounts {
                stack,
                data: data.view(),
                electrons_per_pixel: noise.electrons_per_pixel,
                seed: noise.seed,
            })
        });
        let counted: Vec<ImageCounts> = counted.collect();
        let waves = waves.as_ref();
        let waves = waves.map(|w| ExitWaves { data: w.view(), step_angstrom: scan.step_angstrom });
        let wall_time_s = begun.elapsed().as_secs_f64();
        let origin = self.origin(planned, specimen)?;
        let mut set = OutputSet::of(&path, &text::command_line(), self.results.overwrite);
        if files.paths().next().is_some() {
            set.begin()?;
        }
        write_images(&path, set.replaces(), &origin, &all, &counted, waves)?;
        self.write_beside(planned, specimen, files, &all, set.replaces())?;
        set.finish()?;
        Self::parts(planned, specimen, scan, &path).remove()?;
        let electrons: Vec<u64> = counts.iter().flat_map(electrons).collect();
        let summary = SimulateSummary {
            file_bytes: output::size(&path),
            output: path,
            pictures: files.pictures.iter().map(|p| p.2.clone()).collect(),
            tiffs: files.tiffs.iter().map(|p| p.1.clone()).collect(),
            hspy: files.hspy.clone(),
            page: files.page.clone(),
            images: summaries(&stacks, &electrons),
            accuracy: AccuracyReport::value(&planned.accuracies)?,
            accuracies: planned.accuracies.clone(),
            wall_time_s,
        };
        self.common.print(&summary, &summary.text())
    }

    fn scanned(
        &self,
        planned: &PlannedSeries,
        specimen: &Prepared,
        scan: &Scan,
        reporter: &Reporter,
    ) -> anyhow::Result<Vec<MadeImage>> {
        let [x, y, _] = specimen.size;
        let blur = self.source_blur(scan, [x, y])?;
        let wide = blur.as_ref().map_or(scan, |b| b.scan());
        let output = self.output();
        let shared = Self::parts(planned, specimen, wide, &output);
        let parts = shared.read(reporter)?;
        let (plans, frames) = (shared.plans, &shared.frames);
        let series = simulate_series_from(plans, frames, wide, &parts, reporter)?;
        let mut made = Vec::new();
        for (plan, images) in planned.plans.iter().zip(&series) {
            for (i, detector) in plan.settings.detectors.iter().enumerate() {
                let sharp = images.data.index_axis(Axis(1), i);
                let data = match &blur {
                    None => sharp.to_owned(),
                    Some(blur) => {
                        let blurred: Vec<_> = sharp.outer_iter().map(|s| blur.image(s)).collect();
                        let views: Vec<_> = blurred.iter().map(|b| b.view()).collect();
                        ndarray::stack(Axis(0), &views)?
                    }
                };
                let defocus_angstrom = self.series_defocus(planned, plan);
                made.push(MadeImage {
                    name: name_of(&detector.name, defocus_angstrom),
                    data,
                    units: FRACTION,
                    defocus_angstrom,
                    annulus_mrad: Some([detector.inner_mrad, detector.outer_mrad]),
                });
            }
        }
        Ok(made)
    }

    fn conventional(
        &self,
        planned: &PlannedSeries,
        specimen: &Prepared,
        reporter: &Reporter,
    ) -> anyhow::Result<(Vec<MadeImage>, Option<Array3<Complex32>>)> {
        let plans = &planned.plans;
        let lenses: Vec<_> = plans.iter().map(|p| p.settings.optics.clone()).collect();
        let Conventional { exit_waves, images } =
            plane_wave::run(&plans[0], &lenses, specimen, reporter)?;
        let made = images.into_iter().zip(plans).map(|(data, plan)| {
            let defocus_angstrom = self.series_defocus(planned, plan);
            MadeImage {
                name: name_of("lens", defocus_angstrom),
                data,
                units: "intensity; that of the incident wave is 1",
                defocus_angstrom,
                annulus_mrad: None,
            }
        });
        Ok((made.collect(), Some(exit_waves)))
    }

    /// Refuses a dose whose electrons cannot be counted, and names of images that those of noisy images repeat.
    pub(super) fn check_noise(&self, planned: &PlannedSeries, scan: &Scan) -> anyhow::Result<()> {
        let Some(noise) = self.noise(scan) else { return Ok(()) };
        if noise.electrons_per_pixel > MOST_ELECTRONS_PER_PIXEL {
            let [x, y] = scan.step_angstrom;
            bail!(
                "--dose {:e}: {:.3e} electrons on a pixel of {x:.3} x {y:.3} A are more than can be counted; write at most {:.2e}",
                noise.electrons_per_pixel / (x * y),
                noise.electrons_per_pixel,
                MOST_ELECTRONS_PER_PIXEL / (x * y)
            );
        }
        let names = self.image_names(planned);
        let twice = names.iter().enumerate().find(|(n, name)| names[..*n].contains(name));
        match twice {
            Some((_, name)) => bail!(
                "--detector: the noisy image of one would have the name of another, {name}; give it another name"
            ),
            None => Ok(()),
        }
    }

    fn noise(&self, scan: &Scan) -> Option<Noise> {
        let [x, y] = scan.step_angstrom;
        Some(Noise {
            seed: self.specimen.options.seed,
            electrons_per_pixel: self.results.dose? * x * y,
            origin_px: [0, 0],
            full_width_px: scan.shape[1],
            detector: 0,
        })
    }

    fn write_beside(
        &self,
        planned: &PlannedSeries,
        specimen: &Prepared,
        files: &SideFiles,
        stacks: &[ImageStack],
        overwrite: bool,
    ) -> anyhow::Result<()> {
        let named = |name: &str| stacks.iter().find(|s| s.name == name);
        for (name, thickness, path) in &files.pictures {
            let Some(stack) = named(name) else { continue };
            let image = stack.data.index_axis(Axis(0), *thickness);
            pictures::write(path, image, stack.step_angstrom, !self.results.no_scale_bar)?;
        }
        for ((name, path), depth) in files.tiffs.iter().zip(self.results.tiff.iter().cycle()) {
            let Some(stack) = named(name) else { continue };
            write_tiff(path, overwrite, stack, (*depth).into())?;
        }
        if let Some(path) = &files.hspy {
            write_hspy(path, overwrite, stacks)?;
        }
        if let Some(page) = &files.page {
            let facts = self.facts(planned, specimen);
            pictures::write_page(page, &self.specimen.file_name(), facts, stacks)?;
        }
        Ok(())
    }

    /// What the page says about the images.
    fn facts(&self, planned: &PlannedSeries, specimen: &Prepared) -> Vec<(String, String)> {
        let [x, y, z] = specimen.size;
        let settings = &planned.plans[0].settings;
        let optics = &settings.optics;
        let detectors = settings.detectors.iter();
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
            ("beam", format!("{} keV, {} mrad", 1e-3 * optics.energy_ev, optics.semiangle_mrad)),
            ("phonons", phonons),
            ("stemgen", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        if !self.results.plane_wave {
            facts.insert(3, ("detectors", detectors.collect::<Vec<_>>().join(", ")));
        }
        let source = self.microscope.source_size;
        facts.extend(source.map(|s| ("source", format!("{s} \u{c5} (FWHM)"))));
        if optics.mistilt_mrad != [0.0; 2] {
            let [x, y] = optics.mistilt_mrad;
            facts.push(("mistilt", format!("{x}, {y} mrad")));
        }
        if optics.focal_spread_angstrom > 0.0 {
            facts.push(("focal spread", format!("{} \u{c5}", optics.focal_spread_angstrom)));
        }
        let dose = self.results.dose;
        facts.extend(dose.map(|d| ("dose", format!("{d} electrons per \u{c5}\u{b2}"))));
        facts.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }

    fn origin<'a>(
        &self,
        planned: &PlannedSeries,
        specimen: &'a Prepared,
    ) -> anyhow::Result<Origin<'a>> {
        let plan = &planned.plans[0];
        Ok(Origin {
            command_line: text::command_line(),
            settings: serde_json::to_string(&plan.settings)?,
            structure_file: self.specimen.file_name(),
            wavelength_angstrom: plan.settings.optics.wavelength_angstrom(),
            band_limit_mrad: plan.band_limit_mrad,
            source: self.microscope.source(),
            accuracy: AccuracyReport::json_of(&planned.accuracies)?,
            box_angstrom: specimen.size,
            strain_percent: specimen.strain_percent,
            sites: &specimen.sites,
        })
    }

    /// The scan with the margin that the source takes; nothing for a point source.
    pub(super) fn source_blur(
        &self,
        scan: &Scan,
        cell: [f64; 2],
    ) -> anyhow::Result<Option<SourceBlur>> {
        let source = self.microscope.source();
        Ok(source.map(|source| SourceBlur::new(source, scan, cell)).transpose()?)
    }
}

impl MadeImage {
    fn stack<'a>(&'a self, scan: &Scan, thicknesses_angstrom: &'a [f64]) -> ImageStack<'a> {
        ImageStack {
            name: &self.name,
            data: self.data.view(),
            units: self.units,
            step_angstrom: scan.step_angstrom,
            origin_angstrom: scan.origin_angstrom,
            thicknesses_angstrom,
            defocus_angstrom: self.defocus_angstrom,
            annulus_mrad: self.annulus_mrad,
        }
    }

    /// What the counts say of the image: over the electrons of a pixel.
    fn noisy(&self, counts: &Array3<u32>, noise: &Noise) -> MadeImage {
        let share = |n: &u32| (f64::from(*n) / noise.electrons_per_pixel) as f32;
        MadeImage { name: noisy_name(&self.name), data: counts.map(share), ..*self }
    }
}

fn name_of(detector: &str, defocus: Option<f64>) -> String {
    defocus.map_or(detector.to_owned(), |d| format!("{detector}_defocus_{d}A"))
}

fn noisy_name(name: &str) -> String {
    format!("{name}_noisy")
}

/// The electrons counted in image number `n`; each image and thickness has draws of its own.
fn counted(noise: &Noise, n: usize, image: &MadeImage) -> Array3<u32> {
    let (thicknesses, rows, columns) = image.data.dim();
    let mut counts = Array3::zeros((thicknesses, rows, columns));
    for (t, sharp) in image.data.outer_iter().enumerate() {
        let own = Noise { origin_px: [(n * thicknesses + t) * rows, 0], ..*noise };
        counts.index_axis_mut(Axis(0), t).assign(&own.counted(&sharp.to_owned()));
    }
    counts
}

/// Electrons counted at each thickness.
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
        lines.add("time", text::duration(self.wall_time_s));
        let size = text::bytes(self.file_bytes);
        lines.add("file", format!("{} ({size})", self.output.display()));
        self.pictures.iter().for_each(|p| lines.add("picture", p.display().to_string()));
        self.tiffs.iter().for_each(|p| lines.add("TIFF", p.display().to_string()));
        self.hspy.iter().for_each(|p| lines.add("HyperSpy", p.display().to_string()));
        self.page.iter().for_each(|p| lines.add("page", p.display().to_string()));
        lines.text()
    }
}
