//! Carbon that the beam deposits on the entrance face.
//!
//! The carbon is a film whose atoms are drawn once, up to the greatest thickness. Atoms up to the local thickness are there: the visible
//! ones stay where they are, and more are added on top. Their images are made as in [`super::surface_imager`].

use std::sync::Arc;

use ndarray::{Array2, s};

use super::film_blocks::{REACH_ANGSTROM, scattering_map};
use super::samples::Samples;
use crate::acquisition::SourceImage;
use crate::engine::single_scattering::SingleScattering;
use crate::engine::{Algorithm, Scan, Settings, Site, SourceBlur};
use crate::error::{Error, Result};
use crate::imaging::simulator::Simulator;
use crate::lengths;
use crate::models::carbon::carbon_film::Film;
use crate::models::carbon::network::CARBON;
use crate::plane;
use crate::recipe::{CheckedRecipe, Region};
use crate::resample::{Kernel, TAPS, image_band_limit};
use crate::rng::{Purpose, words};
use crate::setting::Setting;
use crate::specimen::{DoseMap, SurfaceLayers};

/// The thickest layer in Angstrom.
pub(crate) const MOST_GROWN_ANGSTROM: f64 = 60.0;
/// Distance in Angstrom from the specimen to its carbon, as for layers that are there from the beginning.
const CONTACT_ANGSTROM: f64 = 2.0;
/// Number of the random draw that seeds the film, and number of the layer.
const SEED: (u32, u64) = (16, 2);
/// A bit that is set in the keys of these atoms only.
const KEY: u64 = 1 << 60;
/// Standard deviation of the atoms' displacements in Angstrom, where the recipe has no other layers.
const SIGMA_ANGSTROM: f64 = 0.08;
/// Edge in samples of the blocks that are made at once.
const BLOCK: i64 = 256;

/// Carbon on the specimen of a recipe.
pub struct GrownCarbon {
    film: Film,
    settings: Settings,
    kernel: Arc<Kernel>,
    /// Distance of samples in Angstrom.
    step: f64,
    /// Distance in Angstrom from the specimen's entrance face to the first carbon.
    top_angstrom: f64,
    sigma_angstrom: f64,
    /// Seed and number of phonon configurations.
    which: (u64, usize),
    blur: Option<SourceBlur>,
}

/// The carbon of an area while it grows.
pub struct CarbonPatch<'a> {
    carbon: &'a GrownCarbon,
    samples: Samples,
    /// Samples (rows, columns) added at every edge for the size of the source.
    margin: [usize; 2],
    blocks: Vec<CarbonBlock>,
}

/// A block of the carbon's image.
struct CarbonBlock {
    index: [i64; 2],
    /// The corner (x, y) of the area of the block's atoms, in Angstrom.
    corner: [f64; 2],
    /// Atoms that are not deposited yet, the lowest first; z is their height above the face.
    coming: Vec<Site>,
    image: Array2<f64>,
}

