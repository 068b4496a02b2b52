//! Pixelated detectors: the whole diffraction pattern of every probe.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Most pixels along an edge.
pub(crate) const MOST_PIXELS: usize = 4096;

/// A square detector of square pixels. Pixel `pixels / 2` of each axis has its middle on the optical axis, so that it covers
/// `-max_angle_mrad` less half a pixel to `max_angle_mrad` less half a pixel if the number is even.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PixelatedDetector {
    /// Pixels along each edge.
    pub pixels: usize,
    /// Half the width of the detector in mrad.
    pub max_angle_mrad: f64,
}

impl PixelatedDetector {
    /// Refuses impossible detectors.
    ///
    /// # Errors
    /// [`Error::Invalid`] for less than 2 or more than 4096 pixels, and for an angle that is not above 0.
    pub(crate) fn check(&self) -> Result<()> {
        if !(2..=MOST_PIXELS).contains(&self.pixels) {
            let expected = format!("expected 2 to {MOST_PIXELS} pixels along an edge");
            return Err(Error::invalid(Setting::PatternPixels, self.pixels, expected));
        }
        if !(self.max_angle_mrad > 0.0 && self.max_angle_mrad <= super::MOST_MRAD) {
            let expected = "expected an angle in mrad above 0, and at most 1570 (a right angle)";
            return Err(Error::invalid(Setting::MaxAngleMrad, self.max_angle_mrad, expected));
        }
        Ok(())
    }

    /// Width of a pixel in mrad.
    pub fn pixel_mrad(&self) -> f64 {
        2.0 * self.max_angle_mrad / self.pixels as f64
    }

    /// Width of a pixel in 1/Angstrom.
    pub fn pixel_k(&self, wavelength_angstrom: f64) -> f64 {
        1e-3 * self.pixel_mrad() / wavelength_angstrom
    }

    /// Frequency (1/Angstrom) of the middle of pixel `i` along an axis.
    pub(crate) fn k(&self, i: usize, wavelength_angstrom: f64) -> f64 {
        1e-3 * self.angle_mrad(i) / wavelength_angstrom
    }

    /// Angle (mrad) of the middle of pixel `i` along an axis.
    pub(crate) fn angle_mrad(&self, i: usize) -> f64 {
        (i as f64 - (self.pixels / 2) as f64) * self.pixel_mrad()
    }
}
