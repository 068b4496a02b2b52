//! Records the lines of an image.

use std::ops::Range;
use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;

use super::acquisition_settings::Acquisition;
use super::detector_chain::DetectorChain;
use super::exposure::Exposure;
use super::scan_path::ScanPath;
use super::source_image::SourceImage;

/// Records an image line by line.
#[derive(Debug, Clone)]
pub struct Recorder {
    path: Arc<ScanPath>,
    chain: DetectorChain,
    exposure: Exposure,
    seed: u64,
}

/// Mean and standard deviation of the angle of one electron, from the values of three images.
pub(crate) type AngleOf<'a> = &'a (dyn Fn([f64; 3]) -> [f64; 2] + Sync);

/// Rows of one frame; arrays are [row, column].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RecordedRows {
    /// The noise-free image at the real positions of the beam, as fraction of the beam; the mean angle of a centre of mass.
    pub moved: Array2<f32>,
    /// Electrons that hit the detector.
    pub electrons: Array2<f32>,
    /// The values in the file.
    pub values: Array2<f32>,
    /// Number of pixels that the converter clipped.
    pub clipped: u64,
}

/// Warns that a converter clipped `clipped` of `pixels` pixels; `None` if it clipped none.
pub fn clipping_warning(clipped: u64, pixels: usize, bits: u32) -> Option<String> {
    let share = 100.0 * clipped as f64 / pixels.max(1) as f64;
    let share = if share < 0.01 { "less than 0.01".to_owned() } else { format!("{share:.2}") };
    (clipped > 0).then(|| {
        format!(
            "{share} % of the pixels are beyond the {bits} bits of the converter; a smaller acquisition.gain_counts keeps them"
        )
    })
}

impl Recorder {
    /// A recorder of scans along `path`.
    pub fn new(settings: &Acquisition, path: ScanPath, exposure: Exposure, seed: u64) -> Self {
        let chain = DetectorChain::new(settings, &exposure, seed);
        Recorder { path: Arc::new(path), chain, exposure, seed }
    }

    /// A recorder of another detector of the same scan, with settings of its own. Its random numbers do not depend on the other detectors.
    #[must_use]
    pub(crate) fn of_detector(&self, settings: &Acquisition, detector: u16) -> Self {
        let chain = DetectorChain::new(settings, &self.exposure, self.seed).of_detector(detector);
        Recorder { path: Arc::clone(&self.path), chain, exposure: self.exposure, seed: self.seed }
    }

    /// The path of the beam.
    pub fn path(&self) -> &ScanPath {
        &self.path
    }

    /// The electrons on each pixel.
    pub(crate) fn exposure(&self) -> &Exposure {
        &self.exposure
    }

    /// Records some rows of a frame. `image` covers the beam's positions (`ScanPath::reach_nm`). `late` is the stored light of the rows
    /// before, 0 for the first row. Rows of a frame are recorded in order; frames may be recorded in any order.
    pub fn rows(
        &self,
        frame: usize,
        rows: Range<usize>,
        image: &SourceImage,
        late: &mut f64,
    ) -> RecordedRows {
        let [height, width] = self.path.frame().shape;
        let shape = (rows.len(), width);
        let (mut moved, mut electrons) = (Array2::zeros(shape), Array2::zeros(shape));
        let mut light = Array2::<f64>::zeros(shape);
        let pixel = |row, column| number([frame, row, column], [height, width]);
        let lines = moved.outer_iter_mut().zip(electrons.outer_iter_mut());
        let lines: Vec<_> = lines.zip(light.outer_iter_mut()).enumerate().collect();
        lines.into_par_iter().for_each(|(k, ((mut moved, mut electrons), mut light))| {
            let row = rows.start + k;
            for column in 0..width {
                let fraction = image.at(self.path.place_nm(frame, row, column));
                let counted = self.chain.electrons(fraction, pixel(row, column));
                moved[column] = fraction as f32;
                electrons[column] = counted as f32;
                light[column] = self.chain.light(counted, pixel(row, column));
            }
        });
        for mut line in light.outer_iter_mut() {
            self.chain.spread_late(line.as_slice_mut().unwrap_or(&mut []), late);
        }
        let mut values = Array2::zeros(shape);
        let lines: Vec<_> = values.outer_iter_mut().zip(light.outer_iter()).enumerate().collect();
        let clipped = lines.into_par_iter().map(|(k, (mut values, light))| {
            let mut clipped = 0;
            for column in 0..width {
                let counted = self.chain.counted(light[column], pixel(rows.start + k, column));
                values[column] = counted.value as f32;
                clipped += u64::from(counted.clipped);
            }
            clipped
        });
        let clipped = clipped.sum();
        RecordedRows { moved, electrons, values, clipped }
    }

    /// Records the mean angle of the electrons along an axis (0: x, 1: y) in some rows of a frame. The first image holds the electrons;
    /// `angle` takes the values of all three.
    pub(crate) fn mean_angles(
        &self,
        frame: usize,
        rows: Range<usize>,
        images: [&SourceImage; 3],
        (axis, angle): (usize, AngleOf),
    ) -> RecordedRows {
        let shape = self.path.frame().shape;
        let size = (rows.len(), shape[1]);
        let mut arrays = [(); 3].map(|()| Array2::<f32>::zeros(size));
        let [moved, electrons, values] = &mut arrays;
        let lines = moved.outer_iter_mut().zip(electrons.outer_iter_mut());
        let lines: Vec<_> = lines.zip(values.outer_iter_mut()).enumerate().collect();
        lines.into_par_iter().for_each(|(k, ((mut moved, mut electrons), mut values))| {
            let row = rows.start + k;
            for column in 0..shape[1] {
                let place = self.path.place_nm(frame, row, column);
                let shown = images.map(|image| image.at(place));
                let pixel = number([frame, row, column], shape);
                let (one, counted) = (angle(shown), self.chain.electrons(shown[0], pixel));
                moved[column] = one[0] as f32;
                electrons[column] = counted as f32;
                values[column] = self.chain.mean_angle(one, counted, axis, pixel) as f32;
            }
        });
        let [moved, electrons, values] = arrays;
        RecordedRows { moved, electrons, values, clipped: 0 }
    }
}

/// Number of a pixel of all frames, each of which has these rows and columns.
fn number([frame, row, column]: [usize; 3], [rows, columns]: [usize; 2]) -> u64 {
    ((frame * rows + row) * columns + column) as u64
}
