//! Pictures for people: 8-bit PNG files with contrast, scale bar and markers, and drawings
//! of specimens; HTML pages to look at images with.

mod animation;
mod canvas;
mod colormap;
mod enlarge;
mod font;
#[cfg(feature = "report")]
pub mod html;
mod image;
#[cfg(feature = "report")]
pub mod image_pictures;
mod letters;
mod overlay;
mod scene;
mod strokes;
#[cfg(feature = "report")]
mod world_picture;

pub use animation::{FRAME_S, animated_png};
pub use canvas::RgbImage;
pub use colormap::Colormap;
pub use enlarge::Enlarge;
pub use image::{Contrast, Picture};
pub use overlay::{Marker, MarkerShape};
pub use scene::palette;
pub(crate) use scene::{Scene, Swatch};
#[cfg(feature = "report")]
pub use world_picture::{Overlay, WorldPart, WorldPicture};
