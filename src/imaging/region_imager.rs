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

/// In the implementation of an imager around another one, its field `inner`: what it tells as that one does.
macro_rules! told_by_inner {
    () => {
        fn cost(
            &self,
            subtile: [usize; 2],
            subtiles: usize,
        ) -> $crate::Result<$crate::imaging::ImagingCost> {
            self.inner.cost(subtile, subtiles)
        }

        fn stage(&self) -> [&'static str; 2] {
            self.inner.stage()
        }

        fn work(&self, pixels: &$crate::imaging::PixelRect) -> usize {
            self.inner.work(pixels)
        }

        fn window_angstrom(&self) -> Option<f64> {
            self.inner.window_angstrom()
        }

        fn library(&self) -> Option<[usize; 2]> {
            self.inner.library()
        }

        fn doubt(&self, area: &$crate::recipe::Region) {
            self.inner.doubt(area);
        }
    };
}
pub(crate) use told_by_inner;

/// Makes the noise-free image of any rectangle of one field.
///
/// Pixels that two rectangles share are the same in both, up to the error that the imager states: a field can be made
/// piece by piece, in any order.
pub trait RegionImager: Send + Sync {
    /// Name of the method, as world files give it: `mosaic`, `film`, `window`, `prism`, `multislice`.
    fn name(&self) -> &'static str;

    /// Settings that decide the image. A build goes on from an earlier one only under the same.
    fn parameters(&self) -> serde_json::Value;

    /// Has [`RegionImager::prepare`] keep its simulations in a folder where it keeps them nowhere else, for the same build to go on
    /// from. The folder is made when first written to.
    fn keep_in(&mut self, _folder: &Path) {}

    /// Does what all images share, such as filling a library of simulations. Has to be called before
    /// [`RegionImager::mean_of`]; a second call does nothing.
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn prepare(&mut self, _progress: &dyn Progress) -> Result<()> {
        Ok(())
    }

    /// Does a part of what [`RegionImager::prepare`] does, for other processes to find where this one keeps it. Returns how many things
    /// the parts of others still lack.
    ///
    /// # Errors
    /// Those of the engine, [`crate::Error::Interrupted`], and those of files: what is not kept is lost.
    fn prepare_part(&mut self, _shard: Shard, _progress: &dyn Progress) -> Result<usize> {
        Ok(0)
    }

    /// The noise-free image of the pixels on the main detector, [row, column] = [y, x] of shape [`PixelRect::sampled_shape`], as
    /// fraction of the beam: the mean over the first `configurations` phonon configurations.
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn mean_of(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>>;

    /// How many images [`RegionImager::means_of`] makes: one for each detector.
    fn detectors(&self) -> usize {
        1
    }

    /// The noise-free images on all detectors, in the order of the recipe: [`RegionImager::mean_of`] gives the first of them. They
    /// come from the same simulation of the same atoms.
    ///
    /// # Errors
    /// As [`RegionImager::mean_of`].
    fn means_of(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        Ok(vec![self.mean_of(pixels, configurations, progress)?])
    }

    /// The noise-free image at the places of a raster, [row, column], as fraction of the beam, as [`RegionImager::mean_of`] has it at
    /// pixels: interpolated once, from the probes that were simulated. `None` of imagers that have none of their own; see
    /// [`turned_image`](super::turned_raster::turned_image).
    ///
    /// # Errors
    /// Those of the engine, and [`crate::Error::Interrupted`].
    fn image_at(
        &self,
        _raster: &TurnedRaster,
        _configurations: usize,
        _progress: &dyn Progress,
    ) -> Result<Option<Array2<f64>>> {
        Ok(None)
    }

    /// As [`RegionImager::image_at`], for an overview, whose pixels are wider than a column: columns that only a simulation of their own
    /// would show may look like others nearby, and pixels may show the mean of their area.
    ///
    /// # Errors
    /// As [`RegionImager::image_at`].
    fn overview_at(
        &self,
        raster: &TurnedRaster,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Array2<f64>>> {
        self.image_at(raster, configurations, progress)
    }

    /// The displaced atoms of an area (nm of the full field) in one phonon configuration: those that the image shows.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms;

    /// What making a field takes, of which each of `subtiles` parts has `subtile` (rows, columns) pixels. Nothing is simulated.
    ///
    /// # Errors
    /// Those of the plan.
    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost>;

    /// What progress calls the work of [`RegionImager::mean_of`], and its unit.
    fn stage(&self) -> [&'static str; 2] {
        ["assembling", "pixel"]
    }

    /// What the image of such pixels takes, in units of like cost: for progress.
    fn work(&self, pixels: &PixelRect) -> usize {
        pixels.shape[0] * pixels.shape[1]
    }

    /// Width in Angstrom of the windows that follow the probe, where there are any.
    fn window_angstrom(&self) -> Option<f64> {
        None
    }

    /// Images of the library that it draws on, and how many of them had to be simulated.
    fn library(&self) -> Option<[usize; 2]> {
        None
    }

    /// The area (nm of the full field) of all atoms that have a part in the image of some pixels, of imagers that make blocks of a field
    /// as a whole; `None` of those whose pixels show what is within a window of them.
    fn shown_area(&self, _pixels: &PixelRect) -> Option<Region> {
        None
    }

    /// Tells that atoms of an area (nm of the full field) may be others than they were: blocks that were kept and show any are made again
    /// where that is so.
    fn doubt(&self, _area: &Region) {}
}
