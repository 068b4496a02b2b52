//! A recording of a part of a field, with its ground truth.

use ndarray::{Array2, Array3};

use super::contamination::{CarbonBefore, GrowingCarbon, check_thickness, grown};
use super::detector_recorder::{DetectorRecorder, numbers_of};
use super::kept_frames::KeptFrames;
use super::noise_free::NoiseFree;
use super::recorded_detectors::{RecordedDetector, check_carbon, recorded_detectors};
use super::region_truth::{ColumnTruth, SiteTruth, list};
use crate::acquisition::{
    Acquisition, Exposure, Recorder, ScanFrame, ScanPath, SourceImage, clipping_warning,
};
use crate::detect::Detector;
use crate::engine::check_memory;
use crate::error::{Error, Result};
use crate::imaging::GrownCarbon;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Recipe, Region};
use crate::resample::MARGIN;
use crate::setting::{Fault, Setting};
use crate::specimen::{DoseMap, Specimen};

/// Number of rows that are recorded at a time.
const ROWS_AT_ONCE: usize = 256;
/// Largest number of pixels in one frame.
const MOST_PIXELS: f64 = 1e9;
/// Allowed edges of recorded pixels in nm.
const PIXEL_NM: std::ops::RangeInclusive<f64> = 1e-4..=10.0;
/// Bytes of memory for each pixel of the field while it is read or simulated.
const SOURCE_BYTES: u64 = 16;

/// The part of a field that is recorded. Places are (x, y) in nm from the centre of the first built pixel of the field, as in world files.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedPart {
    /// Middle of the part (x, y).
    pub centre_nm: [f64; 2],
    /// Width and height.
    pub size_nm: [f64; 2],
    /// Edge of a pixel.
    pub pixel_nm: f64,
}

impl RecordedPart {
    /// Number of pixels [rows, columns] with an edge of `pixel_nm` nm that cover the part.
    pub fn pixels_of(&self, pixel_nm: f64) -> [usize; 2] {
        let [width, height] = self.size_nm;
        [height, width].map(|edge| (edge / pixel_nm).round().max(1.0) as usize)
    }

    /// Returns a part with as many pixels as a tile of the recipe, of edge `pixel_nm`, about `at_nm` or else the middle of the field.
    /// Without a place the part stays clear of the margins of the field, where nothing can be recorded.
    pub(crate) fn tile_at(recipe: &Recipe, at_nm: Option<[f64; 2]>, pixel_nm: f64) -> Self {
        let (field, own) = (&recipe.field, recipe.field.pixel_nm());
        let size_nm = field.tile_px as f64 * pixel_nm;
        if let Some(centre_nm) = at_nm {
            return RecordedPart { centre_nm, size_nm: [size_nm; 2], pixel_nm };
        }
        let [rows, columns] = field.pixels(field.built_grid());
        let centre_nm = [columns, rows].map(|n| 0.5 * (n as f64 - 1.0) * own);
        let within = |n: usize| n.saturating_sub(2 * (MARGIN + 1)) as f64 * own;
        RecordedPart {
            centre_nm,
            size_nm: [columns, rows].map(|n| size_nm.min(within(n))),
            pixel_nm,
        }
    }

    /// Returns the pixels of a scan of this part in nm of the full field, whose first built pixel is at `origin_nm`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for pixels or sizes out of limits, and for a centre that is not finite.
    fn frame(&self, origin_nm: [f64; 2]) -> Result<ScanFrame> {
        if !PIXEL_NM.contains(&self.pixel_nm) {
            let expected = "expected 0.0001 to 10 nm";
            return Err(Error::invalid(Setting::RecordedPixelNm, self.pixel_nm, expected));
        }
        let [columns, rows] = self.size_nm.map(|nm| (nm / self.pixel_nm).round());
        let whole = columns >= 1.0 && rows >= 1.0 && columns * rows <= MOST_PIXELS;
        if !whole || !self.centre_nm.iter().all(|c| c.is_finite()) {
            let expected = format!(
                "expected a finite place, and sizes of at least a pixel of {:.4} nm and at most 1e9 pixels",
                self.pixel_nm
            );
            let [width, height] = self.size_nm;
            let value = format!("{width} x {height} nm about {:?}", self.centre_nm);
            return Err(Error::invalid(Setting::RecordedRegionNm, value, expected));
        }
        let first =
            |k: usize, n: f64| origin_nm[k] + self.centre_nm[k] - 0.5 * (n - 1.0) * self.pixel_nm;
        Ok(ScanFrame {
            shape: [rows as usize, columns as usize],
            pixel_nm: self.pixel_nm,
            origin_nm: [first(0, columns), first(1, rows)],
        })
    }
}

