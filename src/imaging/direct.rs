//! Direct simulation: every rectangle is simulated with its own atoms.

use std::sync::Arc;

use ndarray::{Array2, s};

use super::displaced_atoms::{
    DisplacedAtoms, FrozenPhonons, displaced_by_seed, mean_atoms, with_layers,
};
use super::imaging_cost::{ImagingCost, SimulationRuns};
use super::pixels::{PixelBox, PixelRect};
use super::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
use super::simulator::Simulator;
use super::turned_raster::{SpecimenAround, TurnedRaster, between_probes};
use crate::engine::PlannedScan;
use crate::error::Result;
use crate::lengths;
use crate::plane;
use crate::progress::{Progress, ProgressShare};
use crate::recipe::{CheckedRecipe, Region};
use crate::resample::image_band_limit;
use crate::specimen::{Specimen, SurfaceLayers};

/// Edge in nm of the blocks in which the exact engine makes a rectangle. The time of a probe grows with the area of its cell.
const EXACT_BLOCK_NM: f64 = 1.0;

/// Simulates each rectangle with the atoms that lie there.
#[derive(Clone)]
pub struct DirectImager {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    layers: Option<Arc<SurfaceLayers>>,
    /// Its defocus is the recipe's, counted from the face of the specimen, also where a layer lies before it.
    simulator: Simulator,
}

impl DirectImager {
    /// An imager that simulates with `simulator`.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for windows that reach beyond the specimen.
    pub fn new(
        recipe: &CheckedRecipe,
        specimen: &Arc<dyn Specimen>,
        simulator: Simulator,
    ) -> Result<Self> {
        simulator.check_margin()?;
        let layers = SurfaceLayers::of(recipe, specimen.facts().thickness_nm).map(Arc::new);
        let before = layers.as_ref().map_or(0.0, |layers| layers.before_angstrom());
        let simulator = simulator.with_focus_deeper(before);
        let (recipe, specimen) = (recipe.clone(), Arc::clone(specimen));
        Ok(DirectImager { recipe, specimen, layers, simulator })
    }

    /// Rows and columns of the pixels that are simulated in one cell, for a rectangle of this shape.
    pub(crate) fn block(&self, shape: [usize; 2]) -> [usize; 2] {
        let most = (EXACT_BLOCK_NM / self.recipe.field.pixel_nm()).ceil() as usize;
        match self.simulator.is_exact() {
            true => shape.map(|n| n.div_ceil(n.div_ceil(most).max(1))),
            false => shape,
        }
    }

    /// Thickness in nm of the specimen with the layers on its faces.
    fn thickness_nm(&self) -> f64 {
        let specimen = self.specimen.facts().thickness_nm;
        self.layers.as_ref().map_or(specimen, |layers| layers.thickness_nm())
    }

    fn simulate(
        &self,
        pixels: &PixelRect,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let (margin, thickness) = (self.simulator.margin_angstrom(), self.thickness_nm());
        let pixels = PixelBox::new(pixels, self.recipe.field.pixel_nm(), margin, thickness);
        self.simulate_box(&pixels, configurations, progress)
    }

    fn simulate_box(
        &self,
        pixels: &PixelBox,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        if self.layers.is_some() {
            let atoms = |configuration| self.atoms(&pixels.area, configuration);
            return self.simulator.means(pixels, configurations, atoms, progress);
        }
        let simulator = self.simulator.with_configurations(configurations);
        let sites = mean_atoms(&*self.specimen, &pixels.area, &self.recipe.phonons);
        let images = simulator.images(&sites, pixels, progress)?;
        Ok(images.into_iter().map(|image| image.mapv(f64::from)).collect())
    }
}

