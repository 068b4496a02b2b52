//! Options of pictures of worlds and images.

use super::values;
use clap::{Args, ValueEnum};
use stemgen::render::{Colormap, Overlay, WorldPicture};

/// Longest side of a picture in pixels.
const SIDES: std::ops::RangeInclusive<i64> = 64..=16_384;

/// Holds the options of pictures of worlds and images.
#[derive(Debug, Args)]
#[command(next_help_heading = "Picture")]
pub struct PictureArgs {
    /// Draw the noise-free image: of a world built with --keep-clean, or the ideal image of a recording
    #[arg(long)]
    pub clean: bool,
    /// Colour map
    #[arg(long, value_name = "NAME", default_value = "gray")]
    pub colormap: ColormapName,
    /// Percentiles of the image that get the first and the last colour
    #[arg(long, value_name = "LOW,HIGH", default_value = "0.1,99.9")]
    #[arg(value_parser = values::percentiles)]
    pub contrast: Values,
    /// Parts of the ground truth to draw over the image; separate several by commas
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub overlay: Vec<OverlayName>,
    /// Longest side of the picture in pixels, without the legend
    #[arg(long, value_name = "PIXELS", default_value_t = 1600, conflicts_with = "html")]
    #[arg(value_parser = clap::value_parser!(u32).range(SIDES))]
    pub size: u32,
}

/// Two numbers of one option.
pub type Values = [f64; 2];

/// Colours of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ColormapName {
    Gray,
    Viridis,
    Inferno,
    Magma,
}

impl From<ColormapName> for Colormap {
    fn from(name: ColormapName) -> Self {
        match name {
            ColormapName::Gray => Colormap::Gray,
            ColormapName::Viridis => Colormap::Viridis,
            ColormapName::Inferno => Colormap::Inferno,
            ColormapName::Magma => Colormap::Magma,
        }
    }
}

/// Part of the ground truth that is drawn over an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum OverlayName {
    /// Columns with vacant or substituted sites, as rings; as a tint if columns are too small for rings
    Defects,
    /// Phases (regions of one crystal), and the boundaries of phases and grains
    Phases,
    /// Only the boundaries of phases and grains
    Boundaries,
    /// Particles
    Particles,
    /// All atomic columns
    Columns,
}

impl From<OverlayName> for Overlay {
    fn from(name: OverlayName) -> Self {
        match name {
            OverlayName::Defects => Overlay::Defects,
            OverlayName::Phases => Overlay::Phases,
            OverlayName::Boundaries => Overlay::Boundaries,
            OverlayName::Particles => Overlay::Particles,
            OverlayName::Columns => Overlay::Columns,
        }
    }
}

impl PictureArgs {
    /// Returns the settings of the picture.
    pub fn picture(&self) -> WorldPicture {
        WorldPicture {
            clean: self.clean,
            colormap: self.colormap.into(),
            contrast_percentiles: self.contrast,
            overlays: self.overlay.iter().copied().map(Overlay::from).collect(),
            longest_side_px: self.size,
        }
    }
}
