//! Records the lines of a scan on one of its detectors.

use std::ops::Range;

use ndarray::Array2;

use super::field_recording::{DetectorRecording, RecordingOptions};
use super::kept_frames::KeptFrames;
use super::recorded_detectors::RecordedDetector;
use crate::acquisition::{Acquisition, RecordedRows, Recorder, ScanFrame, SourceImage};
use crate::plane;

/// One of the detectors of a scan. All share the path of the beam.
pub(crate) struct DetectorRecorder<'a> {
    own: &'a RecordedDetector,
    settings: Acquisition,
    recorder: Recorder,
    /// Places of its measured images among the images of all detectors.
    images: Vec<usize>,
}

/// Returns the numbers of the measured images that some detectors need, in rising order.
pub(crate) fn numbers_of(detectors: &[RecordedDetector]) -> Vec<usize> {
    let mut numbers: Vec<usize> = detectors.iter().flat_map(RecordedDetector::measured).collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

impl<'a> DetectorRecorder<'a> {
    /// Takes the path of a scan; `numbers` are the numbers of the measured images, as [`numbers_of`] gives them.
    pub fn new(
        own: &'a RecordedDetector,
        scan: &Recorder,
        options: &RecordingOptions,
        numbers: &[usize],
    ) -> Self {
        let settings = own.settings(&options.acquisition);
        let recorder = scan.of_detector(&settings, own.shown.number as u16);
        let needed = own.measured();
        let images = needed.iter().filter_map(|n| numbers.iter().position(|m| m == n)).collect();
        DetectorRecorder { own, settings, recorder, images }
    }

    /// Whether its values are mean angles.
    pub fn is_deflection(&self) -> bool {
        self.own.shown.axis.is_some()
    }

    /// The measured images of a centre of mass.
    fn parts<'b>(&self, images: &'b [SourceImage]) -> Option<(usize, [&'b SourceImage; 3])> {
        let &[electrons, share, square] = &self.images[..] else { return None };
        Some((self.own.shown.axis?, [electrons, share, square].map(|n| &images[n])))
    }

    /// Samples the noise-free image at the pixels of the intended scan.
    pub fn meant(&self, frame: &ScanFrame, images: &[SourceImage]) -> Array2<f32> {
        let parts = self.parts(images);
        Array2::from_shape_fn(frame.shape, |(row, column)| {
            let at = [column, row].map(|p| p as f64 * frame.pixel_nm);
            let place = plane::add(frame.origin_nm, at);
            match &parts {
                Some((_, parts)) => {
                    self.own.shown.angle_of(parts.map(|image| image.at(place)))[0] as f32
                }
                None => images[self.images[0]].at(place) as f32,
            }
        })
    }

    /// Records some rows of a frame, as [`Recorder::rows`] does.
    pub fn rows(
        &self,
        frame: usize,
        rows: Range<usize>,
        images: &[SourceImage],
        late: &mut f64,
    ) -> RecordedRows {
        match self.parts(images) {
            Some((axis, parts)) => {
                let angle = |values| self.own.shown.angle_of(values);
                self.recorder.mean_angles(frame, rows, parts, (axis, &angle))
            }
            None => self.recorder.rows(frame, rows, &images[self.images[0]], late),
        }
    }

    /// The recording on this detector.
    pub fn recording(&self, kept: KeptFrames, ideal: Array2<f32>) -> DetectorRecording {
        DetectorRecording {
            detector: self.own.shown.detector.clone(),
            acquisition: self.settings,
            data: kept.data,
            ideal,
            stages: kept.stages,
            clipped: kept.clipped,
        }
    }
}
