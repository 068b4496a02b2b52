//! Images of a field in cached blocks, which are kept until the specimen there changes.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ndarray::{Array2, s};

use crate::error::Result;
use crate::imaging::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, SharedLibrary,
};
use crate::imaging::source_imager::margin_px;
use crate::imaging::{DisplacedAtoms, ImagingCost, PixelRect, RegionImager, TurnedRaster};
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{CheckedRecipe, Region};
use crate::specimen::{DamagedSpecimen, Specimen};

/// Edge of a block in pixels.
const BLOCK_PX: usize = 64;
/// Distance in nm beyond a block's edge up to which atoms can affect it: more than half a window of a probe.
const REACH_NM: f64 = 1.2;

/// Distance in nm beyond the exposed area up to which atoms may have changed. Doses are counted in cells, and a column's dose is the dose
/// at its middle.
const EDGE_NM: f64 = 0.2;

/// An imager that caches the blocks that it has made.
pub struct BlockImager {
    inner: Box<dyn RegionImager>,
    recipe: CheckedRecipe,
    specimen: Arc<DamagedSpecimen>,
    /// The detectors whose images are made.
    detectors: DetectorChoice,
    /// Largest number of cached blocks.
    most: usize,
    reach_nm: f64,
    /// Pixels around an image that the blur of the source needs.
    margin_px: usize,
    kept: Mutex<ImagedBlocks>,
}

#[derive(Default)]
struct ImagedBlocks {
    blocks: HashMap<[usize; 2], Block>,
    /// Regions in which the specimen may have changed, in the order of the exposures.
    exposed: Vec<Region>,
    clock: u64,
}

struct Block {
    /// The images of the measured detectors.
    images: Arc<Vec<Array2<f32>>>,
    /// Digest of the atoms that the block shows.
    contents: u64,
    /// Number of exposed regions that the image takes into account.
    seen: usize,
    used: u64,
}

impl BlockImager {
    /// Caches blocks of the images of `inner`, made from `recipe` and `specimen`, in about `bytes` bytes.
    pub fn new(
        inner: Box<dyn RegionImager>,
        recipe: &CheckedRecipe,
        specimen: &Arc<DamagedSpecimen>,
        bytes: usize,
    ) -> Result<Self> {
        let pixel_nm = recipe.field.pixel_nm();
        let blurred = |source| margin_px(source, recipe.field.pixel_angstrom());
        let margin_px = recipe.optics.source().map(blurred).transpose()?.unwrap_or(0);
        let images = inner.facts().detectors;
        Ok(BlockImager {
            detectors: if images > 1 { DetectorChoice::All } else { DetectorChoice::Main },
            inner,
            recipe: recipe.clone(),
            specimen: Arc::clone(specimen),
            most: (bytes / (4 * BLOCK_PX * BLOCK_PX * images)).max(16),
            reach_nm: REACH_NM + margin_px as f64 * pixel_nm,
            margin_px,
            kept: Mutex::default(),
        })
    }

    /// Records that the specimen may have changed in a region (nm of the full field).
    pub fn changed(&self, region: Region) {
        if self.specimen.is_lasting() {
            return;
        }
        let region = region.grown(EDGE_NM);
        if let Some(blocks) = self.inner.blocks() {
            blocks.mark_stale(&region);
        }
        self.kept().exposed.push(region);
    }

    /// Number of cached blocks.
    pub fn block_count(&self) -> usize {
        self.kept().blocks.len()
    }

    fn kept(&self) -> MutexGuard<'_, ImagedBlocks> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Pixels of a block.
    fn rect(&self, block: [usize; 2]) -> PixelRect {
        let full = self.recipe.field.pixels(self.recipe.field.grid);
        let first = block.map(|b| b * BLOCK_PX);
        PixelRect::new(first, plane::sub(full, first).map(|n| n.min(BLOCK_PX)))
    }

    /// Pixels with the margin that the blur of the source needs.
    fn with_margin(&self, pixels: &PixelRect) -> PixelRect {
        let first = pixels.first.map(|n| n.saturating_sub(self.margin_px));
        let end = plane::add(pixels.first, pixels.shape).map(|n| n + self.margin_px);
        PixelRect::new(first, plane::sub(end, first))
    }

    /// The area of pixels and everything within a window of them, in nm of the full field.
    fn around(&self, pixels: &PixelRect) -> Region {
        pixels.region(self.recipe.field.pixel_nm()).grown(self.reach_nm)
    }

