//! Builds a world: image sub-tile by sub-tile, then the file.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use ndarray::Array2;

use super::blended_image::BlendedImage;
use super::build_options::{BuildOptions, BuildPolicy};
use super::footprint;
use super::subtile_store::{SubtileStore, beside};
use super::subtiles::{Partition, SubTile};
use super::truth::{self, Counts};
use crate::error::{Error, Result};
use crate::files::atomic_write::sync_folder;
use crate::files::outputs::check_outputs;
use crate::files::{OutputLock, disk_space};
use crate::imaging::direct::rectangle_plan;
use crate::imaging::{
    Audit, ImagingCost, MethodChoice, PixelRect, RegionImager, SimulationRuns, audit_cost,
};
use crate::io::{Header, WorldFile, WorldWriter};
use crate::numerics::NUMERICS_VERSION;
use crate::progress::{Progress, ProgressShare};
use crate::recipe::CheckedRecipe;
use crate::specimen::{Specimen, estimated_sites, specimen};

/// What was built.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BuildSummary {
    /// The file.
    pub path: PathBuf,
    /// Rows and columns of tiles.
    pub grid: [usize; 2],
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Lattice sites, vacancies and columns listed.
    pub counts: Counts,
    /// Name of the method.
    pub engine: String,
    /// The audit made before, if one was asked for.
    pub audit: Option<Audit>,
    /// Images of the mosaic's library, and how many of them had to be simulated.
    pub library: Option<[usize; 2]>,
    /// Sub-tiles in all.
    pub subtiles: usize,
    /// Sub-tiles that an earlier run had left.
    pub subtiles_resumed: usize,
    /// Least and greatest value of the stored image, in fractions of the beam.
    pub range: [f32; 2],
    /// Time of this run in s.
    pub wall_time_s: f64,
}

