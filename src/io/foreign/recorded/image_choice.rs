//! The choice of an image in a file.

use std::path::Path;

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Choice among the images of a file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ImageChoice {
    /// Name of the image, or path of its data set.
    pub dataset: Option<String>,
    /// Number of the frame, from 0.
    pub index: Option<usize>,
}

/// Returns the number, from 0, of the frame to read out of `frames`.
pub(super) fn frame_of(
    path: &Path,
    name: &str,
    frames: usize,
    index: Option<usize>,
) -> Result<usize> {
    let last = frames.saturating_sub(1);
    let choice = |message: String| Err(Error::choice(path, Setting::ImageIndex, message));
    match index {
        None if frames == 1 => Ok(0),
        None => choice(format!("`{name}` holds {frames} frames; choose one, from 0 to {last}")),
        Some(index) if index < frames => Ok(index),
        Some(index) => choice(format!("`{name}` has no frame {index}; its frames are 0 to {last}")),
    }
}
