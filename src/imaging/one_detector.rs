//! One detector of an imager that has several, in the place of the main one.

use std::path::Path;

use ndarray::Array2;

use super::displaced_atoms::DisplacedAtoms;
use super::pixels::PixelRect;
use super::region_imager::{RegionImager, told_by_inner};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::progress::Progress;
use crate::recipe::{Recipe, Region};
use crate::setting::Setting;

/// See the module.
pub struct OneDetector {
    inner: Box<dyn RegionImager>,
    number: usize,
}

impl OneDetector {
    /// The images of the recipe's detector `name`, of which `inner` makes all.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the detectors that there are.
    pub fn named(name: &str, recipe: &Recipe, inner: Box<dyn RegionImager>) -> Result<Self> {
        let detectors = recipe.detector.all();
        let number = detectors.iter().position(|d| d.name == name);
        match number.filter(|n| *n < inner.detectors()) {
            Some(number) => Ok(OneDetector { inner, number }),
            None => {
                let names: Vec<&str> = detectors.iter().map(|d| d.name.as_str()).collect();
                let expected = format!("the recipe has {}", names.join(", "));
                Err(Error::invalid(Setting::DetectorName, name, expected))
            }
        }
    }
}

impl RegionImager for OneDetector {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn parameters(&self) -> serde_json::Value {
        let mut parameters = self.inner.parameters();
        parameters["detector"] = self.number.into();
        parameters
    }

    fn keep_in(&mut self, folder: &Path) {
        self.inner.keep_in(folder);
    }

    fn prepare(&mut self, progress: &dyn Progress) -> Result<()> {
        self.inner.prepare(progress)
    }

    fn prepare_part(&mut self, shard: Shard, progress: &dyn Progress) -> Result<usize> {
        self.inner.prepare_part(shard, progress)
    }

    fn mean_of(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        Ok(self.inner.means_of(pixels, configurations, progress)?.swap_remove(self.number))
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        self.inner.atoms(area, configuration)
    }

    fn shown_area(&self, pixels: &PixelRect) -> Option<Region> {
        self.inner.shown_area(pixels)
    }

    told_by_inner!();
}