/// The dose of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Electrons {
    /// Electrons per square Angstrom, all frames together.
    Dose(f64),
    /// Current of the beam in pA; the dose follows from the dwell time.
    CurrentPa(f64),
}

/// The settings of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordingOptions {
    /// The scan and the detector.
    pub acquisition: Acquisition,
    /// The dose.
    pub electrons: Electrons,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Keep each frame; otherwise the frames are summed.
    pub keep_frames: bool,
    /// Keep the stages between the noise-free image and the recording.
    pub keep_stages: bool,
}

/// The stages between the noise-free image and the recording: arrays of [frame, row, column].
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingStages {
    /// The noise-free image at the places where the beam was, as fraction of the beam.
    pub moved: Array3<f32>,
    /// Electrons that hit the detector.
    pub electrons: Array3<f32>,
}

/// A recording. Positions of sites and columns are (x, y) in nm from the centre of its first pixel.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FieldRecording {
    /// The pixels of the intended scan, in nm from the centre of the first built pixel of the field.
    pub frame: ScanFrame,
    /// The settings of the recording, on the first detector.
    pub options: RecordingOptions,
    /// Electrons, time and frames.
    pub exposure: Exposure,
    /// The first detector, on which `data`, `ideal`, `stages` and `clipped` were recorded.
    pub detector: Detector,
    /// The recorded values, as the file of a microscope would hold them: [frame, row, column]; one frame if the frames are summed. A centre
    /// of mass is in mrad; of several frames it is that of all their electrons.
    pub data: Array3<f64>,
    /// The noise-free image at the pixels of the intended scan, [row, column], as fraction of the beam, with the carbon that was on the
    /// specimen when the recording began.
    pub ideal: Array2<f32>,
    /// The stages between `ideal` and `data`, if they are kept.
    pub stages: Option<RecordingStages>,
    /// The images of the same electrons on the other detectors, in the order of the recipe.
    pub others: Vec<DetectorRecording>,
    /// For each line of each frame: its time in s, and the drift (x, y) of the specimen in nm.
    pub drift: Vec<[f64; 3]>,
    /// Sites of the columns in the part.
    pub sites: Vec<SiteTruth>,
    /// Columns whose position lies in the part.
    pub columns: Vec<ColumnTruth>,
    /// Where columns appear, in pixels (x, y) from the centre of the first: [frame, column, 2]; one entry, the mean of all frames, if the
    /// frames are summed.
    pub position_in_image: Array3<f64>,
    /// Mean thickness in nm of the carbon on the part at the beginning of each frame; empty if there is none and none grows.
    pub carbon_nm: Vec<f64>,
    /// Number of pixels in all frames that the converter clipped.
    pub clipped: u64,
}

impl FieldRecording {
    /// The recorded values on each detector, the first one first.
    pub fn images(&self) -> impl Iterator<Item = (&Detector, &Array3<f64>)> {
        let others = self.others.iter().map(|one| (&one.detector, &one.data));
        std::iter::once((&self.detector, &self.data)).chain(others)
    }

    /// Warnings of pixels that the converters clipped.
    pub fn clipping_warnings(&self) -> Vec<String> {
        self.warnings_of(
            1,
            std::iter::once(self.clipped).chain(self.others.iter().map(|one| one.clipped)),
        )
    }