/// Builds the world of `recipe` into the file `output`, as `stemgen build` does. Finished sub-tiles are kept in the folder
/// `<output>.work` until the file is complete; a build that finds them goes on from there.
///
/// # Errors
/// [`Error::Invalid`] when `output` exists, [`Error::Locked`] when another process builds it,
/// [`Error::DiskSpace`] when there is no room for it, [`Error::Interrupted`] when asked to stop, and
/// those of the recipe, the engine, the file system and HDF5.
pub fn build(
    recipe: &CheckedRecipe,
    output: &Path,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<BuildSummary> {
    WorldBuild::new(recipe, options)?.run(output, progress)
}

/// A build that is laid out: what it takes can be asked before it runs.
pub struct WorldBuild {
    recipe: CheckedRecipe,
    specimen: Arc<dyn Specimen>,
    options: BuildOptions,
    policy: BuildPolicy,
    partition: Partition,
    /// An imager that takes the place of what the options choose.
    own: Option<Box<dyn RegionImager>>,
}

impl WorldBuild {
    /// Lays out the specimen and divides the field.
    ///
    /// # Errors
    /// Those of the options and the specimen.
    pub fn new(recipe: &CheckedRecipe, options: &BuildOptions) -> Result<Self> {
        WorldBuild::of_specimen(recipe, options, specimen(recipe)?)
    }

    /// A build whose images come from an imager of one's own; `imager` makes it for the specimen that was laid out.
    /// No audit is made.
    ///
    /// # Errors
    /// Those of the options, the specimen and `imager`.
    pub fn with_imager(
        recipe: &CheckedRecipe,
        options: &BuildOptions,
        imager: impl FnOnce(&Arc<dyn Specimen>) -> Result<Box<dyn RegionImager>>,
    ) -> Result<Self> {
        let mut build = WorldBuild::new(recipe, options)?;
        build.own = Some(imager(&build.specimen)?);
        Ok(build)
    }

    fn of_specimen(
        recipe: &CheckedRecipe,
        options: &BuildOptions,
        specimen: Arc<dyn Specimen>,
    ) -> Result<Self> {
        let policy = options.policy(recipe)?;
        let field = &recipe.field;
        let shape = field.pixels(field.built_grid());
        let [size, overlap] = policy.subtile_nm;
        let partition = Partition::new(shape, field.pixel_nm(), size, overlap)?;
        let (recipe, options) = (recipe.clone(), options.clone());
        Ok(WorldBuild { recipe, specimen, options, policy, partition, own: None })
    }

    /// The specimen.
    pub fn specimen(&self) -> &Arc<dyn Specimen> {
        &self.specimen
    }

    /// What the options come to.
    pub fn policy(&self) -> &BuildPolicy {
        &self.policy
    }

    /// Number of sub-tiles, and rows and columns of pixels of each.
    pub fn subtiles(&self) -> (usize, [usize; 2]) {
        let shape = self.partition.subtiles().next().map_or([1, 1], |t| t.shape());
        (self.partition.len(), shape)
    }

    /// The simulation of one sub-tile, and how far apart its probes are (x, y) in Angstrom.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn subtile_plan(&self) -> Result<(SimulationRuns, [f64; 2])> {
        let (count, shape) = self.subtiles();
        let simulator = &self.policy.imaging.simulator;
        rectangle_plan(&self.recipe, &*self.specimen, simulator, shape, count)
    }

    /// What making the image will take.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn cost(&self) -> Result<ImagingCost> {
        let (count, shape) = self.subtiles();
        match &self.own {
            Some(imager) => imager.cost(shape, count),
            None => self.policy.imaging.cost(&self.recipe, &self.specimen, shape, count),
        }
    }

    /// What the audit before the build takes, if there is one; `cost` is that of the image.
    ///
    /// # Errors
    /// Those of the plan.
    pub fn audit_cost(&self, cost: &ImagingCost) -> Result<Option<SimulationRuns>> {
        let BuildPolicy { imaging, check, .. } = &self.policy;
        let shares = cost.particle_probes.is_some() || cost.mosaic.as_ref().is_some_and(|m| m.pays);
        let audited = check.audit.as_ref().filter(|_| {
            let forced = imaging.method == MethodChoice::Mosaic || check.direct;
            self.own.is_none() && (shares || forced || check.max_error_percent.is_some())
        });
        audited.map(|options| audit_cost(&self.recipe, &*self.specimen, options)).transpose()
    }

    /// Bytes on disk that the build needs, sub-tiles included.
    pub fn disk_bytes(&self) -> u64 {
        let sites = estimated_sites(&*self.specimen, &self.recipe.field);
        footprint::world_bytes(&self.recipe.field, sites, self.options.keep_clean)
    }

    /// Builds; see [`build`].
    ///
    /// # Errors
    /// As [`build`].
    pub fn run(mut self, output: &Path, progress: &dyn Progress) -> Result<BuildSummary> {
        let started = Instant::now();
        check_outputs([output], [] as [&Path; 0], self.options.overwrite)?;
        try_partial(output)?;
        let _lock = OutputLock::hold(output)?;
        if !self.options.overwrite {
            SubtileStore::check_recipe(output, &self.recipe.to_toml())?;
        }
        let done = footprint::folder_bytes(&beside(output, ".work"));
        disk_space::check_space(output, self.disk_bytes().saturating_sub(done))?;
        let (imager, audit) = self.prepared_imager(progress)?;
        let library = imager.library();
        let job = Job { build: &self, imager: &*imager, audit, progress };
        let store = SubtileStore::open(output, &job.key(), self.options.overwrite, progress)?;
        let done = job.simulate(&store).and_then(|resumed| {
            let noise = self.options.noise;
            let image = BlendedImage::new(&self.recipe, &self.partition, &store, noise);
            Ok((resumed, job.publish(output, &image)?))
        });
        let (resumed, (counts, range)) = done.inspect_err(|_| {
            let kept = "keeps the sub-tiles done so far; the same command goes on from there";
            progress.warn(&format!("{} {kept}", store.folder().display()));
        })?;
        store.remove()?;
        let field = &self.recipe.field;
        let shape = field.pixels(field.built_grid());
        Ok(BuildSummary {
            path: output.to_owned(),
            grid: field.built_grid(),
            fov_nm: shape.map(|n| n as f64 * field.pixel_nm()),
            counts,
            engine: job.imager.name().to_owned(),
            audit: job.audit,
            library,
            subtiles: self.partition.len(),
            subtiles_resumed: resumed,
            range,
            wall_time_s: started.elapsed().as_secs_f64(),
        })
    }

    fn prepared_imager(
        &mut self,
        progress: &dyn Progress,
    ) -> Result<(Box<dyn RegionImager>, Option<Audit>)> {
        match self.own.take() {
            Some(mut imager) => {
                imager.prepare(progress)?;
                Ok((imager, None))
            }
            None => {
                let BuildPolicy { imaging, check, .. } = &self.policy;
                imaging.checked_imager(&self.recipe, &self.specimen, check, progress)
            }
        }
    }
}

