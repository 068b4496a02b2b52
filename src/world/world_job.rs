//! The work of a build: image sub-tile by sub-tile, then the file.

use std::path::Path;
use std::sync::Arc;

use ndarray::Array2;
use rayon::prelude::*;

use super::blended_image::BlendedImage;
use super::build_options::BuildOptions;
use super::build_summary::BuildSummary;
use super::field_scan::FieldScan;
use super::subtile_store::SubtileStore;
use super::subtiles::{Partition, SubTile};
use super::truth::{self, Counts};
use crate::detect::shown_images;
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::imaging::{Audit, PixelRect, RegionImager};
use crate::io::{Header, WorldFile, WorldWriter};
use crate::numerics::NUMERICS_VERSION;
use crate::progress::{Progress, ProgressShare};
use crate::recipe::{CheckedRecipe, DetectorTables};
use crate::specimen::Specimen;

/// Number of sub-tiles that each thread makes between two times of storing them, where sub-tiles may be made side by side.
const SIDE_BY_SIDE: usize = 4;

/// The recipe, specimen and options of a build, and its partition into sub-tiles.
pub struct BuildLayout {
    pub recipe: CheckedRecipe,
    /// The recipe that images are made of: the recipe of the world, with its pixels divided into `parts` x `parts` where a recording needs
    /// finer pixels.
    pub imaged: CheckedRecipe,
    pub parts: usize,
    pub specimen: Arc<dyn Specimen>,
    pub options: BuildOptions,
    pub partition: Partition,
}

/// One build, with its imager.
pub struct Job<'a> {
    pub layout: &'a BuildLayout,
    pub imager: &'a dyn RegionImager,
    pub audit: Option<Audit>,
    pub progress: &'a dyn Progress,
}

