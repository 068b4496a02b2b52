//! Live worlds: a specimen in memory that is looked at, recorded, and changed by the electrons that record it.
//!
//! recipe -> specimen -> images of blocks, made when first looked at -> recordings. Nothing is on disk but the library of a
//! mosaic, in the cache of the user.

mod block_imager;
mod dose_series;
mod live_history;
mod live_world;
#[cfg(feature = "hdf5")]
mod series_writer;

pub use dose_series::{DoseSeries, check_recordings};
pub use live_history::{LiveAcquisition, LiveSnapshot};
pub use live_world::{LiveOptions, LiveRequest, LiveTruth, LiveWorld, MOST_DOSE};