impl GrownCarbon {
    /// Carbon on a specimen of this recipe and thickness, before any is deposited.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a detector that the direct beam reaches: independent scattering does not describe the direct beam.
    pub fn on(recipe: &CheckedRecipe, thickness_nm: f64) -> Result<Self> {
        let [detector, ..] = &recipe.detector.main_alone().all()[..] else {
            return Err(Error::invalid(Setting::Detector, "none", "expected one"));
        };
        let least = recipe.optics.convergence_mrad;
        if detector.inner_mrad <= least {
            let expected = format!(
                "contamination is added for detectors outside the direct beam only: expected an inner angle above {least} mrad"
            );
            return Err(Error::invalid(Setting::Detector, detector.inner_mrad, expected));
        }
        let algorithm = Algorithm::Window { width_angstrom: 7.8 };
        let settings = Simulator::new(recipe, algorithm).settings().clone();
        let band_limit = image_band_limit(&settings.optics);
        let step = Kernel::default_step(band_limit);
        let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom: [step; 2], shape: [1, 1] };
        let blur = recipe.optics.source().map(|s| SourceBlur::new(s, &scan, [f64::INFINITY; 2]));
        let layers = SurfaceLayers::of(recipe, thickness_nm);
        let before = layers.map_or(0.0, |layers| layers.before_angstrom());
        let [high, low, ..] = words(recipe.seed, Purpose::Carbon, SEED.0, SEED.1);
        Ok(GrownCarbon {
            film: Film::new(u64::from(high) << 32 | u64::from(low), MOST_GROWN_ANGSTROM),
            kernel: Arc::new(Kernel::new(step, band_limit)?),
            settings,
            step,
            top_angstrom: before.max(CONTACT_ANGSTROM),
            sigma_angstrom: recipe.surface.map_or(SIGMA_ANGSTROM, |t| t.sigma_angstrom),
            which: (recipe.seed, recipe.phonons.configurations.max(1)),
            blur: blur.transpose()?,
        })
    }

    /// The carbon of an area (nm of the full field), with none of it grown yet.
    pub fn patch(&self, area: &Region) -> CarbonPatch<'_> {
        let mut samples = Samples::around(area, self.step);
        samples.shape = samples.shape.map(|n| n.max(TAPS));
        let margin = self.blur.as_ref().map_or([0; 2], |blur| {
            let [x, y] = blur.margin();
            [y, x]
        });
        for k in 0..2 {
            samples.first[k] -= margin[k] as i64;
            samples.shape[k] += 2 * margin[k];
        }
        let blocks = samples.blocks(BLOCK).into_iter().map(|index| self.block(index)).collect();
        CarbonPatch { carbon: self, samples, margin, blocks }
    }

    /// Distance in samples up to which an atom adds to the image.
    fn reach(&self) -> usize {
        (REACH_ANGSTROM / self.step).ceil() as usize
    }

    fn block(&self, index: [i64; 2]) -> CarbonBlock {
        let margin = self.reach() as f64 * self.step;
        let Region { x, y } = Samples::block(index, BLOCK).region(self.step, margin);
        let [x, y] = lengths::angstrom([x, y]);
        let site = |atom: crate::models::carbon::carbon_film::FilmAtom| Site {
            position: atom.position,
            number: CARBON,
            sigma_angstrom: self.sigma_angstrom,
            anisotropy: None,
            key: KEY | atom.key,
        };
        let mut coming: Vec<Site> = self.film.atoms(&[x, y]).into_iter().map(site).collect();
        coming.sort_by(|a, b| a.position[2].total_cmp(&b.position[2]));
        let image = Array2::zeros([BLOCK as usize; 2]);
        CarbonBlock { index, corner: [x[0], y[0]], coming, image }
    }

    /// The intensity that some atoms of a block, at heights above the face, add to the block's image.
    fn image_of(&self, block: &CarbonBlock, atoms: &[Site]) -> Result<Array2<f64>> {
        let margin = self.reach();
        let raster =
            SingleScattering::new(&self.settings, self.step, [BLOCK as usize + 2 * margin; 2])?;
        let [x, y] = block.corner;
        let place = |site: &Site| {
            let [u, v, height] = site.position;
            Site { position: [u - x, v - y, -self.top_angstrom - height], ..*site }
        };
        let placed: Vec<Site> = atoms.iter().map(place).collect();
        let depths = placed.iter().map(|site| site.position[2]);
        let range = [depths.clone().fold(0.0, f64::min), depths.fold(f64::MIN, f64::max)];
        let map = scattering_map(&raster, &placed, (CARBON, range), self.which)?;
        let inner = margin..margin + BLOCK as usize;
        Ok(map.image(0.0).slice_move(s![inner.clone(), inner]))
    }
}

impl CarbonPatch<'_> {
    /// Deposits the atoms up to the local thickness, which `angstrom` maps. No atom is ever removed.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn grow(&mut self, angstrom: &DoseMap) -> Result<()> {
        for block in &mut self.blocks {
            let there = |site: &Site| {
                let [x, y, height] = site.position;
                height < angstrom.at(lengths::nm([x, y]))
            };
            let (new, coming): (Vec<Site>, Vec<Site>) =
                std::mem::take(&mut block.coming).into_iter().partition(there);
            block.coming = coming;
            if !new.is_empty() {
                let more = self.carbon.image_of(block, &new)?;
                block.image += &more;
            }
        }
        Ok(())
    }

    /// The image of the deposited carbon, as fraction of the beam.
    pub fn image(&self) -> SourceImage {
        let mut image = Array2::zeros(self.samples.shape);
        for block in &self.blocks {
            let place = Samples::block(block.index, BLOCK);
            let (rows, row) = self.samples.shared(&place, 0);
            let (columns, column) = self.samples.shared(&place, 1);
            let to = s![row..row + rows.len(), column..column + columns.len()];
            image.slice_mut(to).assign(&block.image.slice(s![rows, columns]));
        }
        if let Some(blur) = &self.carbon.blur {
            image = blur.blurred(image);
        }
        let step = self.carbon.step;
        let first = plane::swapped(plane::add(self.samples.first, self.margin.map(|n| n as i64)));
        SourceImage::with_kernel(
            image.mapv(|v| v as f32),
            lengths::nm(step),
            first.map(|n| 0.1 * n as f64 * step),
            self.carbon.kernel.clone(),
        )
    }
}