    /// Warnings of pixels that the converters clipped in a number of recordings like this; `clipped` is their number on each detector.
    pub(crate) fn warnings_of(
        &self,
        recordings: usize,
        clipped: impl Iterator<Item = u64>,
    ) -> Vec<String> {
        let [rows, columns] = self.frame.shape;
        let pixels = recordings * rows * columns * self.exposure.frames;
        let others = self.others.iter().map(|one| (&one.detector, &one.acquisition));
        let all = std::iter::once((&self.detector, &self.options.acquisition)).chain(others);
        let warning = |((detector, acquisition), clipped): ((&Detector, &Acquisition), u64)| {
            let warning = clipping_warning(clipped, pixels, acquisition.bits)?;
            let several = !self.others.is_empty();
            Some(if several { format!("{}: {warning}", detector.name) } else { warning })
        };
        all.zip(clipped).filter_map(warning).collect()
    }
}

/// The images of a recording on another detector than the first. Arrays are as in [`FieldRecording`]; a centre of mass is in mrad.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DetectorRecording {
    /// The detector.
    pub detector: Detector,
    /// The settings of the recording on this detector.
    pub acquisition: Acquisition,
    /// The recorded values.
    pub data: Array3<f64>,
    /// The noise-free image.
    pub ideal: Array2<f32>,
    /// The stages between `ideal` and `data`, if they are kept.
    pub stages: Option<RecordingStages>,
    /// Number of pixels in all frames that the converter clipped.
    pub clipped: u64,
}

/// A field that is recorded.
pub(crate) struct RecordedField<'a> {
    pub recipe: &'a CheckedRecipe,
    pub specimen: &'a dyn Specimen,
    pub source: &'a dyn NoiseFree,
    /// The detectors that record, at least one.
    pub detectors: &'a [RecordedDetector],
    /// The carbon on the specimen; with `None` no carbon is there and none grows.
    pub carbon: Option<CarbonBefore<'a>>,
}

impl RecordedField<'_> {
    /// Records a part of the field, on which no carbon has grown yet.
    ///
    /// # Errors
    /// As [`record`]; [`Error::Invalid`] for carbon that grows on several detectors.
    pub(super) fn record_clean(
        &self,
        part: &RecordedPart,
        options: &RecordingOptions,
        progress: &dyn Progress,
    ) -> Result<FieldRecording> {
        let none = DoseMap::default();
        if options.acquisition.contamination_angstrom3_per_electron <= 0.0 {
            return record_over(self, part, options, progress);
        }
        check_carbon(self.detectors, self.recipe)?;
        let film = GrownCarbon::on(self.recipe, self.specimen.facts().thickness_nm)?;
        let carbon = Some(CarbonBefore { film: &film, angstrom: &none });
        record_over(&RecordedField { carbon, ..*self }, part, options, progress)
    }
}

/// Records a part of the field of a recipe on all its detectors. No carbon has grown on it yet.
///
/// # Errors
/// [`Error::Invalid`] for a part whose scan leaves the field, or values out of limits; [`Error::Memory`]; errors of the source, and
/// [`Error::Interrupted`].
pub fn record(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    source: &dyn NoiseFree,
    part: &RecordedPart,
    options: &RecordingOptions,
    progress: &dyn Progress,
) -> Result<FieldRecording> {
    let detectors = &recorded_detectors(recipe, None)?[..];
    let field = RecordedField { recipe, specimen, source, detectors, carbon: None };
    field.record_clean(part, options, progress)
}

