//! Windowed simulations of particles and the film behind them, in blocks of the field's samples.
//!
//! Blocks lie at fixed places of the full field and are simulated as a whole, so that the image of a particle does not depend on the
//! requested rectangle.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use ndarray::Array2;

use super::block_cache::BlockCache;
use super::film_scene::FilmScene;
use super::samples::Samples;
use crate::engine::phonons::displaced;
use crate::engine::{Plan, PlannedScan, Scan, Site};
use crate::error::Result;
use crate::imaging::displaced_atoms::DisplacedAtoms;
use crate::imaging::pixels::PixelBox;
use crate::lengths;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::Region;
use crate::specimen::{ParticleOutline, outlines_in};

/// Probes are propagated up to half the window's width and this distance from atoms of particles, in Angstrom. Beyond, no window holds any.
const BEYOND_WINDOW_ANGSTROM: f64 = 1.0;
/// Width of the specimen around the window that its potentials need, in Angstrom.
const POTENTIAL_ANGSTROM: f64 = 1.5;
/// Thickness in Angstrom of the slices of the film behind particles. In an audit (7.8 A windows, 4 configurations, slices of 0.5 A in the
/// reference's film) bright columns were 0.33 % off with 2 A, and 0.34 % off with 1 A, which took a quarter more time.
pub const FILM_SLICE_ANGSTROM: f64 = 2.0;
/// Edge in samples of the blocks in which particles are simulated. Wider ones save work on potentials and need more memory.
const BLOCK: i64 = 64;
/// Number of probes of a whole block.
pub const BLOCK_PROBES: usize = (BLOCK * BLOCK) as usize;
/// Blocks that are kept for later rectangles: 64 kB each.
const KEPT: usize = 1024;

/// The image of a block.
pub struct BlockImage {
    /// The samples whose windows hold atoms of particles, or a rectangle around them.
    pub samples: Samples,
    /// The image at these samples, [row, column], as fraction of the beam.
    pub image: Array2<f64>,
    /// Weight of this image in the whole image: 1 where the window holds atoms of particles, falling to 0 where no block is made.
    pub share: Array2<f64>,
}

/// A block in the cache.
#[derive(Clone)]
struct KeptBlock {
    /// Digest of the atoms in and around the block.
    atoms: u64,
    /// `None` where windows hold no atoms of particles.
    image: Option<Arc<BlockImage>>,
}

/// Windowed simulations of particles, in blocks of samples.
pub struct ParticleBlocks {
    scene: Arc<FilmScene>,
    kept: BlockCache<KeptBlock>,
}

/// Hashes the keys and elements of atoms.
fn digest(atoms: &[Site]) -> u64 {
    let mut hasher = DefaultHasher::new();
    atoms.iter().for_each(|s| (s.key, s.number).hash(&mut hasher));
    hasher.finish()
}

impl ParticleBlocks {
    pub fn new(scene: &Arc<FilmScene>) -> Self {
        ParticleBlocks { scene: Arc::clone(scene), kept: BlockCache::new(KEPT) }
    }

    /// Distance from an atom of a particle, along x and y, up to which probes are propagated, in Angstrom.
    fn near(&self) -> f64 {
        0.5 * self.scene.window_angstrom + BEYOND_WINDOW_ANGSTROM
    }

    /// Approximate distance in nm from the centre of a particle up to which probes are propagated.
    pub fn reach_nm(&self, particle: &ParticleOutline) -> f64 {
        0.5 * particle.diameter_nm + lengths::nm(self.near())
    }

    /// Width of the specimen around the probes of a block, in Angstrom.
    fn margin(&self) -> f64 {
        self.near() + POTENTIAL_ANGSTROM
    }

    /// Number of probes that the particles of the built field need, for each configuration.
    pub fn particle_probes(&self) -> usize {
        let area = |p: &ParticleOutline| std::f64::consts::PI * self.reach_nm(p).powi(2);
        let particles = outlines_in(&*self.scene.specimen, &self.scene.recipe.field.built_region());
        let step_nm = lengths::nm(self.scene.step);
        (particles.iter().map(area).sum::<f64>() / (step_nm * step_nm)) as usize
    }

