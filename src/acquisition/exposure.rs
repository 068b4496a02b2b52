//! Dose, current and time on a pixel.

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Electrons that a current of 1 pA carries in 1 us.
pub(crate) const ELECTRONS_PER_PA_US: f64 = 1e-18 / 1.602_176_634e-19;
/// Currents of the beam in pA.
const CURRENT_PA: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Doses in electrons per square Angstrom.
const DOSE: std::ops::RangeInclusive<f64> = 1e-3..=1e12;

/// The electrons on each pixel, and the time and frames in which they fall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Electrons on one pixel in one frame.
    pub electrons_per_pixel: f64,
    /// Time on one pixel in one frame, in microseconds.
    pub dwell_us: f64,
    /// Number of frames.
    pub frames: usize,
    /// Edge of a pixel in Angstrom.
    pub pixel_angstrom: f64,
}

impl Exposure {
    /// The exposure by which `frames` frames together give a dose in electrons per square Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a dose out of limits.
    pub fn of_dose(dose: f64, dwell_us: f64, frames: usize, pixel_angstrom: f64) -> Result<Self> {
        if !DOSE.contains(&dose) {
            let expected = "expected 0.001 to 1e12 electrons per square Angstrom";
            return Err(Error::invalid(Setting::Dose, dose, expected));
        }
        let electrons_per_pixel = dose * pixel_angstrom * pixel_angstrom / frames as f64;
        Ok(Exposure { electrons_per_pixel, dwell_us, frames, pixel_angstrom })
    }

    /// The exposure with a beam of `current_pa` pA.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a current out of limits.
    pub fn of_current(
        current_pa: f64,
        dwell_us: f64,
        frames: usize,
        pixel_angstrom: f64,
    ) -> Result<Self> {
        if !CURRENT_PA.contains(&current_pa) {
            let expected = "expected 1e-6 to 1e6 pA";
            return Err(Error::invalid(Setting::BeamCurrentPa, current_pa, expected));
        }
        let electrons_per_pixel = current_pa * dwell_us * ELECTRONS_PER_PA_US;
        Ok(Exposure { electrons_per_pixel, dwell_us, frames, pixel_angstrom })
    }

    /// Current of the beam in pA.
    pub fn current_pa(&self) -> f64 {
        self.electrons_per_pixel / (self.dwell_us * ELECTRONS_PER_PA_US)
    }

    /// Dose of all frames together in electrons per square Angstrom.
    pub fn dose(&self) -> f64 {
        let area = self.pixel_angstrom * self.pixel_angstrom;
        self.electrons_per_pixel * self.frames as f64 / area
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 pA is 6.24 million electrons per second.
    #[test]
    fn dose_and_current_tell_the_same() {
        let by_current = Exposure::of_current(50.0, 10.0, 4, 0.2).unwrap();
        assert!((by_current.electrons_per_pixel - 3120.75).abs() < 0.01, "{by_current:?}");
        let by_dose = Exposure::of_dose(by_current.dose(), 10.0, 4, 0.2).unwrap();
        assert!((by_dose.current_pa() - 50.0).abs() < 1e-9);
        assert!((by_dose.electrons_per_pixel / by_current.electrons_per_pixel - 1.0).abs() < 1e-12);
    }
}