impl Job<'_> {
    /// Describes all settings that decide the image of a sub-tile.
    pub fn key(&self) -> String {
        let key = serde_json::json!({
            "numerics": NUMERICS_VERSION,
            "recipe": self.layout.recipe.to_toml(),
            "engine": self.imager.facts().name,
            "parameters": self.imager.facts().parameters,
            "partition": format!("{:?}", self.layout.partition),
        });
        key.to_string()
    }

    /// Makes the missing images; returns the number of sub-tiles that an earlier run had made.
    pub fn simulate(&self, store: &SubtileStore) -> Result<usize> {
        let [_, resumed] = self.simulate_part(store, Shard::WHOLE)?;
        Ok(resumed)
    }

    /// Makes the missing sub-tiles of one of several processes; returns the number of its sub-tiles, and how many of them were made before.
    pub fn simulate_part(&self, store: &SubtileStore, shard: Shard) -> Result<[usize; 2]> {
        let partition = &self.layout.partition;
        let tiles: Vec<SubTile> = partition.subtiles().filter(|t| shard.does(t.index)).collect();
        let work: Vec<usize> = tiles.iter().map(|t| self.imager.work(&self.pixels(t))).collect();
        let [stage, unit] = self.imager.facts().stage;
        self.progress.start(stage, unit, work.iter().sum::<usize>() as u64);
        // Memory for one sub-tile at a time is what other imagers are planned with.
        let at_once = match self.imager.facts().side_by_side {
            true => SIDE_BY_SIDE * rayon::current_num_threads(),
            false => 1,
        };
        let mut resumed = 0;
        for (tiles, work) in tiles.chunks(at_once).zip(work.chunks(at_once)) {
            let shares: Vec<_> =
                work.iter().map(|work| ProgressShare::new(self.progress, *work)).collect();
            let parts = tiles.par_iter().zip(&shares);
            let images = parts.map(|(tile, share)| self.made(store, tile, share));
            let images: Vec<Result<Option<Array2<f32>>>> = images.collect();
            let mut outcome = Ok(());
            // Stored in order and by one thread, so that a run that is ended leaves the first ones.
            for ((tile, share), image) in tiles.iter().zip(&shares).zip(images) {
                match image {
                    Ok(Some(image)) => {
                        store.save(tile.index, &image)?;
                        share.complete();
                    }
                    Ok(None) => {
                        resumed += 1;
                        share.found();
                    }
                    // The others are stored before the first error ends the run.
                    Err(e) => outcome = outcome.and(Err(e)),
                }
            }
            outcome?;
        }
        self.progress.finish();
        Ok([tiles.len(), resumed])
    }

    /// Makes a sub-tile; `None` if it is stored already.
    fn made(
        &self,
        store: &SubtileStore,
        tile: &SubTile,
        progress: &dyn Progress,
    ) -> Result<Option<Array2<f32>>> {
        if self.progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let shape = tile.stored_shape(self.layout.recipe.detector.measured().len());
        match store.load(tile.index, shape, self.progress) {
            Some(_) => Ok(None),
            None => self.simulate_one(tile, progress).map(Some),
        }
    }

    /// The pixels of a sub-tile in the full field.
    fn pixels(&self, tile: &SubTile) -> PixelRect {
        let first = self.layout.imaged.field.crop_origin_px();
        let first = [first[0] + tile.rows.start, first[1] + tile.columns.start];
        PixelRect::new(first, tile.shape())
    }

    /// Simulates the images of a sub-tile on all detectors, one below the other.
    fn simulate_one(&self, tile: &SubTile, progress: &dyn Progress) -> Result<Array2<f32>> {
        let configurations = self.layout.recipe.phonons.configurations.max(1);
        let images = self.imager.means_of(&self.pixels(tile), configurations, progress)?;
        let expected = self.layout.recipe.detector.measured().len();
        if images.len() != expected || images.iter().any(|i| i.shape() != tile.shape()) {
            let shapes: Vec<&[usize]> = images.iter().map(|i| i.shape()).collect();
            let expected = format!("the imager was asked for {expected} of {:?}", tile.shape());
            let setting = crate::Setting::EngineImageShape;
            return Err(Error::invalid(setting, format!("{shapes:?}"), expected));
        }
        match images.iter().flatten().find(|v| !v.is_finite()) {
            Some(bad) => {
                let place = format!("sub-tile {} of {}", tile.index, self.imager.facts().name);
                Err(Error::invalid(
                    crate::Setting::Intensity,
                    bad,
                    format!("{place}: must be finite"),
                ))
            }
            None => {
                let values = images.iter().flatten().map(|v| *v as f32).collect();
                let shape = tile.stored_shape(images.len());
                Ok(Array2::from_shape_vec(shape, values).unwrap_or_default())
            }
        }
    }

    /// Writes the file from the sub-tiles and reads it back; returns the counts of the truth, and the least and greatest value.
    pub fn write_file(&self, path: &Path, store: &SubtileStore) -> Result<(Counts, [f32; 2])> {
        let BuildLayout { recipe, options, partition, parts, .. } = self.layout;
        let scan = FieldScan::of(recipe)?;
        let image =
            BlendedImage::new(recipe, (partition, *parts), store, options.noise, scan.as_ref());
        let keep_clean = options.keep_clean;
        let mut writer = WorldWriter::create(path, &self.header(), keep_clean)?;
        let range = image.range(self.progress)?;
        image.write(&writer, &range, keep_clean, self.progress)?;
        let limits = range.limits;
        drop(range);
        let shown = shown_images(&recipe.detector.measured());
        for (number, shown) in shown.into_iter().enumerate().skip(1) {
            writer.next_detector(number, keep_clean)?;
            let image = image.of_detector(shown);
            image.write(&writer, &image.range(self.progress)?, keep_clean, self.progress)?;
        }
        if let Some(scan) = &scan {
            writer.recorded(scan.acquisition(), scan.exposure(), scan.counts_of_fraction())?;
        }
        let counts = truth::write(
            &*self.layout.specimen,
            &self.layout.recipe.field,
            &writer,
            scan.as_ref().map(FieldScan::path),
            self.progress,
        )?;
        writer.finish()?;
        verify(path, counts)?;
        Ok((counts, limits))
    }

    /// Summarises the build; the time is not known yet.
    pub fn summary(
        &self,
        output: &Path,
        resumed: usize,
        counts: Counts,
        range: [f32; 2],
    ) -> BuildSummary {
        let BuildLayout { recipe, partition, .. } = self.layout;
        let field = &recipe.field;
        BuildSummary {
            path: output.to_owned(),
            grid: field.built_grid(),
            fov_nm: field.pixels(field.built_grid()).map(|n| n as f64 * field.pixel_nm()),
            counts,
            engine: self.imager.facts().name.to_owned(),
            audit: self.audit.clone(),
            library: self.imager.facts().library,
            subtiles: partition.len(),
            subtiles_resumed: resumed,
            range,
            wall_time_s: 0.0,
        }
    }

    fn header(&self) -> Header {
        let recipe = &self.layout.recipe;
        let field = &recipe.field;
        let shape = field.pixels(field.built_grid());
        let mut texts = vec![
            ("material", recipe.id.clone()),
            ("zone_axis", recipe.zone_axis.clone()),
            ("recipe", recipe.to_toml()),
            ("stemgen_version", env!("CARGO_PKG_VERSION").into()),
            ("numerics_version", NUMERICS_VERSION.to_string()),
            ("engine", self.imager.facts().name.to_owned()),
            ("engine_parameters", self.imager.facts().parameters.to_string()),
        ];
        let audit = self.audit.as_ref().and_then(|a| serde_json::to_string(a).ok());
        texts.extend(audit.map(|audit| ("audit", audit)));
        texts.extend(recipe.source.iter().map(|source| ("source", source.clone())));
        Header {
            pixel_size_nm: field.pixel_nm(),
            tile_size_px: field.tile_px,
            overlap_px: field.overlap_px,
            grid_shape: field.built_grid(),
            fov_nm: shape.map(|n| n as f64 * field.pixel_nm()),
            origin_px: field.crop_origin_px(),
            thickness_nm: Some(self.layout.specimen.facts().thickness_nm),
            dose: Some(recipe.dose.electrons_per_angstrom2),
            noise: Some(self.layout.options.noise),
            seed: Some(recipe.seed),
            subtile_nm: self.layout.options.policy(recipe).ok().map(|policy| policy.subtile_nm),
            detectors: match &recipe.detector {
                DetectorTables::One(_) => Vec::new(),
                several => several.all(),
            },
            texts,
            numbers: Vec::new(),
        }
    }
}

