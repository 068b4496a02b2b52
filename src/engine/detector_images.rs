//! The result of a simulation.

use ndarray::{Array4, ArrayView2, s};

/// Detector images, averaged over phonon configurations.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Images {
    /// Fractions of the incident beam: (thickness, detector, row = y, column = x).
    pub data: Array4<f32>,
    /// Detector names, in the order of `data`.
    pub detectors: Vec<String>,
    /// Thicknesses in Angstrom, in the order of `data`.
    pub thicknesses_angstrom: Vec<f64>,
}

impl Images {
    /// The image (rows = y, columns = x) of a detector at a recorded thickness, both counted from 0, as fractions of the
    /// incident beam.
    pub fn image(&self, thickness: usize, detector: usize) -> ArrayView2<'_, f32> {
        self.data.slice(s![thickness, detector, .., ..])
    }
}
