//! What the page's scripts read first. Lengths are in the header's unit, positions from the centre of
//! pixel (0, 0), x to the right and y down.

use serde::Serialize;

use super::column_list::PageColumns;
use super::pyramid::Level;

/// All that a page shows, but for the blobs.
#[derive(Debug, Default, Serialize)]
pub(super) struct PageHeader {
    pub title: String,
    /// Unit of lengths: `nm` or `Å`.
    pub unit: &'static str,
    /// Columns and rows of the images in pixels.
    pub size: [usize; 2],
    /// Width and height of a pixel.
    pub pixel: [f64; 2],
    /// Position of pixel (0, 0) on the axes.
    pub origin: [f64; 2],
    /// Names and values to be read by people.
    pub facts: Vec<(String, String)>,
    /// Edge of the pyramids' tiles in pixels.
    pub tile: usize,
    /// Tiles of the world file: edge and distance in pixels.
    pub world_tile: Option<[usize; 2]>,
    pub images: Vec<PageImage>,
    pub phases: Option<Phases>,
    pub boundaries: Vec<PageBoundary>,
    pub particles: Vec<PageParticle>,
    pub columns: Option<PageColumns>,
    pub colormaps: Vec<(&'static str, String)>,
    /// How the page opens.
    pub start: Start,
}

/// How a page opens.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Start {
    pub colormap: String,
    /// Percentiles of contrast.
    pub contrast: [f64; 2],
    pub overlays: Vec<String>,
    /// Left, upper, right and lower edge of the part that is shown.
    pub region: Option<[f64; 4]>,
    /// Index of the first image to be shown.
    pub image: usize,
}

impl Default for Start {
    fn default() -> Self {
        let (colormap, contrast) = ("gray".into(), [0.1, 99.9]);
        Start { colormap, contrast, overlays: Vec::new(), region: None, image: 0 }
    }
}

/// One image.
#[derive(Debug, Serialize)]
pub(super) struct PageImage {
    /// What one chooses between: detectors, or the noisy and the noiseless image.
    pub name: String,
    /// Place in a series of thicknesses, in the unit of lengths.
    pub thickness: Option<f64>,
    /// Number in a series of frames or recordings.
    pub number: Option<usize>,
    /// What the values are.
    pub quantity: String,
    /// What is shown is `value * scale + offset`.
    pub scale: f64,
    pub offset: f64,
    /// Name of the values in the file, where that is another quantity.
    pub stored: Option<&'static str>,
    /// Electrons that fall on a pixel, where the image holds counted electrons.
    pub electrons: Option<f64>,
    /// Whether the values are exact, as the file holds them; else they are rounded.
    pub exact: bool,
    /// The finest first.
    pub levels: Vec<Level>,
}

/// The map of phases, whose codes are colours of their own.
#[derive(Debug, Serialize)]
pub(super) struct Phases {
    pub names: Vec<String>,
    pub levels: Vec<Level>,
}

/// A line between grains or phases.
#[derive(Debug, Serialize)]
pub(super) struct PageBoundary {
    pub text: String,
    pub points: Vec<[f32; 2]>,
}

#[derive(Debug, Serialize)]
pub(super) struct PageParticle {
    pub centre: [f32; 2],
    pub diameter: f32,
    pub text: String,
}
