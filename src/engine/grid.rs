//! Periodic grids in real space, and their frequencies.

use crate::fft::frequency;
use crate::plane;
use serde::Serialize;

/// A periodic grid in real space. Arrays on it have `points[1]` rows (y) and `points[0]` columns (x).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Grid {
    /// Points along x and y.
    pub points: [usize; 2],
    /// Extent along x and y in Angstrom.
    pub extent_angstrom: [f64; 2],
}

impl Grid {
    /// Pixel size along x and y in Angstrom.
    pub fn sampling_angstrom(&self) -> [f64; 2] {
        plane::div(self.extent_angstrom, self.points.map(|n| n as f64))
    }

    /// Shape of the grid's arrays: (rows, columns).
    pub(crate) fn shape(&self) -> (usize, usize) {
        (self.points[1], self.points[0])
    }

    /// Spacing of the Fourier grid along x and y in 1/Angstrom.
    pub(crate) fn dk(&self) -> [f64; 2] {
        self.extent_angstrom.map(|l| 1.0 / l)
    }

    /// Spatial frequency (kx, ky) of bin (row iy, column ix) in 1/Angstrom.
    pub(crate) fn k(&self, iy: usize, ix: usize) -> [f64; 2] {
        [
            frequency(ix, self.points[0]) as f64 / self.extent_angstrom[0],
            frequency(iy, self.points[1]) as f64 / self.extent_angstrom[1],
        ]
    }

    /// Nyquist frequency of the coarser axis in 1/Angstrom.
    pub(crate) fn nyquist(&self) -> f64 {
        let [x, y] = self.sampling_angstrom();
        0.5 / x.max(y)
    }

    /// The largest frequency index (x, y) within `limit` (1/Angstrom) that both this grid and another one of `points` over the same extent
    /// contain.
    pub(super) fn common_reach(&self, points: [usize; 2], limit: f64) -> [usize; 2] {
        let dk = self.dk();
        plane::per_axis(plane::min(self.points, points), dk, |n, dk| {
            ((limit / dk) as usize).min((n - 1) / 2)
        })
    }
}