/// Reads back every tile to find a write that failed without an error.
fn verify(path: &Path, counts: Counts) -> Result<()> {
    let world = WorldFile::open(path)?;
    let others = world.detectors().iter().skip(1).map(|d| world.on_detector(&d.name));
    let others = others.collect::<Result<Vec<_>>>()?;
    for world in std::iter::once(&world).chain(&others) {
        let [rows, columns] = world.metadata().grid_shape;
        let read = |n: usize| {
            let (row, column) = (n / columns, n % columns);
            world.tile(row, column)?;
            if world.has_clean() {
                world.clean_tile(row, column)?;
            }
            Ok(())
        };
        // All threads unpack tiles; of several errors, the first tile's is given.
        let tiles = (0..rows * columns).into_par_iter().map(read);
        tiles.find_first(Result::is_err).unwrap_or(Ok(()))?;
    }
    let found = world.site_count()? as u64;
    match found == counts.sites {
        true => Ok(()),
        false => Err(Error::invalid(
            crate::Setting::SitesInFile,
            found,
            format!("{} written", counts.sites),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::Cache;
    use crate::progress::Silent;
    use crate::world::build;

    #[test]
    fn lost_tiles_are_noticed_clean_ones_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.h5");
        let tiny = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/tiny.toml"));
        let recipe = CheckedRecipe::from_file(tiny, None).unwrap();
        let options = BuildOptions { cache: Cache::none(), keep_clean: true, ..Default::default() };
        let done = build(&recipe, &path, &options, &Silent).unwrap();
        verify(&path, done.counts).unwrap();
        let counts = Counts { sites: done.counts.sites + 1, ..done.counts };
        assert!(verify(&path, counts).is_err());
        let file = hdf5::File::append(&path).unwrap();
        file.group("clean").unwrap().unlink("1_0").unwrap();
        drop(file);
        assert!(verify(&path, done.counts).is_err());
    }
}
