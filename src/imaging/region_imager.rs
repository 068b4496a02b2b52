//! The one way to an image of a field: imagers make that of any rectangle of it.

use std::path::Path;

use ndarray::Array2;

use super::displaced_atoms::DisplacedAtoms;
use super::imaging_cost::ImagingCost;
use super::pixels::PixelRect;
use super::turned_raster::TurnedRaster;
use crate::error::Result;
use crate::files::Shard;
use crate::progress::Progress;
use crate::recipe::region::Region;

/// What an imager is, whatever it is asked for. One around another imager changes of them what it changes.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagerFacts {
    /// Name of the method, as world files give it: `mosaic`, `film`, `window`, `prism`, `multislice`.
    pub name: &'static str,
    /// Settings that decide the image. A build goes on from an earlier one only under the same.
    pub parameters: serde_json::Value,
    /// How many images there are of each rectangle: one for each detector.
    pub detectors: usize,
    /// What progress calls the work on an image, and its unit.
    pub stage: [&'static str; 2],
    /// Width in Angstrom of the windows that follow the probe, where there are any.
    pub window_angstrom: Option<f64>,
    /// Images of the library that it draws on, and how many of them had to be simulated: of an imager that has one, and was prepared.
    pub library: Option<[usize; 2]>,
}

impl ImagerFacts {
    /// Those of an imager of one detector without windows and library.
    pub fn new(name: &'static str, parameters: serde_json::Value) -> Self {
        ImagerFacts {
            name,
            parameters,
            detectors: 1,
            stage: ["assembling", "pixel"],
            window_angstrom: None,
            library: None,
        }
    }
}

/// Of which detectors images are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DetectorChoice {
    /// The main one.
    Main,
    /// All, in the order of the recipe.
    All,
}

/// How an image at the places of a raster is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RasterDetail {
    /// Interpolated once, from the probes that were simulated.
    Full,
    /// For an overview, whose pixels are wider than a column: columns that only a simulation of their own would show may look like others
    /// nearby, and pixels may show the mean of their area.
    Overview,
}

/// A library of simulations that all images of an imager share.
pub trait SharedLibrary {
    /// Keeps simulations in a folder where they are kept nowhere else, for the same build to go on from. The folder is made when first
    /// written to.
    fn keep_in(&mut self, folder: &Path);

    /// Fills the library; a second call does nothing.
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn prepare(&mut self, progress: &dyn Progress) -> Result<()>;

    /// Does a part of what [`SharedLibrary::prepare`] does, for other processes to find where this one keeps it. Returns how many things the
    /// parts of others still lack.
    ///
    /// # Errors
    /// Those of the engine, [`crate::Error::Interrupted`], and those of files: what is not kept is lost.
    fn prepare_part(&mut self, shard: Shard, progress: &dyn Progress) -> Result<usize>;
}

/// Of an imager that makes blocks of a field as a whole, and keeps them.
pub trait ImageBlocks {
    /// The area (nm of the full field) of all atoms that have a part in the image of some pixels.
    fn shown_area(&self, pixels: &PixelRect) -> Region;

    /// Marks blocks that show atoms of an area (nm of the full field) as stale. A stale block is made again if its atoms have changed.
    fn mark_stale(&self, area: &Region);

    /// What the image of such pixels takes, in units of like cost: for progress.
    fn work(&self, pixels: &PixelRect) -> usize;
}

/// Makes the noise-free image of any rectangle of one field.
///
/// Pixels that two rectangles share are the same in both, up to the error that the imager states: a field can be made
/// piece by piece, in any order. No method has a default, so that an imager around another one says what it does with each.
pub trait RegionImager: Send + Sync {
    /// What it is.
    fn facts(&self) -> ImagerFacts;

    /// The library that all images share, where there is one. It has to be filled before any image is made.
    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary>;

    /// The blocks that it keeps; none of imagers whose pixels show what is within a window of them.
    fn blocks(&self) -> Option<&dyn ImageBlocks>;

    /// The noise-free images of the pixels, [row, column] = [y, x] of shape [`PixelRect::sampled_shape`], as fraction of the beam: the mean
    /// over the first `configurations` phonon configurations. Those of several detectors come from the same simulation of the same atoms.
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn images_of(
        &self,
        pixels: &PixelRect,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>>;

    /// The noise-free image on the main detector at the places of a raster, [row, column], as fraction of the beam. `None` of imagers that
    /// have none of their own; see [`turned_image`](super::turned_raster::turned_image).
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn image_at(
        &self,
        raster: &TurnedRaster,
        detail: RasterDetail,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Array2<f64>>>;

    /// The displaced atoms of an area (nm of the full field) in one phonon configuration: those that the image shows.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms;

    /// What making a field takes, of which each of `subtiles` parts has `subtile` (rows, columns) pixels. Nothing is simulated.
    ///
    /// # Errors
    /// Those of the plan.
    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost>;
}

/// Shorthands.
impl dyn RegionImager + '_ {
    /// Fills the library, if it has one: see [`SharedLibrary::prepare`].
    ///
    /// # Errors
    /// As [`SharedLibrary::prepare`].
    pub fn prepare(&mut self, progress: &dyn Progress) -> Result<()> {
        self.library_mut().map_or(Ok(()), |library| library.prepare(progress))
    }

    /// The image on the main detector: see [`RegionImager::images_of`].
    ///
    /// # Errors
    /// As [`RegionImager::images_of`].
    pub fn mean_of(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        let mut images = self.images_of(pixels, DetectorChoice::Main, configurations, progress)?;
        Ok(images.swap_remove(0))
    }

    /// The images on all detectors: see [`RegionImager::images_of`].
    ///
    /// # Errors
    /// As [`RegionImager::images_of`].
    pub fn means_of(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        self.images_of(pixels, DetectorChoice::All, configurations, progress)
    }

    /// What the image of such pixels takes, in units of like cost: for progress.
    pub fn work(&self, pixels: &PixelRect) -> usize {
        self.blocks().map_or(pixels.shape[0] * pixels.shape[1], |blocks| blocks.work(pixels))
    }
}
