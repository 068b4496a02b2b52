//! Samples of the full field: the probe positions of particles, at which the film's image is also computed.

use std::ops::Range;

use crate::lengths;
use crate::plane;
use crate::recipe::Region;
use crate::resample::HALF_WIDTH;

/// A rectangle of samples of the full field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Samples {
    /// Row and column of the first sample; sample 0 is at pixel 0 of the full field.
    pub first: [i64; 2],
    /// Rows and columns.
    pub shape: [usize; 2],
}

impl Samples {
    /// Block `index` of blocks of `edge` samples.
    pub fn block(index: [i64; 2], edge: i64) -> Self {
        Samples { first: index.map(|n| n * edge), shape: [edge as usize; 2] }
    }

    /// The blocks of `edge` samples that contain any of these samples.
    pub fn blocks(&self, edge: i64) -> Vec<[i64; 2]> {
        let range = |k: usize| {
            let last = self.first[k] + self.shape[k] as i64 - 1;
            self.first[k].div_euclid(edge)..=last.div_euclid(edge)
        };
        range(0).flat_map(|i| range(1).map(move |j| [i, j])).collect()
    }

    /// The area of the samples, grown by `margin` Angstrom on all sides, in nm of the full field. The distance of samples is `step`
    /// Angstrom.
    pub fn region(&self, step: f64, margin: f64) -> Region {
        let range = |k: usize| {
            let first = self.first[1 - k] as f64 * step;
            let last = first + (self.shape[1 - k] - 1) as f64 * step;
            lengths::nm([first - margin, last + margin])
        };
        Region { x: range(0), y: range(1) }
    }

    /// The samples in both rectangles, along axis `k`: their numbers in `others`, and the number of the first in `self`.
    pub fn shared(&self, others: &Samples, k: usize) -> (Range<usize>, usize) {
        let offset = others.first[k] - self.first[k];
        let end = (others.shape[k] as i64).min(self.shape[k] as i64 - offset);
        let start = (-offset).max(0);
        (start as usize..end.max(start) as usize, (start + offset) as usize)
    }

    /// The samples from which places in a region (nm of the full field) are interpolated. The distance of samples is `step` Angstrom.
    pub fn around(region: &Region, step: f64) -> Self {
        let margin = HALF_WIDTH as i64;
        let range = |ends: [f64; 2]| {
            let [low, high] = lengths::angstrom(ends).map(|at| (at / step).floor() as i64);
            (low - margin, (high - low + 2 + 2 * margin) as usize)
        };
        let ((x, columns), (y, rows)) = (range(region.x), range(region.y));
        Samples { first: [y, x], shape: [rows, columns] }
    }

    /// The samples from which pixels are interpolated. The distance of pixels is `pixel` samples.
    pub fn under(first: [usize; 2], shape: [usize; 2], pixel: f64) -> Self {
        // With whole stencils on all sides, the value of a pixel does not depend on where the samples end.
        let margin = HALF_WIDTH as i64;
        let low = first.map(|p| (p as f64 * pixel).floor() as i64 - margin);
        let high =
            plane::add(first, shape).map(|p| ((p - 1) as f64 * pixel).floor() as i64 + 1 + margin);
        Samples { first: low, shape: plane::sub(high, low).map(|n| (n + 1) as usize) }
    }
}