    /// Hashes the columns and sites that a block shows.
    fn contents(&self, pixels: &PixelRect) -> u64 {
        let found = self.specimen.query(&self.around(pixels));
        let mut hasher = DefaultHasher::new();
        for column in &found.columns {
            column.id.hash(&mut hasher);
            column.unit.map(|unit| (unit.family, unit.entry)).hash(&mut hasher);
            for site in &found.sites[column.sites.clone()] {
                (site.kind as u8, site.number).hash(&mut hasher);
            }
        }
        hasher.finish()
    }

    /// The images of a block: from the cache if they are still valid, else made now.
    fn block(&self, block: [usize; 2], progress: &dyn Progress) -> Result<Arc<Vec<Array2<f32>>>> {
        let pixels = self.rect(block);
        let shown = self.inner.blocks().map(|own| own.shown_area(&self.with_margin(&pixels)));
        let area = shown.unwrap_or_else(|| self.around(&pixels));
        let mut kept = self.kept();
        kept.clock += 1;
        let (now, exposures) = (kept.clock, kept.exposed.len());
        let mut contents = None;
        if let Some(seen) = kept.blocks.get(&block).map(|b| b.seen) {
            let meets = kept.exposed[seen..].iter().any(|region| region.meets(&area));
            // An imager with cached blocks finds out which of them have changed.
            if meets && shown.is_none() {
                contents = Some(self.contents(&pixels));
            }
            let holds = |b: &&mut Block| match (meets, contents) {
                (true, contents) => contents == Some(b.contents),
                (false, _) => true,
            };
            if let Some(known) = kept.blocks.get_mut(&block).filter(holds) {
                (known.seen, known.used) = (exposures, now);
                return Ok(Arc::clone(&known.images));
            }
        }
        drop(kept);
        let all = self.recipe.phonons.configurations.max(1);
        let images = self.inner.images_of(&pixels, self.detectors, all, progress)?;
        let images = Arc::new(images.iter().map(|image| image.mapv(|v| v as f32)).collect());
        // The digest is not needed for a specimen that no dose changes, nor for an imager with cached blocks.
        let contents = match contents {
            Some(contents) => contents,
            None if shown.is_some() || self.specimen.is_lasting() => 0,
            None => self.contents(&pixels),
        };
        let made = Block { images: Arc::clone(&images), contents, seen: exposures, used: now };
        self.keep(block, made);
        Ok(images)
    }

    /// Puts a block into the cache. A full cache first drops the eighth of its blocks that was not used for the longest time.
    fn keep(&self, block: [usize; 2], made: Block) {
        let mut kept = self.kept();
        if kept.blocks.len() >= self.most {
            let mut ages: Vec<u64> = kept.blocks.values().map(|b| b.used).collect();
            ages.sort_unstable();
            let oldest = ages[ages.len() / 8];
            kept.blocks.retain(|_, b| b.used > oldest);
        }
        kept.blocks.insert(block, made);
    }
}

impl RegionImager for BlockImager {
    fn facts(&self) -> ImagerFacts {
        self.inner.facts()
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
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        if configurations != self.recipe.phonons.configurations.max(1) {
            return self.inner.images_of(pixels, detectors, configurations, progress);
        }
        let PixelRect { first, shape, .. } = *pixels;
        let count = match detectors {
            DetectorChoice::Main => 1,
            DetectorChoice::All => self.facts().detectors,
        };
        let mut images = vec![Array2::zeros(shape); count];
        let blocks = |k: usize| first[k] / BLOCK_PX..(first[k] + shape[k]).div_ceil(BLOCK_PX);
        for row in blocks(0) {
            for column in blocks(1) {
                let parts = self.block([row, column], progress)?;
                let start = [row, column].map(|b| b * BLOCK_PX);
                let low = plane::max(start, first);
                let end = plane::add(start, parts[0].dim().into());
                let high = plane::min(end, plane::add(first, shape));
                let own = |from: [usize; 2]| {
                    let range = |k: usize| low[k] - from[k]..high[k] - from[k];
                    [range(0), range(1)]
                };
                let ([to_rows, to_columns], [rows, columns]) = (own(first), own(start));
                for (image, part) in images.iter_mut().zip(&*parts) {
                    let from = part.slice(s![rows.clone(), columns.clone()]).mapv(f64::from);
                    image.slice_mut(s![to_rows.clone(), to_columns.clone()]).assign(&from);
                }
            }
        }
        Ok(images.into_iter().map(|image| pixels.sampled(image)).collect())
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
