//! Makes worlds from recorded images: an image is calibrated, scaled and cut into tiles, with the places that its file lists.

mod calibration;
mod nearest_cells;
mod replay_tiles;
mod replay_world;
mod robust_range;

pub use calibration::{Calibration, CalibrationPeak, calibrate};
pub use replay_tiles::stored_training_set;
pub use replay_world::{PixelOrigin, ReplayFacts, ReplayOptions, ReplayWorld};
