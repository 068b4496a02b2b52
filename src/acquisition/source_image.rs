//! The noise-free image at places between its pixels.

use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lengths;
use crate::plane;
use crate::resample::{Kernel, TAPS};
use crate::setting::Setting;

/// Part of a noise-free image, with a value at any place of it. An image has no frequencies above twice the aperture's, so pixels closer
/// than `wavelength / (4 semiangle)` determine it everywhere. Its only error is the error of the interpolation (see `resample.rs`).
#[derive(Debug, Clone)]
pub struct SourceImage {
    values: Array2<f32>,
    pixel_nm: f64,
    origin_nm: [f64; 2],
    kernel: Arc<Kernel>,
}

impl SourceImage {
    /// Makes an image from pixels ([row, column] = [y, x], fractions of the beam) without frequencies above `band_limit` (1/Angstrom). The
    /// centre of the first pixel is at `origin_nm` (x, y).
    ///
    /// # Errors
    /// [`Error::Invalid`] for pixels too coarse to determine the image, or fewer than 16 along an axis.
    pub fn new(
        values: Array2<f32>,
        pixel_nm: f64,
        origin_nm: [f64; 2],
        band_limit: f64,
    ) -> Result<Self> {
        if values.nrows() < TAPS || values.ncols() < TAPS {
            let value = format!("{} x {} pixels", values.nrows(), values.ncols());
            let expected = format!("at least {TAPS} x {TAPS} pixels of the field are needed");
            return Err(Error::invalid(Setting::RecordedRegionNm, value, expected));
        }
        let kernel = Arc::new(Kernel::new(lengths::angstrom(pixel_nm), band_limit)?);
        Ok(SourceImage::with_kernel(values, pixel_nm, origin_nm, kernel))
    }

    /// As [`SourceImage::new`], with a kernel for these pixels. There are at least [`TAPS`] of them along each axis.
    pub(crate) fn with_kernel(
        values: Array2<f32>,
        pixel_nm: f64,
        origin_nm: [f64; 2],
        kernel: Arc<Kernel>,
    ) -> Self {
        assert!(values.nrows() >= TAPS && values.ncols() >= TAPS, "too few pixels for the kernel");
        SourceImage {
            values: values.as_standard_layout().into_owned(),
            pixel_nm,
            origin_nm,
            kernel,
        }
    }

    /// The smallest and the largest x and y in nm of the pixels.
    pub(crate) fn extent_nm(&self) -> [[f64; 2]; 2] {
        let (rows, columns) = self.values.dim();
        let range = |k: usize, n: usize| {
            [self.origin_nm[k], self.origin_nm[k] + (n as f64 - 1.0) * self.pixel_nm]
        };
        [range(0, columns), range(1, rows)]
    }

    /// Adds another image, which has no negative values, at the pixels of this one.
    #[must_use]
    pub(crate) fn plus(&self, other: &SourceImage) -> Self {
        let mut values = self.values.clone();
        let lines: Vec<_> = values.outer_iter_mut().enumerate().collect();
        lines.into_par_iter().for_each(|(row, mut line)| {
            for (column, value) in line.iter_mut().enumerate() {
                let at = [column, row].map(|p| p as f64 * self.pixel_nm);
                let place = plane::add(self.origin_nm, at);
                *value += other.at(place).max(0.0) as f32;
            }
        });
        SourceImage { values, ..self.clone() }
    }

    /// The image at a place (x, y) in nm, as fraction of the beam.
    pub fn at(&self, place_nm: [f64; 2]) -> f64 {
        let (rows, columns) = self.values.dim();
        let [x, y] = plane::sub(place_nm, self.origin_nm).map(|d| d / self.pixel_nm);
        let along_x = self.kernel.weights_within(x, columns);
        let along_y = self.kernel.weights_within(y, rows);
        let (first_row, first) = (along_y.first as usize, along_x.first as usize);
        let mut value = 0.0;
        for (k, weight) in along_y.values.iter().enumerate() {
            let row = self.values.row(first_row + k);
            let taps = row.as_slice().map(|row| &row[first..first + along_x.values.len()]);
            let line: f64 = taps
                .into_iter()
                .flatten()
                .zip(&along_x.values)
                .map(|(value, weight)| f64::from(*value) * weight)
                .sum();
            value += weight * line;
        }
        value
    }
}
