//! Files in HDF5. The schema of a world is written and read here only.

pub mod schema;
mod world_file;
mod world_writer;

pub use world_file::{GroundTruth, WorldFile, WorldMetadata};
pub use world_writer::{Header, TruthBatch, WorldWriter};

use std::path::Path;

use crate::error::{Error, Result};

/// Names the file in an error of HDF5.
trait At<T> {
    fn at(self, path: &Path) -> Result<T>;
}

impl<T> At<T> for hdf5::Result<T> {
    fn at(self, path: &Path) -> Result<T> {
        self.map_err(|e| Error::hdf5(path, e))
    }
}
