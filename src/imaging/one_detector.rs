//! One detector of an imager with several, in place of the main one.

use ndarray::Array2;

use super::displaced_atoms::DisplacedAtoms;
use super::imaging_cost::ImagingCost;
use super::pixels::PixelRect;
use super::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
use super::turned_raster::TurnedRaster;
use crate::detect::shown_images;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::recipe::{Recipe, Region};
use crate::setting::Setting;

/// Shows one detector of another imager as the main one.
pub struct OneDetector {
    inner: Box<dyn RegionImager>,
    number: usize,
}

impl OneDetector {
    /// Selects the recipe's detector `name` from the images of `inner`, which makes all of them.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the names of the recipe's detectors that count electrons.
    pub fn named(name: &str, recipe: &Recipe, inner: Box<dyn RegionImager>) -> Result<Self> {
        let shown = shown_images(&recipe.detector.measured());
        let counted = || shown.iter().filter(|s| s.axis.is_none());
        let found = counted().find(|s| s.detector.name == name).map(|s| s.number);
        match found.filter(|n| *n < inner.facts().detectors) {
            Some(number) => Ok(OneDetector { inner, number }),
            None => {
                let names: Vec<&str> = counted().map(|s| s.detector.name.as_str()).collect();
                let expected = format!("the recipe has {}", names.join(", "));
                Err(Error::invalid(Setting::DetectorName, name, expected))
            }
        }
    }
}

impl RegionImager for OneDetector {
    fn facts(&self) -> ImagerFacts {
        let mut facts = ImagerFacts { detectors: 1, ..self.inner.facts() };
        facts.parameters["detector"] = self.number.into();
        facts
    }

    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        self.inner.library_mut()
    }

    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        self.inner.blocks()
    }

    fn images_of(
        &self,
        pixels: &PixelRect,
        _: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let mut all = self.inner.means_of(pixels, configurations, progress)?;
        Ok(vec![all.swap_remove(self.number)])
    }

    fn images_at(
        &self,
        _: &TurnedRaster,
        _: RasterDetail,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>> {
        Ok(None)
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        self.inner.atoms(area, configuration)
    }

    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        self.inner.cost(subtile, subtiles)
    }
}
