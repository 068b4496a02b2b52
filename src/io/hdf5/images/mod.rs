//! Files of simulated images, and the images of such files and of recordings for display.

pub(crate) mod hspy_file;
pub(crate) mod image_file;
pub(crate) mod image_series;
pub(crate) mod stored_images;