    /// Plans a block of samples in the middle of a particle whose height is the mean over the probes of all particles; `None` where there
    /// are no particles.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn block_plan(&self) -> Result<Option<PlannedScan>> {
        let mut particles = self.scene.specimen.facts().particle_outlines.clone();
        let moment = |n: i32| particles.iter().map(|p| p.diameter_nm.powi(n)).sum::<f64>();
        let mean = moment(3) / moment(2);
        let off = |p: &ParticleOutline| (p.diameter_nm - mean).abs();
        particles.sort_by(|a, b| off(a).total_cmp(&off(b)));
        let Some(particle) = particles.first() else { return Ok(None) };
        let half = 0.05 * BLOCK as f64 * self.scene.step + lengths::nm(self.margin());
        let [x, y] = particle.centre_nm.map(|at| [at - half, at + half]);
        let atoms = self.scene.atoms(&Region { x, y });
        let size = [20.0 * half, 20.0 * half, self.scene.specimen.facts().thickness_angstrom()];
        let plan = Plan::new(self.scene.simulator.settings(), size, &self.heights(&atoms))?;
        let scan = Scan {
            origin_angstrom: [self.margin(); 2],
            step_angstrom: [self.scene.step; 2],
            shape: [BLOCK as usize; 2],
        };
        Ok(Some(PlannedScan::new(plan, scan, Some(&atoms))))
    }

    /// The blocks that contain any of these samples.
    pub fn touching(samples: &Samples) -> Vec<[i64; 2]> {
        samples.blocks(BLOCK)
    }

    /// The area of the atoms of a block, in nm of the full field.
    fn area(&self, index: [i64; 2]) -> Region {
        Samples::block(index, BLOCK).region(self.scene.step, self.margin())
    }

    /// Marks the blocks with atoms in an area as stale. A stale block is simulated again if its atoms have changed.
    pub fn mark_stale(&self, area: &Region) {
        self.kept.mark_stale(|index| self.area(index).meets(area));
    }

    /// The image of a block in the mean over some configurations; `None` where its windows hold no atoms of particles.
    ///
    /// # Errors
    /// Errors of the engine, and [`crate::Error::Interrupted`].
    pub fn block(
        &self,
        index: [i64; 2],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Arc<BlockImage>>> {
        let atoms = || self.scene.atoms(&self.area(index));
        let make = || {
            let around = atoms();
            let image = self.simulated(index, &around, configurations, progress)?.map(Arc::new);
            Ok(KeptBlock { atoms: digest(&around), image })
        };
        let holds = |kept: &KeptBlock| kept.atoms == digest(&atoms());
        Ok(self.kept.get_unless_changed((index, configurations), holds, make)?.image)
    }

    fn simulated(
        &self,
        index: [i64; 2],
        around: &[Site],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Option<BlockImage>> {
        let whole = Samples::block(index, BLOCK);
        // Positions of the particles' atoms in samples (row, column) from the first of the block. Windows on the block may hold them.
        let particles: Vec<[f64; 2]> = around
            .iter()
            .filter(|s| !self.scene.film.holds(s.key))
            .map(|s| {
                // Row and column, from y and x.
                [1, 0].map(|k| (s.position[k] - self.margin()) / self.scene.step)
            })
            .collect();
        let Some(samples) = self.near_particles(&whole, &particles) else { return Ok(None) };
        let from = plane::sub(samples.first, whole.first).map(|n| n as f64);
        let moved: Vec<[f64; 2]> =
            particles.iter().map(|p| [p[0] - from[0], p[1] - from[1]]).collect();
        let share = self.share(&samples, &moved);
        let image = self.image(&samples, configurations, progress)?;
        Ok(Some(BlockImage { samples, image, share }))
    }

    /// Mean heights of atoms in Angstrom.
    fn heights(&self, atoms: &[Site]) -> Vec<f64> {
        self.scene.heights(atoms, FILM_SLICE_ANGSTROM)
    }

    /// The smallest rectangle in a block around the samples whose windows hold atoms of particles. `particles` holds the atoms' positions
    /// in samples (row, column) from the first of the block.
    fn near_particles(&self, block: &Samples, particles: &[[f64; 2]]) -> Option<Samples> {
        let reach = self.near() / self.scene.step;
        let mut rectangle: Option<[[i64; 2]; 2]> = None;
        for at in particles {
            let range = |k: usize| {
                let low = (at[k] - reach).ceil() as i64;
                let high = (at[k] + reach).floor() as i64;
                [low.max(0), high.min(block.shape[k] as i64 - 1)]
            };
            let own = [range(0), range(1)];
            if own.iter().any(|[low, high]| low > high) {
                continue;
            }
            let join = |a: [i64; 2], b: [i64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
            let all = rectangle.map_or(own, |r| [join(r[0], own[0]), join(r[1], own[1])]);
            rectangle = Some(all);
        }
        rectangle.map(|[rows, columns]| Samples {
            first: [block.first[0] + rows[0], block.first[1] + columns[0]],
            shape: [rows, columns].map(|[low, high]| (high - low + 1) as usize),
        })
    }

    /// The weights of [`BlockImage::share`]; `particles` holds positions in samples (row, column) from the first.
    fn share(&self, samples: &Samples, particles: &[[f64; 2]]) -> Array2<f64> {
        let mut distance = Array2::from_elem(samples.shape, f64::INFINITY);
        let reach = self.near() / self.scene.step;
        for at in particles {
            let range = |k: usize| {
                let low = (at[k] - reach).ceil().max(0.0) as usize;
                let high = (at[k] + reach).floor().min(samples.shape[k] as f64 - 1.0);
                low..(high + 1.0).max(0.0) as usize
            };
            for i in range(0) {
                for j in range(1) {
                    // Windows are square, so the distance is the larger of the two coordinates' distances.
                    let d =
                        (i as f64 - at[0]).abs().max((j as f64 - at[1]).abs()) * self.scene.step;
                    distance[[i, j]] = distance[[i, j]].min(d);
                }
            }
        }
        distance.mapv(|d| ((self.near() - d) / BEYOND_WINDOW_ANGSTROM).clamp(0.0, 1.0))
    }

    fn image(
        &self,
        samples: &Samples,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        let area = samples.region(self.scene.step, self.margin());
        let sites = self.scene.atoms(&area);
        let moved = |configuration: usize| {
            let site = |s: &Site| {
                let position = displaced(s, self.scene.recipe.seed, configuration as u32);
                Site { position, sigma_angstrom: 0.0, ..*s }
            };
            DisplacedAtoms {
                sites: sites.iter().map(site).collect(),
                heights: self.heights(&sites),
            }
        };
        let scan = Scan {
            origin_angstrom: [self.margin(); 2],
            step_angstrom: [self.scene.step; 2],
            shape: samples.shape,
        };
        let pixels =
            PixelBox::of_area(area, scan, self.scene.specimen.facts().thickness_angstrom());
        // Films are imaged on one detector.
        Ok(self.scene.simulator.means(&pixels, configurations, moved, progress)?.swap_remove(0))
    }
}