/// Plans the simulation of a rectangle of `shape` (rows, columns) pixels somewhere in the built field.
///
/// # Errors
/// Errors of [`crate::engine::Plan::new`].
pub(crate) fn rectangle_plan(
    recipe: &CheckedRecipe,
    specimen: &dyn Specimen,
    simulator: &Simulator,
    [rows, columns]: [usize; 2],
    runs: usize,
) -> Result<(SimulationRuns, [f64; 2])> {
    let field = &recipe.field;
    let pixel = field.pixel_nm();
    let first = field.crop_origin_px();
    let mut somewhere = Region::of_pixels(first, [rows, columns], pixel);
    let heights = |region: &Region| -> Vec<f64> {
        specimen.sites(region).iter().map(|s| lengths::angstrom(s.position_nm[2])).collect()
    };
    let mut z = heights(&somewhere);
    if z.is_empty() {
        // Specimens with empty corners have atoms in the middle.
        let built = field.pixels(field.built_grid());
        let half = [built[0].saturating_sub(rows) / 2, built[1].saturating_sub(columns) / 2];
        somewhere = Region::of_pixels(plane::add(first, half), [rows, columns], pixel);
        z = heights(&somewhere);
    }
    let mut thickness = specimen.facts().thickness_angstrom();
    if let Some(layers) = SurfaceLayers::of(recipe, specimen.facts().thickness_nm) {
        for layer in layers.layers() {
            let heights = layer.atoms(&somewhere).into_iter().map(|s| s.position[2]);
            z.extend(heights.map(|z| layer.slice_height_angstrom(z)));
        }
        z.iter_mut().for_each(|z| *z += layers.before_angstrom());
        thickness = layers.thickness_angstrom();
    }
    let size = [columns, rows].map(|n| field.pixel_angstrom() * n as f64);
    let plan = simulator.plan(size, thickness, &z)?;
    let probes = simulator.probes(&plan, [rows, columns], field.pixel_angstrom())?;
    let scan = *probes.scan();
    Ok((SimulationRuns::new(PlannedScan::new(plan, scan, None), runs), scan.step_angstrom))
}

impl RegionImager for DirectImager {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts {
            detectors: self.simulator.detectors(),
            stage: ["simulating", "probe"],
            window_angstrom: self.simulator.window_angstrom(),
            ..ImagerFacts::new(self.simulator.name(), self.simulator.parameters())
        }
    }

    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        None
    }

    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        None
    }

    /// One simulation makes the images of all detectors.
    fn images_of(
        &self,
        pixels: &PixelRect,
        _: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let [rows, columns] = self.block(pixels.shape);
        if pixels.stride > 1 || [rows, columns] == pixels.shape {
            return self.simulate(pixels, configurations, progress);
        }
        let whole = Array2::zeros((pixels.shape[0], pixels.shape[1]));
        let mut images = vec![whole; self.simulator.detectors()];
        for y in (0..pixels.shape[0]).step_by(rows) {
            for x in (0..pixels.shape[1]).step_by(columns) {
                let shape = [rows.min(pixels.shape[0] - y), columns.min(pixels.shape[1] - x)];
                let block = PixelRect::new([pixels.first[0] + y, pixels.first[1] + x], shape);
                let share = ProgressShare::new(progress, shape[0] * shape[1] * configurations);
                let parts = self.simulate(&block, configurations, &share)?;
                share.complete();
                for (image, part) in images.iter_mut().zip(&parts) {
                    image.slice_mut(s![y..y + shape[0], x..x + shape[1]]).assign(part);
                }
            }
        }
        Ok(images)
    }

    fn images_at(
        &self,
        raster: &TurnedRaster,
        _: RasterDetail,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>> {
        let around = SpecimenAround {
            margin_angstrom: self.simulator.margin_angstrom(),
            thickness_nm: self.thickness_nm(),
        };
        let band_limit = image_band_limit(&self.simulator.settings().optics);
        let places = raster.places_angstrom();
        let all = between_probes(&places, band_limit, around, |pixels| {
            let mut images = self.simulate_box(pixels, configurations, progress)?;
            if detectors == DetectorChoice::Main {
                images.truncate(1);
            }
            Ok(images)
        })?;
        let image = |values| Array2::from_shape_vec(raster.shape, values).ok();
        Ok(all.into_iter().map(image).collect())
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        let which = FrozenPhonons { seed: self.recipe.seed, configuration };
        let atoms = displaced_by_seed(&*self.specimen, area, which, &self.recipe.phonons);
        let slope = self.simulator.settings().optics.slope();
        match &self.layers {
            Some(layers) => with_layers(layers, atoms, area, which, slope),
            None => atoms,
        }
    }

    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        let (main, probe_step_angstrom) =
            rectangle_plan(&self.recipe, &*self.specimen, &self.simulator, subtile, subtiles)?;
        Ok(ImagingCost {
            main,
            more: None,
            largest_block: None,
            probe_step_angstrom,
            image_bytes: 0,
            mosaic: None,
            particle_probes: None,
        })
    }
}