/// Finds before any work what would keep the file from being written at the end: names that HDF5 does not take, names too long,
/// folders that may not be written.
fn try_partial(output: &Path) -> Result<()> {
    let partial = beside(output, ".partial");
    let tried = WorldWriter::try_file(&partial);
    // Whatever became of it: the reason of a failure matters more.
    let _ = fs::remove_file(&partial);
    tried
}

struct Job<'a> {
    build: &'a WorldBuild,
    imager: &'a dyn RegionImager,
    audit: Option<Audit>,
    progress: &'a dyn Progress,
}

impl Job<'_> {
    /// All that decides the image of a sub-tile.
    fn key(&self) -> String {
        let key = serde_json::json!({
            "numerics": NUMERICS_VERSION,
            "recipe": self.build.recipe.to_toml(),
            "engine": self.imager.name(),
            "parameters": self.imager.parameters(),
            "partition": format!("{:?}", self.build.partition),
        });
        key.to_string()
    }

    /// Makes the images that are missing; returns how many sub-tiles were there.
    fn simulate(&self, store: &SubtileStore) -> Result<usize> {
        let partition = &self.build.partition;
        let work: Vec<usize> =
            partition.subtiles().map(|t| self.imager.work(&self.pixels(&t))).collect();
        let [stage, unit] = self.imager.stage();
        self.progress.start(stage, unit, work.iter().sum::<usize>() as u64);
        let mut resumed = 0;
        for (tile, work) in partition.subtiles().zip(work) {
            if self.progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let share = ProgressShare::new(self.progress, work);
            if store.load(tile.index, tile.shape()).is_some() {
                resumed += 1;
                share.found();
            } else {
                store.save(tile.index, &self.simulate_one(&tile, &share)?)?;
                share.complete();
            }
        }
        self.progress.finish();
        Ok(resumed)
    }

    /// The pixels of a sub-tile in the full field.
    fn pixels(&self, tile: &SubTile) -> PixelRect {
        let first = self.build.recipe.field.crop_origin_px();
        let first = [first[0] + tile.rows.start, first[1] + tile.columns.start];
        PixelRect::new(first, tile.shape())
    }

    fn simulate_one(&self, tile: &SubTile, progress: &dyn Progress) -> Result<Array2<f32>> {
        let configurations = self.build.recipe.phonons.configurations.max(1);
        let image = self.imager.mean_of(&self.pixels(tile), configurations, progress)?;
        if image.shape() != tile.shape() {
            let expected = format!("the imager was asked for {:?}", tile.shape());
            return Err(Error::invalid(
                crate::Setting::EngineImageShape,
                format!("{:?}", image.shape()),
                expected,
            ));
        }
        match image.iter().find(|v| !v.is_finite()) {
            Some(bad) => {
                let place = format!("sub-tile {} of {}", tile.index, self.imager.name());
                Err(Error::invalid(
                    crate::Setting::Intensity,
                    bad,
                    format!("{place}: must be finite"),
                ))
            }
            None => Ok(image.mapv(|v| v as f32)),
        }
    }

    /// Writes the file under another name and puts it in place when it is complete.
    fn publish(&self, output: &Path, image: &BlendedImage) -> Result<(Counts, [f32; 2])> {
        let partial = beside(output, ".partial");
        let written = self.write_file(&partial, image).and_then(|written| {
            check_outputs([output], [] as [&Path; 0], self.build.options.overwrite)?;
            fs::rename(&partial, output).map_err(|e| Error::io(output, "write", e))?;
            sync_folder(output)?;
            Ok(written)
        });
        if written.is_err() {
            // What is there is of no use; the reason for the failure matters more.
            let _ = fs::remove_file(&partial);
        }
        written
    }

    fn write_file(&self, path: &Path, image: &BlendedImage) -> Result<(Counts, [f32; 2])> {
        let keep_clean = self.build.options.keep_clean;
        let writer = WorldWriter::create(path, &self.header(), keep_clean)?;
        let range = image.range(self.progress)?;
        image.write(&writer, range, keep_clean, self.progress)?;
        let counts =
            truth::write(&*self.build.specimen, &self.build.recipe.field, &writer, self.progress)?;
        writer.finish()?;
        verify(path, counts)?;
        Ok((counts, range))
    }

    fn header(&self) -> Header {
        let recipe = &self.build.recipe;
        let field = &recipe.field;
        let shape = field.pixels(field.built_grid());
        let mut texts = vec![
            ("material", recipe.id.clone()),
            ("zone_axis", recipe.zone_axis.clone()),
            ("recipe", recipe.to_toml()),
            ("stemgen_version", env!("CARGO_PKG_VERSION").into()),
            ("numerics_version", NUMERICS_VERSION.to_string()),
            ("engine", self.imager.name().to_owned()),
            ("engine_parameters", self.imager.parameters().to_string()),
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
            thickness_nm: self.build.specimen.thickness_nm(),
            dose: recipe.dose.electrons_per_angstrom2,
            noise: self.build.options.noise,
            seed: recipe.seed,
            texts,
        }
    }
}

