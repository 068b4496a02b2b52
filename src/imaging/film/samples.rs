//! Samples of the full field: where probes of particles stand, and the image of the film is worked out.

use crate::resample::MARGIN;

/// Samples of the full field: the first (row, column), and how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Samples {
    /// The first (row, column); sample 0 is at pixel 0 of the full field.
    pub first: [i64; 2],
    /// Rows and columns.
    pub shape: [usize; 2],
}

impl Samples {
    /// Those that pixels `pixel` samples apart are interpolated from.
    pub fn under(first: [usize; 2], shape: [usize; 2], pixel: f64) -> Self {
        let margin = MARGIN as i64;
        let low = first.map(|p| (p as f64 * pixel).floor() as i64 - margin);
        let high =
            [0, 1].map(|k| ((first[k] + shape[k] - 1) as f64 * pixel).floor() as i64 + 1 + margin);
        Samples { first: low, shape: [0, 1].map(|k| (high[k] - low[k] + 1) as usize) }
    }
}
