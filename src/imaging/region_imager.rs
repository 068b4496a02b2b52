//! Methods that make the image of any part of a field, out of more than a simulation of that part.

use ndarray::Array2;

use crate::error::Result;
use crate::imaging::displaced_atoms::DisplacedAtoms;
use crate::progress::Progress;
use crate::recipe::region::Region;

/// See the module.
pub trait FieldImage: Send + Sync {
    /// Name of the method.
    fn name(&self) -> &'static str;

    /// Settings that decide the image.
    fn parameters(&self) -> serde_json::Value;

    /// The noiseless image of `shape` pixels from pixel `first` (row, column) of the full field, as fraction of the beam: the
    /// mean over the first `configurations`.
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn mean_of(
        &self,
        first: [usize; 2],
        shape: [usize; 2],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>>;

    /// Unit of [`FieldImage::work`].
    fn unit(&self) -> &'static str {
        "pixel"
    }

    /// What the image of such an area takes, in units of like cost: for progress.
    fn work(&self, _first: [usize; 2], shape: [usize; 2]) -> usize {
        shape[0] * shape[1]
    }

    /// The displaced atoms of an area in one configuration: those that the image shows.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms;

    /// Images of the library that it draws on, and how many of them had to be simulated.
    fn library(&self) -> Option<[usize; 2]> {
        None
    }
}
