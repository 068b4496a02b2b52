//! Records the lines of an image.

use std::ops::Range;

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
    path: ScanPath,
    chain: DetectorChain,
    exposure: Exposure,
}

/// Rows of one frame; arrays are [row, column].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RecordedRows {
    /// The noise-free image at the real positions of the beam, as fraction of the beam.
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
        Recorder { path, chain, exposure }
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
        let pixel = |row: usize, column: usize| ((frame * height + row) * width + column) as u64;
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
}
