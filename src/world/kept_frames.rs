//! The frames of a recording on one detector that are kept.

use ndarray::{Array3, Axis, Slice, Zip};

use super::field_recording::{RecordingOptions, RecordingStages};
use crate::acquisition::{RecordedRows, ScanFrame};

/// The frames or stages of a recording that are kept.
pub(crate) struct KeptFrames {
    /// Recorded values: [frame, row, column]; one frame if the frames are summed.
    pub data: Array3<f64>,
    /// Electrons by which mean angles are weighted when frames are added; `None` for counts.
    electrons: Option<Array3<f64>>,
    /// The stages, if they are kept.
    pub stages: Option<RecordingStages>,
    keep_frames: bool,
    /// Number of pixels that the converter clipped.
    pub clipped: u64,
}

impl KeptFrames {
    /// Makes empty arrays for the frames of a scan, for counts or for mean angles.
    pub fn new(frame: &ScanFrame, options: &RecordingOptions, angles: bool) -> Self {
        let [rows, columns] = frame.shape;
        let frames = options.acquisition.frames;
        let kept = if options.keep_frames { frames } else { 1 };
        let stages = || RecordingStages {
            moved: Array3::zeros((frames, rows, columns)),
            electrons: Array3::zeros((frames, rows, columns)),
        };
        KeptFrames {
            data: Array3::zeros((kept, rows, columns)),
            electrons: angles.then(|| Array3::zeros((kept, rows, columns))),
            stages: options.keep_stages.then(stages),
            keep_frames: options.keep_frames,
            clipped: 0,
        }
    }

    /// Adds rows of a frame, of which the first is `first`.
    pub fn add(&mut self, frame: usize, first: usize, rows: &RecordedRows) {
        let range = Slice::from(first..first + rows.values.nrows());
        let to = if self.keep_frames { frame } else { 0 };
        let mut data = self.data.index_axis_mut(Axis(0), to);
        let mut data = data.slice_axis_mut(Axis(0), range);
        match &mut self.electrons {
            None => data.zip_mut_with(&rows.values, |sum, value| *sum += f64::from(*value)),
            Some(electrons) => {
                let mut all = electrons.index_axis_mut(Axis(0), to);
                let all = all.slice_axis_mut(Axis(0), range);
                Zip::from(data).and(all).and(&rows.values).and(&rows.electrons).for_each(
                    |sum, all, value, own| {
                        *sum += f64::from(*value) * f64::from(*own);
                        *all += f64::from(*own);
                    },
                );
            }
        }
        if let Some(stages) = &mut self.stages {
            for (to, from) in
                [(&mut stages.moved, &rows.moved), (&mut stages.electrons, &rows.electrons)]
            {
                let mut to = to.index_axis_mut(Axis(0), frame);
                to.slice_axis_mut(Axis(0), range).assign(from);
            }
        }
        self.clipped += rows.clipped;
    }

    /// Ends the recording: a mean angle becomes the mean over the electrons of all added frames.
    #[must_use]
    pub fn finished(mut self) -> Self {
        if let Some(electrons) = self.electrons.take() {
            self.data.zip_mut_with(&electrons, |sum, all| {
                *sum = if *all > 0.0 { *sum / *all } else { 0.0 };
            });
        }
        self
    }
}
