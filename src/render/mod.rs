//! Pictures for people: 8-bit PNG files with contrast, scale bar and markers.

mod canvas;
mod colormap;
mod font;
mod image;
mod letters;
mod overlay;
mod resample;

pub use canvas::RgbImage;
pub use colormap::Colormap;
pub use image::{Contrast, Picture};
pub use overlay::{Marker, Shape};
pub use resample::Enlarge;
