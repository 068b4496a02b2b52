//! Images of atoms that scatter independently of each other: the film's atoms, and the particles' atoms outside the windows of probes.
//!
//! Blocks lie at fixed places of the full field and are made as a whole, so that an image does not depend on the requested rectangle.

use std::collections::BTreeSet;
use std::sync::Arc;

use ndarray::{Array2, s};
use rayon::prelude::*;

use super::block_cache::BlockCache;
use super::film_scene::FilmScene;
use super::samples::Samples;
use crate::engine::Site;
use crate::engine::phonons::displaced;
use crate::engine::single_scattering::{ScatteringMap, SingleScattering};
use crate::error::Result;
use crate::lengths;
use crate::recipe::Region;

/// Atoms further than this from a probe are left out, in Angstrom. At this distance from the edge of a particle of 4 nm, the particle adds
/// 2 % to the film's intensity.
pub const REACH_ANGSTROM: f64 = 30.0;
/// Edge in samples of the blocks.
const BLOCK: i64 = 256;
/// Blocks that are kept for later rectangles: 1 MB each.
const KEPT: usize = 64;

/// Images of independently scattering atoms, in blocks of samples.
pub struct FilmBlocks {
    scene: Arc<FilmScene>,
    kept: BlockCache<Arc<[Array2<f64>; 2]>>,
}

impl FilmBlocks {
    pub fn new(scene: &Arc<FilmScene>) -> Self {
        FilmBlocks { scene: Arc::clone(scene), kept: BlockCache::new(KEPT) }
    }

    /// Two images at some samples, [row, column], in the mean over some configurations. The first shows all atoms of the film, the second
    /// the film's atoms outside the windows of probes. The particles' atoms outside the windows are added to both.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn images(&self, samples: &Samples, configurations: usize) -> Result<[Array2<f64>; 2]> {
        let mut images = [Array2::zeros(samples.shape), Array2::zeros(samples.shape)];
        for index in samples.blocks(BLOCK) {
            let make = || Ok(Arc::new(self.block(index, configurations)?));
            let block = self.kept.get((index, configurations), make)?;
            let place = Samples::block(index, BLOCK);
            let (rows, row) = samples.shared(&place, 0);
            let (columns, column) = samples.shared(&place, 1);
            let to = s![row..row + rows.len(), column..column + columns.len()];
            for (image, part) in images.iter_mut().zip(&*block) {
                image.slice_mut(to).assign(&part.slice(s![rows.clone(), columns.clone()]));
            }
        }
        Ok(images)
    }

    /// The area of the atoms of a block, in nm of the full field.
    fn area(&self, index: [i64; 2]) -> Region {
        let step = self.scene.step;
        Samples::block(index, BLOCK).region(step, (REACH_ANGSTROM / step).ceil() * step)
    }

    /// The area of all atoms that add to the images at some samples, in nm of the full field.
    pub fn shown_area(&self, samples: &Samples) -> Region {
        let all = samples.blocks(BLOCK).into_iter().map(|index| self.area(index));
        let join = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        all.fold(Region { x: none, y: none }, |sum, own| Region {
            x: join(sum.x, own.x),
            y: join(sum.y, own.y),
        })
    }

    /// Marks the blocks with atoms in an area as stale, because these atoms may have changed.
    pub fn mark_stale(&self, area: &Region) {
        self.kept.mark_stale(|index| self.area(index).meets(area));
    }

    fn block(&self, index: [i64; 2], configurations: usize) -> Result<[Array2<f64>; 2]> {
        let scene = &self.scene;
        let margin = (REACH_ANGSTROM / scene.step).ceil();
        let region = self.area(index);
        let (film, particles): (Vec<Site>, Vec<Site>) =
            scene.atoms(&region).into_iter().partition(|s| scene.film.holds(s.key));
        let margin = margin as usize;
        let least = [BLOCK as usize + 2 * margin; 2];
        let raster = SingleScattering::new(scene.simulator.settings(), scene.step, least)?;
        let inner = margin..margin + BLOCK as usize;
        let image = |map: &ScatteringMap<'_>, beyond| {
            map.image(beyond).slice_move(s![inner.clone(), inner.clone()])
        };
        let outside = 0.5 * scene.window_angstrom;
        let depth = lengths::angstrom(scene.film.depth_nm);
        let which = (scene.recipe.seed, configurations);
        let of_film = scattering_map(&raster, &film, (scene.film.number, depth), which)?;
        let mut images = [image(&of_film, 0.0), image(&of_film, outside)];
        // Particles lie above the film.
        let above = [0.0, depth[0]];
        let numbers: BTreeSet<u8> = particles.iter().map(|s| s.number).collect();
        for number in numbers {
            let map = scattering_map(&raster, &particles, (number, above), which)?;
            let far = image(&map, outside);
            images.iter_mut().for_each(|sum| *sum += &far);
        }
        Ok(images)
    }
}

/// The scattering of the atoms of element `number`, in the mean over some configurations of a seed, on a raster.
pub fn scattering_map<'r>(
    raster: &'r SingleScattering<'r>,
    atoms: &[Site],
    (number, depth_angstrom): (u8, [f64; 2]),
    (seed, configurations): (u64, usize),
) -> Result<ScatteringMap<'r>> {
    let mut map = raster.map(number, depth_angstrom)?;
    for configuration in 0..configurations as u32 {
        let of = atoms.par_iter().filter(|s| s.number == number);
        let moved: Vec<[f64; 3]> = of.map(|s| displaced(s, seed, configuration)).collect();
        map.add(&moved, 1.0 / configurations as f64);
    }
    Ok(map)
}
