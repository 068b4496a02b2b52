//! Detectors that record every diffraction pattern: all pixels, or sums over rings.

use ndarray::Array2;

use super::{PixelatedDetector, RadialBins, VirtualDetector};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// The recorded values of a diffraction pattern.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PatternDetector {
    /// The pixels of a square detector, (ky, kx).
    Pixels(PixelatedDetector),
    /// Sums over rings, (1, ring).
    Rings(RadialBins),
}

impl From<PixelatedDetector> for PatternDetector {
    fn from(pixels: PixelatedDetector) -> Self {
        PatternDetector::Pixels(pixels)
    }
}

impl PatternDetector {
    /// Rows and columns of a recorded pattern; rings are one row.
    pub fn shape(&self) -> [usize; 2] {
        match self {
            PatternDetector::Pixels(pixels) => [pixels.pixels; 2],
            PatternDetector::Rings(rings) => [1, rings.rings],
        }
    }

    /// Number of values of a recorded pattern.
    pub(crate) fn values(&self) -> usize {
        let [rows, columns] = self.shape();
        rows * columns
    }

    /// Half the width of the pixels, or the outer angle of the last ring, in mrad.
    pub fn max_angle_mrad(&self) -> f64 {
        match self {
            PatternDetector::Pixels(pixels) => pixels.max_angle_mrad,
            PatternDetector::Rings(rings) => rings.max_angle_mrad(),
        }
    }

    /// The pixelated detector; `None` for rings.
    pub fn pixels(&self) -> Option<&PixelatedDetector> {
        match self {
            PatternDetector::Pixels(pixels) => Some(pixels),
            PatternDetector::Rings(_) => None,
        }
    }

    /// The rings; `None` for pixels.
    pub fn rings(&self) -> Option<&RadialBins> {
        match self {
            PatternDetector::Pixels(_) => None,
            PatternDetector::Rings(rings) => Some(rings),
        }
    }

    /// The share of each value on a detector, in the shape of a recorded pattern.
    ///
    /// # Errors
    /// [`Error::Invalid`] for angles beyond the pattern, for a detector without any pixel, and for one that is not made of whole rings.
    pub fn weights(&self, detector: &VirtualDetector) -> Result<Array2<f32>> {
        match self {
            PatternDetector::Pixels(pixels) => detector.weights(pixels),
            PatternDetector::Rings(_) if !detector.is_annulus() => {
                let expected = "patterns of rings contain no azimuths; sectors and shifted centres need patterns of pixels";
                Err(Error::invalid(Setting::Detector, &detector.name, expected))
            }
            PatternDetector::Rings(rings) => rings.weights(&detector.name, detector.annulus_mrad),
        }
    }
}