/// Reads back every tile: a write that failed without a word is found here.
fn verify(path: &Path, counts: Counts) -> Result<()> {
    let world = WorldFile::open(path)?;
    let [rows, columns] = world.metadata().grid_shape;
    for r in 0..rows {
        for c in 0..columns {
            world.tile(r, c)?;
            if world.has_clean() {
                world.clean_tile(r, c)?;
            }
        }
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
    use crate::recipe::{Override, Recipe};
    use crate::specimen::LAID_OUT;
    use crate::structure::PARSED;

    #[test]
    fn a_build_reads_its_crystals_once_and_lays_its_specimen_out_once() {
        let folder = tempfile::tempdir().unwrap();
        let changes = [
            "field={fov_nm=[2.4, 2.4], grid=[1, 1], tile_px=16, overlap_px=0, thickness_nm=0.8}",
            "phonons.configurations=1",
            "detector={inner_mrad=50.0, outer_mrad=90.0}",
            "domains.sharpness_sigma_px=1.0",
            "domains.boundaries=0",
        ];
        let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
        // Domains have two crystals.
        let (parsed, laid_out) = (PARSED.get(), LAID_OUT.get());
        let recipe = Recipe::load("batio3", crate::recipe::Difficulty::Easy).unwrap();
        let recipe = recipe.with_overrides(&changes).unwrap().checked().unwrap();
        let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
        let build = WorldBuild::new(&recipe, &options).unwrap();
        build.cost().unwrap();
        build.run(&folder.path().join("w.h5"), &Silent).unwrap();
        assert_eq!(PARSED.get() - parsed, 2);
        assert_eq!(LAID_OUT.get() - laid_out, 1);
    }

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
