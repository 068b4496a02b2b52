//! The interface of all imagers: they make the image of any rectangle of a field.

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

/// Fixed properties of an imager. An imager around another one changes some of them.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagerFacts {
    /// Name of the method, as world files give it: `mosaic`, `film`, `window`, `prism`, `multislice`.
    pub name: &'static str,
    /// Settings that decide the image. An interrupted build is continued only with identical parameters.
    pub parameters: serde_json::Value,
    /// Number of images of each rectangle: one for each measured detector ([`crate::recipe::DetectorTables::measured`]).
    pub detectors: usize,
    /// Name of the work on an image in progress reports, and its unit.
    pub stage: [&'static str; 2],
    /// Width in Angstrom of the windows that follow the probe, for imagers with windows.
    pub window_angstrom: Option<f64>,
    /// Whether several rectangles may be made side by side: the work on one of them fills little memory, and not all processors all the time.
    pub side_by_side: bool,
    /// Number of images in the library, and how many of them were simulated; `None` for imagers without a library or before it is filled.
    pub library: Option<[usize; 2]>,
}

impl ImagerFacts {
    /// Properties of an imager of one detector without windows and library.
    pub fn new(name: &'static str, parameters: serde_json::Value) -> Self {
        ImagerFacts {
            name,
            parameters,
            detectors: 1,
            stage: ["assembling", "pixel"],
            window_angstrom: None,
            side_by_side: false,
            library: None,
        }
    }
}

/// The detectors whose images are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DetectorChoice {
    /// The main one.
    Main,
    /// All, in the order of the recipe.
    All,
}

/// Detail of an image at the places of a raster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RasterDetail {
    /// Interpolated once, from the simulated probes.
    Full,
    /// For an overview, whose pixels are wider than a column. Columns that the library lacks may look like similar columns nearby, and
    /// pixels may show the mean of their area.
    Overview,
}

/// A library of simulations that all images of an imager share.
pub trait SharedLibrary {
    /// Sets a folder for simulations that are stored nowhere else, so that a later run of this build can read them. The folder is made at
    /// the first write.
    fn keep_in(&mut self, folder: &Path);

    /// Fills the library; a second call does nothing.
    ///
    /// # Errors
    /// Errors of the engine, and [`crate::Error::Interrupted`].
    fn prepare(&mut self, progress: &dyn Progress) -> Result<()>;

    /// Does one process's part of [`SharedLibrary::prepare`] and stores it for the other processes. Returns the number of simulations that
    /// are missing in the parts of the others.
    ///
    /// # Errors
    /// Errors of the engine, [`crate::Error::Interrupted`], and errors of files: a simulation that is not stored is lost.
    fn prepare_part(&mut self, shard: Shard, progress: &dyn Progress) -> Result<usize>;
}

/// Cached blocks of a field. Some imagers make whole blocks and keep them.
pub trait ImageBlocks {
    /// The area (nm of the full field) of all atoms that add to the image of some pixels.
    fn shown_area(&self, pixels: &PixelRect) -> Region;

    /// Marks blocks that show atoms of an area (nm of the full field) as stale. A stale block is made again if its atoms have changed.
    fn mark_stale(&self, area: &Region);

    /// The work for the image of these pixels, in units of about equal time, for progress reports.
    fn work(&self, pixels: &PixelRect) -> usize;
}

/// Makes the noise-free image of any rectangle of one field.
///
/// Two rectangles agree in the pixels that they share, up to the error that the imager states. So a field can be made in pieces, in any
/// order. No method has a default: an imager around another one must decide about each.
pub trait RegionImager: Send + Sync {
    /// Fixed properties of the imager.
    fn facts(&self) -> ImagerFacts;

    /// The library that all images share, where there is one. It has to be filled before the first image is made.
    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary>;

    /// The cached blocks; `None` for imagers whose pixels show only atoms within a window.
    fn blocks(&self) -> Option<&dyn ImageBlocks>;

    /// The noise-free images of the pixels, [row, column] = [y, x] of shape [`PixelRect::sampled_shape`], as fraction of the beam: the mean
    /// over the first `configurations` phonon configurations. The images of several detectors come from one simulation of one set of atoms.
    ///
    /// # Errors
    /// Errors of the engine, and [`crate::Error::Interrupted`].
    fn images_of(
        &self,
        pixels: &PixelRect,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>>;

    /// The noise-free images at the places of a raster, [row, column], as fraction of the beam; overviews have the main one alone. `None` for
    /// imagers without a method for rasters: [`turned_image`](super::turned_raster::turned_image) then interpolates the pixels of the field.
    ///
    /// # Errors
    /// Errors of the engine, and [`crate::Error::Interrupted`].
    fn images_at(
        &self,
        raster: &TurnedRaster,
        detail: RasterDetail,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>>;

    /// The displaced atoms of an area (nm of the full field) in one phonon configuration, as the image shows them.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms;

    /// The cost of a field of `subtiles` parts, each of `subtile` (rows, columns) pixels. Nothing is simulated.
    ///
    /// # Errors
    /// Errors of [`crate::engine::Plan::new`].
    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost>;
}

/// Shorthands for common calls.
impl dyn RegionImager + '_ {
    /// Fills the library, if there is one, with [`SharedLibrary::prepare`].
    ///
    /// # Errors
    /// As [`SharedLibrary::prepare`].
    pub fn prepare(&mut self, progress: &dyn Progress) -> Result<()> {
        self.library_mut().map_or(Ok(()), |library| library.prepare(progress))
    }

    /// The image on the main detector, from [`RegionImager::images_of`].
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

    /// The images on all detectors, from [`RegionImager::images_of`].
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

    /// The work for the image of these pixels, in units of about equal time, for progress reports.
    pub fn work(&self, pixels: &PixelRect) -> usize {
        self.blocks().map_or(pixels.shape[0] * pixels.shape[1], |blocks| blocks.work(pixels))
    }
}
