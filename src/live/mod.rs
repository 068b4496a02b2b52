//! Live worlds: a specimen in memory that can be viewed and recorded, and that the electrons of recordings change.
//!
//! recipe -> specimen -> images of blocks, made when first needed -> recordings. Only the library of a mosaic is on disk, in the user's
//! cache.

mod block_imager;
mod dose_series;
mod exposed_scan;
mod live_history;
mod live_patterns;
mod live_world;
#[cfg(feature = "hdf5")]
mod series_writer;

pub use dose_series::{DetectorSeries, DoseSeries, check_recordings};
pub use live_history::{LiveAcquisition, LiveSnapshot};
pub use live_patterns::PlacePatterns;
pub use live_world::{LiveOptions, LiveRequest, LiveTruth, LiveWorld};