/// Records a part of a field, with the carbon on it. All detectors record the same electrons on the same path.
///
/// # Errors
/// As [`record`]; [`Error::Invalid`] for carbon that would become too thick.
pub(crate) fn record_over(
    field: &RecordedField,
    part: &RecordedPart,
    options: &RecordingOptions,
    progress: &dyn Progress,
) -> Result<FieldRecording> {
    let RecordedField { recipe, specimen, source, detectors, carbon } = field;
    let origin = recipe.field.origin_nm();
    let frame = part.frame(origin)?;
    let recorder = recorder(&frame, options)?;
    let rate = options.acquisition.contamination_angstrom3_per_electron;
    if let Some(before) = carbon {
        let more = grown(recorder.path(), recorder.exposure(), rate);
        check_thickness(before.angstrom, &more, rate)?;
    }
    let region = region_of(&frame).grown(-0.5 * frame.pixel_nm);
    let meant = [region.x, region.y];
    let reach = recorder.path().reach_nm(0..frame.shape[0]);
    let reach = plane::per_axis(reach, meant, |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    let numbers = numbers_of(detectors);
    check_size(&frame, reach, recipe.field.pixel_nm(), options, [detectors.len(), numbers.len()])?;
    let mut images = source.images(reach, &numbers, progress)?;
    let recorders: Vec<DetectorRecorder> = detectors
        .iter()
        .map(|one| DetectorRecorder::new(one, &recorder, options, &numbers))
        .collect();
    let carbon = carbon.map(|before| GrowingCarbon::new(&before, &images[0], rate)).transpose()?;
    let begun = carbon.as_ref().map(|carbon| vec![carbon.over(&images[0])]);
    let seen = begun.as_ref().unwrap_or(&images);
    let ideal: Vec<Array2<f32>> = recorders.iter().map(|one| one.meant(&frame, seen)).collect();
    let scanned = (&recorder, &recorders[..]);
    let (kept, carbon_nm) = all_frames(scanned, options, (&mut images, carbon), progress)?;
    let path = recorder.path();
    let (sites, columns) = list(&specimen.query(&region_of(&frame)), frame.origin_nm, 0);
    let position_in_image = appearances(path, &columns, options);
    let drift = path.drift_curve();
    let images = recorders.iter().zip(kept).zip(ideal);
    let mut images = images.map(|((one, kept), ideal)| one.recording(kept, ideal));
    let Some(first) = images.next() else {
        return Err(Error::invalid(Setting::DetectorName, "none", "expected one at least"));
    };
    Ok(FieldRecording {
        frame: ScanFrame { origin_nm: plane::sub(frame.origin_nm, origin), ..frame },
        options: RecordingOptions { acquisition: first.acquisition, ..*options },
        exposure: *recorder.exposure(),
        detector: first.detector,
        data: first.data,
        ideal: first.ideal,
        stages: first.stages,
        others: images.collect(),
        drift,
        sites,
        columns,
        position_in_image,
        carbon_nm,
        clipped: first.clipped,
    })
}

/// Records all frames of the images of all detectors. On the first carbon may grow; also returns the mean thickness in nm of the carbon at
/// the beginning of each frame.
fn all_frames(
    (recorder, detectors): (&Recorder, &[DetectorRecorder]),
    options: &RecordingOptions,
    (images, mut carbon): (&mut [SourceImage], Option<GrowingCarbon>),
    progress: &dyn Progress,
) -> Result<(Vec<KeptFrames>, Vec<f64>)> {
    let frame = *recorder.path().frame();
    let mut kept: Vec<KeptFrames> =
        detectors.iter().map(|one| KeptFrames::new(&frame, options, one.is_deflection())).collect();
    let bare = images.first().filter(|_| carbon.is_some()).cloned();
    let mut carbon_nm = Vec::new();
    let (frames, rows) = (options.acquisition.frames, frame.shape[0]);
    progress.start("recording", "line", (frames * rows) as u64);
    for number in 0..frames {
        if let (Some(carbon), Some(bare)) = (&carbon, &bare) {
            images[0] = carbon.over(bare);
            carbon_nm.push(carbon.mean_nm(&region_of(&frame)));
        }
        let mut late = vec![0.0; detectors.len()];
        for first in (0..rows).step_by(ROWS_AT_ONCE) {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let rows = first..(first + ROWS_AT_ONCE).min(rows);
            for ((one, kept), late) in detectors.iter().zip(&mut kept).zip(&mut late) {
                kept.add(number, first, &one.rows(number, rows.clone(), images, late));
            }
            progress.advance(rows.len() as u64);
        }
        if let Some(carbon) = carbon.as_mut().filter(|_| number + 1 < frames) {
            carbon.after_frame(recorder.path(), recorder.exposure(), number)?;
        }
    }
    progress.finish();
    Ok((kept.into_iter().map(KeptFrames::finished).collect(), carbon_nm))
}

/// Returns the path and the exposure of a scan of a part of the field, in nm of the full field.
///
/// # Errors
/// [`Error::Invalid`] for a part or values out of limits.
pub(crate) fn scan_of(
    recipe: &CheckedRecipe,
    part: &RecordedPart,
    options: &RecordingOptions,
) -> Result<(ScanPath, Exposure)> {
    let recorder = recorder(&part.frame(recipe.field.origin_nm())?, options)?;
    Ok((recorder.path().clone(), *recorder.exposure()))
}

/// The recorder of a frame.
fn recorder(frame: &ScanFrame, options: &RecordingOptions) -> Result<Recorder> {
    let acquisition = &options.acquisition;
    acquisition.check().map_err(|Fault { key, value, expected }| {
        Error::invalid(Setting::Acquisition, format!("{key} = {value}"), expected)
    })?;
    let (dwell, frames, pixel) = (acquisition.dwell_us, acquisition.frames, frame.pixel_angstrom());
    let exposure = match options.electrons {
        Electrons::Dose(dose) => Exposure::of_dose(dose, dwell, frames, pixel)?,
        Electrons::CurrentPa(current) => Exposure::of_current(current, dwell, frames, pixel)?,
    };
    let path = ScanPath::new(acquisition, *frame, options.seed);
    Ok(Recorder::new(acquisition, path, exposure, options.seed))
}

fn check_size(
    frame: &ScanFrame,
    reach: [[f64; 2]; 2],
    source_pixel_nm: f64,
    options: &RecordingOptions,
    [detectors, measured]: [usize; 2],
) -> Result<()> {
    let pixels = (frame.shape[0] * frame.shape[1]) as u64;
    let frames = options.acquisition.frames as u64;
    let kept = if options.keep_frames { frames } else { 1 };
    let stages = if options.keep_stages { frames } else { 0 };
    let source: f64 =
        reach.iter().map(|[low, high]| (high - low) / source_pixel_nm + 20.0).product();
    let bytes = pixels * (8 * kept + 8 * stages + 8) * detectors as u64
        + source as u64 * SOURCE_BYTES * measured as u64;
    check_memory(bytes, "record a smaller part, or fewer frames")
}

/// Returns the area that the pixels of a scan are meant to cover.
pub fn region_of(frame: &ScanFrame) -> Region {
    let edges = |k: usize| {
        let first = frame.origin_nm[k] - 0.5 * frame.pixel_nm;
        [first, first + frame.shape[1 - k] as f64 * frame.pixel_nm]
    };
    Region { x: edges(0), y: edges(1) }
}

/// Computes where the columns appear: [frame, column, 2]; one entry, the mean of all frames, if the frames are summed.
fn appearances(
    path: &ScanPath,
    columns: &[ColumnTruth],
    options: &RecordingOptions,
) -> Array3<f64> {
    let frames = options.acquisition.frames;
    let kept = if options.keep_frames { frames } else { 1 };
    let mut places = Array3::zeros((kept, columns.len(), 2));
    for frame in 0..frames {
        let to = if options.keep_frames { frame } else { 0 };
        for (n, column) in columns.iter().enumerate() {
            let [x, y] = column.position_nm.map(f64::from);
            let first = path.frame().origin_nm;
            let seen = path.appearance_px(frame, [first[0] + x, first[1] + y]);
            for (k, at) in seen.into_iter().enumerate() {
                places[(to, n, k)] += at * kept as f64 / frames as f64;
            }
        }
    }
    places
}
