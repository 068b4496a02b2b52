//! The interface of a world that episodes act in.

use std::sync::Arc;

use ndarray::Array2;

use super::findings::{FoundParticle, PlacedDefect};
use super::view::{FieldFacts, TileView};
use crate::error::Result;
use crate::progress::Progress;
use crate::recipe::Region;

/// An atomic column of the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueColumn {
    /// Position (x, y) in nm.
    pub position_nm: [f64; 2],
    /// Whether any of the column's sites holds a defect.
    pub defective: bool,
}

/// The truth of a region. Places are (x, y) in nm from the centre of the field's first pixel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RegionTruth {
    /// Each vacant or substituted site.
    pub defects: Vec<PlacedDefect>,
    /// Columns in the region.
    pub columns: Vec<TrueColumn>,
    /// Particles that reach into the region.
    pub particles: Vec<FoundParticle>,
}

/// Phases of a field, sampled at every `stride_px`-th pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseSamples {
    /// Indices of phases, [row, column].
    pub phases: Array2<i32>,
    /// Distance of samples in pixels of the field; the first sample lies half a distance from the edge.
    pub stride_px: usize,
}

impl PhaseSamples {
    /// Returns the number of samples (rows, columns) of a field of `field_px` pixels.
    pub(super) fn shape(field_px: [usize; 2], stride_px: usize) -> [usize; 2] {
        field_px.map(|n| n.saturating_sub(stride_px / 2).div_ceil(stride_px))
    }
}

/// A recording of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedView {
    /// Fractions of the beam, [row, column].
    pub image: Array2<f32>,
    /// The truth of the view at the time of the recording.
    pub truth: RegionTruth,
}

/// A world that an episode acts in.
pub trait BenchmarkWorld: Send + Sync {
    /// Returns facts of the field.
    fn facts(&self) -> &FieldFacts;

    /// Returns the noise-free image of a view in fractions of the beam, [row, column]. Between pixels it is
    /// interpolated (see `resample.rs`).
    ///
    /// # Errors
    /// Errors of the engine or the file, and [`crate::Error::Interrupted`].
    fn clean(&self, view: &TileView, progress: &dyn Progress) -> Result<Arc<Array2<f32>>>;

    /// Returns a view of the image that the world holds, with its noise, in units of tiles.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for worlds that hold no image; errors of the file.
    fn stored(&self, view: &TileView) -> Result<Array2<f32>>;

    /// Returns the part of the overview, in units of tiles, with `size` x `size` pixels about a position (x, y) in fractions of the field;
    /// zeros beyond the edge of a smaller field.
    ///
    /// # Errors
    /// As [`BenchmarkWorld::clean`].
    fn overview(
        &self,
        position: [f64; 2],
        size: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>>;

    /// Returns the present truth of a region. Columns are listed if `columns` is set.
    ///
    /// # Errors
    /// Errors of the file.
    fn truth(&self, region: &Region, columns: bool) -> Result<RegionTruth>;

    /// Returns the phases of the full field at every `stride_px`-th pixel, and keeps them for later calls.
    ///
    /// # Errors
    /// Errors of the file.
    fn phases(&self, stride_px: usize) -> Result<Arc<PhaseSamples>>;

    /// Records a view with `dose` electrons per square Angstrom in a world that they damage. `None` for worlds that do not change.
    ///
    /// # Errors
    /// As [`BenchmarkWorld::clean`].
    fn exposed(
        &self,
        _view: &TileView,
        _dose: f64,
        _columns: bool,
        _progress: &dyn Progress,
    ) -> Result<Option<RecordedView>> {
        Ok(None)
    }
}

/// Returns the first row and column of the overview's window about a position, in a map of this shape.
pub(super) fn window(position: [f64; 2], shape: [usize; 2], size: usize) -> [usize; 2] {
    [0, 1].map(|k| {
        let centre = position[1 - k].clamp(0.0, 1.0) * shape[k] as f64;
        let first = (centre - 0.5 * size as f64).round().max(0.0) as usize;
        first.min(shape[k].saturating_sub(size))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_stay_in_the_overview() {
        assert_eq!(window([0.5, 0.5], [200, 100], 64), [68, 18]);
        assert_eq!(window([0.0, 1.0], [200, 100], 64), [136, 0]);
        assert_eq!(window([0.9, 0.1], [30, 40], 64), [0, 0]);
    }
}
