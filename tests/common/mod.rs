//! A cheap imager for tests of worlds, and shorthands for recipes that are known to be right.
//!
//! Each test file uses a part of this.
#![allow(dead_code)]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use ndarray::Array2;
use stemgen::imaging::{
    DetectorChoice, DisplacedAtoms, ImageBlocks, ImagerFacts, ImagingCost, PixelBox, PixelRect,
    RasterDetail, RegionImager, SharedLibrary, TurnedRaster,
};
use stemgen::progress::Progress;
use stemgen::recipe::{CheckedRecipe, Recipe, Region};
use stemgen::specimen::{DISPLACED_NM, Specimen, SpecimenSite};
use stemgen::structure::Site;
use stemgen::world::{BuildOptions, BuildSummary, WorldBuild};
use stemgen::{Error, Result};

/// The specimen of a recipe that has yet to be checked.
pub fn specimen(recipe: &Recipe) -> Result<Arc<dyn Specimen>> {
    stemgen::specimen::specimen(&recipe.clone().checked()?)
}

/// What stands in for an engine: an image of atoms at their mean positions.
pub trait StandIn: Clone + Send + Sync + 'static {
    const NAME: &'static str;
    fn parameters(&self) -> serde_json::Value;
    fn image(&self, sites: &[Site], pixels: &PixelBox) -> Result<Array2<f64>>;
}

/// Builds a world with the stand-in for an engine.
pub fn build(
    recipe: &Recipe,
    engine: &impl StandIn,
    output: &Path,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<BuildSummary> {
    let recipe = recipe.clone().checked()?;
    let imager = |specimen: &Arc<dyn Specimen>| -> Result<Box<dyn RegionImager>> {
        let (specimen, recipe) = (Arc::clone(specimen), recipe.clone());
        Ok(Box::new(StandInImager { engine: engine.clone(), specimen, recipe }))
    };
    WorldBuild::with_imager(&recipe, options, imager)?.run(output, progress)
}

struct StandInImager<E> {
    engine: E,
    specimen: Arc<dyn Specimen>,
    recipe: CheckedRecipe,
}

impl<E: StandIn> RegionImager for StandInImager<E> {
    fn facts(&self) -> ImagerFacts {
        ImagerFacts::new(E::NAME, self.engine.parameters())
    }
    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        None
    }
    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        None
    }
    fn images_of(
        &self,
        pixels: &PixelRect,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let thickness = self.specimen.facts().thickness_nm;
        let pixels = PixelBox::new(pixels, self.recipe.field.pixel_nm(), 2.0, thickness);
        let area = pixels.area;
        let mut sites = self.specimen.sites(&area.grown(DISPLACED_NM));
        sites.retain(|s| area.contains([s.position_nm[0], s.position_nm[1]]));
        let corner = [area.x[0], area.y[0]];
        let atom = |s: &SpecimenSite| s.atom(corner, &self.recipe.phonons);
        let sites: Vec<Site> = sites.iter().filter_map(atom).collect();
        Ok(vec![self.engine.image(&sites, &pixels)?])
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
    fn atoms(&self, _: &Region, _: usize) -> DisplacedAtoms {
        DisplacedAtoms::default()
    }
    fn cost(&self, _: [usize; 2], _: usize) -> Result<ImagingCost> {
        unimplemented!("a stand-in costs nothing")
    }
}

/// Draws a Gaussian spot on every atom; the position along the beam plays no part.
#[derive(Clone)]
pub struct Spots {
    /// Sub-tiles after which it reports an interruption.
    pub until: usize,
    /// Sub-tiles made so far.
    pub done: Arc<AtomicUsize>,
    /// Width of a spot in Angstrom; a parameter of the imager.
    pub sigma: f64,
}

impl Spots {
    pub fn new() -> Self {
        Spots::until(usize::MAX)
    }
    pub fn until(until: usize) -> Self {
        Spots { until, done: Arc::default(), sigma: 0.4 }
    }
}

impl StandIn for Spots {
    const NAME: &'static str = "spots";
    fn parameters(&self) -> serde_json::Value {
        serde_json::json!({ "sigma_angstrom": self.sigma })
    }
    fn image(&self, sites: &[Site], pixels: &PixelBox) -> Result<Array2<f64>> {
        if self.done.fetch_add(1, Relaxed) >= self.until {
            return Err(Error::Interrupted);
        }
        let PixelBox { size_angstrom, scan, .. } = pixels;
        let mut image = Array2::<f64>::zeros(scan.shape);
        for site in sites {
            assert!((0..3).all(|k| (0.0..=size_angstrom[k]).contains(&site.position[k])));
            let strength = 1e-5 * f64::from(site.number).powf(1.7);
            let pixel =
                |k: usize| (site.position[k] - scan.origin_angstrom[k]) / scan.step_angstrom[k];
            let reach = (3.0 * self.sigma / scan.step_angstrom[0]).ceil();
            let range = |centre: f64, n: usize| {
                let clamp = |v: f64| v.clamp(0.0, n as f64) as usize;
                clamp((centre - reach).ceil())..clamp((centre + reach).floor() + 1.0)
            };
            let (cx, cy) = (pixel(0), pixel(1));
            for row in range(cy, scan.shape[0]) {
                for column in range(cx, scan.shape[1]) {
                    let (dx, dy) = (column as f64 - cx, row as f64 - cy);
                    let r = (dx * dx + dy * dy).sqrt() * scan.step_angstrom[0] / self.sigma;
                    image[(row, column)] += strength * (-0.5 * r * r).exp();
                }
            }
        }
        Ok(image)
    }
}
