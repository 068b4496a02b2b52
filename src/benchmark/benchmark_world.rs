//! What an episode asks of a world.

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
    /// (x, y) in nm.
    pub position_nm: [f64; 2],
    /// Whether any of its sites holds a defect.
    pub defective: bool,
}

/// What is in a region. Places are (x, y) in nm from the centre of the field's first pixel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RegionTruth {
    /// Each vacant or substituted site.
    pub defects: Vec<PlacedDefect>,
    /// Columns in it.
    pub columns: Vec<TrueColumn>,
    /// Particles that reach into it.
    pub particles: Vec<FoundParticle>,
}

/// Phases at every so many pixels of a field.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseSamples {
    /// Indices of phases, [row, column].
    pub phases: Array2<i32>,
    /// Pixels of the field from one to the next; the first lies half as far from the edge.
    pub stride_px: usize,
}

impl PhaseSamples {
    /// How many samples (rows, columns) a field of so many pixels has.
    pub(super) fn shape(field_px: [usize; 2], stride_px: usize) -> [usize; 2] {
        field_px.map(|n| n.saturating_sub(stride_px / 2).div_ceil(stride_px))
    }
}

/// A recording of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedView {
    /// Fractions of the beam, [row, column].
    pub image: Array2<f32>,
    /// What was in the view while it was recorded.
    pub truth: RegionTruth,
}

/// A world that an episode acts in.
pub trait BenchmarkWorld: Send + Sync {
    /// Facts of its field.
    fn facts(&self) -> &FieldFacts;

    /// The noise-free image of a view in fractions of the beam, [row, column]: exact between pixels, up to the error of
    /// [`Kernel`](crate::resample::Kernel).
    ///
    /// # Errors
    /// Those of the engine or the file, and [`crate::Error::Interrupted`].
    fn clean(&self, view: &TileView, progress: &dyn Progress) -> Result<Arc<Array2<f32>>>;

    /// A view of the image as the world holds it, with its noise, in units of tiles.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] of worlds that hold no image; those of the file.
    fn stored(&self, view: &TileView) -> Result<Array2<f32>>;

    /// The part of the overview, in units of tiles, of so many of its pixels about a position (x, y) in fractions of the field;
    /// zeros beyond a field that is smaller.
    ///
    /// # Errors
    /// As [`BenchmarkWorld::clean`].
    fn overview(
        &self,
        position: [f64; 2],
        size: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>>;

    /// What is in a region now. Columns are listed if `columns`.
    ///
    /// # Errors
    /// Those of the file.
    fn truth(&self, region: &Region, columns: bool) -> Result<RegionTruth>;

    /// Phases of the full field at every `stride_px`-th pixel; kept for later calls.
    ///
    /// # Errors
    /// Those of the file.
    fn phases(&self, stride_px: usize) -> Result<Arc<PhaseSamples>>;

    /// Records a view with so many electrons per square Angstrom, of a world that they change. `None` of worlds that stay as they are.
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

/// The overview's window about a position: first row and column in a map of this shape.
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
