//! Layers of carbon on the faces of a specimen, added to the image of the bare specimen.
//!
//! Atoms of a layer scatter independently of each other and of the specimen ([`crate::engine::single_scattering`]). Their intensities are
//! added to the image of the specimen. The effect of a layer before the specimen on the probe is left out.

use std::sync::Arc;

use ndarray::{Array2, s};

use super::block_cache::BlockCache;
use super::film_blocks::{REACH_ANGSTROM, scattering_map};
use super::samples::Samples;
use crate::detect::Detector;
use crate::engine::Settings;
use crate::engine::single_scattering::SingleScattering;
use crate::error::Result;
use crate::imaging::displaced_atoms::{DisplacedAtoms, FrozenPhonons, with_layers};
use crate::imaging::imaging_cost::ImagingCost;
use crate::imaging::pixels::PixelRect;
use crate::imaging::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
use crate::imaging::turned_raster::{ScannedSamples, TurnedRaster};
use crate::models::carbon::network::CARBON;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Region};
use crate::resample::{Edge, Kernel, image_band_limit};
use crate::specimen::{CarbonLayer, Specimen, SurfaceLayers};

/// Edge in samples of the blocks that are made at once.
const BLOCK: i64 = 256;
/// Blocks that are kept for later rectangles: half a MB each.
const KEPT: usize = 64;

/// Adds the images of surface layers to the images of another imager.
pub struct SurfaceImager {
    inner: Box<dyn RegionImager>,
    layers: SurfaceLayers,
    recipe: CheckedRecipe,
    settings: Settings,
    kernel: Kernel,
    /// Distance of samples in Angstrom.
    step: f64,
    kept: BlockCache<Arc<Array2<f64>>>,
}

impl SurfaceImager {
    /// Whether the layers of a recipe can be added to the image. They can where there are none, or on a single detector outside the direct
    /// beam: independent scattering does not describe any other.
    pub fn can_cover(recipe: &CheckedRecipe) -> bool {
        let detectors = recipe.detector.all();
        let dark = |d: &Detector| {
            d.inner_mrad > recipe.optics.convergence_mrad && d.sector_degrees.is_none()
        };
        recipe.surface.is_none() || (detectors.len() == 1 && detectors.iter().all(dark))
    }

    /// Adds the layers of the recipe to an imager, or returns it unchanged if there are none. `settings` are the engine's without layers.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn covering(
        inner: Box<dyn RegionImager>,
        recipe: &CheckedRecipe,
        specimen: &dyn Specimen,
        settings: &Settings,
    ) -> Result<Box<dyn RegionImager>> {
        let Some(layers) = SurfaceLayers::of(recipe, specimen.facts().thickness_nm) else {
            return Ok(inner);
        };
        let band_limit = image_band_limit(&settings.optics);
        let step = Kernel::default_step(band_limit);
        let kernel = Kernel::new(step, band_limit)?;
        let (recipe, settings) = (recipe.clone(), settings.clone());
        let kept = BlockCache::new(KEPT);
        Ok(Box::new(SurfaceImager { inner, layers, recipe, settings, kernel, step, kept }))
    }

    /// The image of the layers at some samples, in the mean over some configurations.
    fn layers_at(&self, samples: &Samples, configurations: usize) -> Result<Array2<f64>> {
        let mut image = Array2::zeros(samples.shape);
        for index in samples.blocks(BLOCK) {
            let make = || Ok(Arc::new(self.block(index, configurations)?));
            let block = self.kept.get((index, configurations), make)?;
            let place = Samples::block(index, BLOCK);
            let (rows, row) = samples.shared(&place, 0);
            let (columns, column) = samples.shared(&place, 1);
            let to = s![row..row + rows.len(), column..column + columns.len()];
            image.slice_mut(to).assign(&block.slice(s![rows, columns]));
        }
        Ok(image)
    }

    fn block(&self, index: [i64; 2], configurations: usize) -> Result<Array2<f64>> {
        let margin = (REACH_ANGSTROM / self.step).ceil();
        let region = Samples::block(index, BLOCK).region(self.step, margin * self.step);
        let margin = margin as usize;
        let least = [BLOCK as usize + 2 * margin; 2];
        let raster = SingleScattering::new(&self.settings, self.step, least)?;
        let inner = margin..margin + BLOCK as usize;
        let mut sum = Array2::zeros([BLOCK as usize; 2]);
        for layer in self.layers.layers() {
            let CarbonLayer { depth_angstrom, .. } = *layer;
            let which = (self.recipe.seed, configurations);
            let atoms = layer.atoms(&region);
            let map = scattering_map(&raster, &atoms, (CARBON, depth_angstrom), which)?;
            sum += &map.image(0.0).slice(s![inner.clone(), inner.clone()]);
        }
        Ok(sum)
    }
}

impl RegionImager for SurfaceImager {
    fn facts(&self) -> ImagerFacts {
        let mut facts = self.inner.facts();
        facts.parameters["surface"] = serde_json::json!({ "reach_angstrom": REACH_ANGSTROM });
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
        let image = self.inner.mean_of(pixels, configurations, progress)?;
        let PixelRect { first, shape, .. } = *pixels;
        let pixel = self.recipe.field.pixel_angstrom() / self.step;
        let samples = Samples::under(first, shape, pixel);
        let layers = self.layers_at(&samples, configurations)?;
        let at = plane::sub(first.map(|n| n as f64 * pixel), samples.first.map(|n| n as f64));
        let layers = self.kernel.raster(layers.view(), at, [pixel; 2], shape, [Edge::Open; 2]);
        Ok(vec![image + pixels.sampled(layers.mapv(|v| v.max(0.0)))])
    }

    /// Overviews show the layers in full detail too.
    fn images_at(
        &self,
        raster: &TurnedRaster,
        _: RasterDetail,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>> {
        let full = RasterDetail::Full;
        let Some(mut images) =
            self.inner.images_at(raster, full, detectors, configurations, progress)?
        else {
            return Ok(None);
        };
        let samples = Samples::around(&raster.region(), self.step);
        let first = plane::swapped(samples.first).map(|n| n as f64 * self.step);
        let values = self.layers_at(&samples, configurations)?;
        let layers = ScannedSamples { values, first, step: self.step };
        let layers = layers.at(&raster.places_angstrom(), &self.kernel);
        // Layers are added on a single detector only.
        let main = images.iter_mut().take(1).flat_map(|image| image.iter_mut());
        main.zip(layers).for_each(|(v, layer)| *v += layer.max(0.0));
        Ok(Some(images))
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        let atoms = self.inner.atoms(area, configuration);
        let which = FrozenPhonons { seed: self.recipe.seed, configuration };
        with_layers(&self.layers, atoms, area, which, self.settings.optics.slope())
    }

    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        self.inner.cost(subtile, subtiles)
    }
}
