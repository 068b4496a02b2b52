//! Builds a world: simulate sub-tile by sub-tile, then write the file.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use ndarray::Array2;

use super::audit::Audit;
use super::census::estimated_sites;
use super::footprint;
use super::method::{Check, Method};
use super::mosaic::MosaicEngine;
use super::pixel_box::PixelBox;
use super::recipe::Recipe;
use super::specimen::{BEYOND_FIELD_NM, DISPLACED_NM, Region, Specimen, specimen};
use super::stitch::WorldImage;
use super::store::{Store, beside};
use super::subprogress::SubProgress;
use super::subtiles::{Partition, SubTile};
use super::truth::{self, Counts};
use crate::engine::{Scan, Site};
use crate::error::{Error, Result};
use crate::files::{OutputLock, disk_space};
use crate::io::{Header, WorldFile, WorldWriter};
use crate::progress::Progress;

/// Simulates sub-tiles.
pub trait SubTileEngine {
    /// Name of the method.
    fn name(&self) -> String;
    /// Settings that decide the image. A build resumes only under the same.
    fn parameters(&self) -> serde_json::Value;
    /// Specimen that is needed beyond the scanned area on each side, in Angstrom.
    fn margin_angstrom(&self) -> f64;
    /// Mean HAADF image over all phonon configurations, as fraction of the beam, of `scan.shape`.
    /// The box holds the specimen from the entrance surface z = 0 to its exit surface.
    ///
    /// # Errors
    /// Whatever keeps the engine from it; [`Error::Interrupted`] when asked to stop.
    fn image(
        &self,
        sites: &[Site],
        box_angstrom: [f64; 3],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>>;
    /// The mosaic that makes images in place of [`SubTileEngine::image`], if it is one.
    fn mosaic(&self) -> Option<&MosaicEngine> {
        None
    }
}

/// How to build.
#[derive(Debug, Clone, PartialEq)]
pub struct BuildOptions {
    /// Add Poisson noise.
    pub noise: bool,
    /// Also store the noiseless tiles.
    pub keep_clean: bool,
    /// Replace an existing file.
    pub overwrite: bool,
    /// Largest width of a sub-tile in nm.
    pub subtile_nm: f64,
    /// Overlap of sub-tiles in nm.
    pub subtile_overlap_nm: f64,
    /// How a mosaic is checked.
    pub check: Check,
}

impl Default for BuildOptions {
    fn default() -> Self {
        BuildOptions {
            noise: true,
            keep_clean: false,
            overwrite: false,
            subtile_nm: 7.0,
            subtile_overlap_nm: 1.0,
            check: Check::default(),
        }
    }
}

/// What was built.
#[derive(Debug, Clone)]
pub struct Summary {
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

/// Builds the world of `recipe` into the file `output`. Finished sub-tiles are kept in the folder
/// `<output>.work` until the file is complete; a build that finds them goes on from there.
///
/// # Errors
/// [`Error::Invalid`] when `output` exists, [`Error::Locked`] when another process builds it,
/// [`Error::DiskSpace`] when there is no room for it, [`Error::Interrupted`] when asked to stop, and
/// those of the recipe, the engine, the file system and HDF5.
pub fn build(
    recipe: &Recipe,
    engine: &dyn SubTileEngine,
    output: &Path,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<Summary> {
    let started = Instant::now();
    recipe.check()?;
    check_output(output, options.overwrite)?;
    let _lock = OutputLock::hold(output)?;
    let margin = engine.margin_angstrom();
    if !(0.0..=(BEYOND_FIELD_NM - DISPLACED_NM) * 10.0).contains(&margin) {
        let expected = format!("the specimen goes on for {} A around it", BEYOND_FIELD_NM * 10.0);
        return Err(Error::invalid(crate::Setting::EngineMarginAngstrom, margin, expected));
    }
    let specimen = specimen(recipe)?;
    let field = &recipe.field;
    let shape = field.pixels(field.built_grid());
    let (size, overlap) = (options.subtile_nm, options.subtile_overlap_nm);
    let partition = Partition::new(shape, field.pixel_nm(), size, overlap)?;
    let sites = estimated_sites(&*specimen, field);
    let needed = footprint::world_bytes(field, sites, options.keep_clean);
    let done = footprint::folder_bytes(&beside(output, ".work"));
    disk_space::check_space(output, needed.saturating_sub(done))?;
    let check = &options.check;
    let (method, audit) = Method::prepare(engine, &*specimen, recipe, check, progress)?;
    let library = match &method {
        Method::Field(field) => field.library(),
        _ => None,
    };
    let job = Job { recipe, method, specimen: &*specimen, audit, progress };
    let store = Store::open(output, &job.key(&partition), progress)?;
    let done = job.simulate(&partition, &store).and_then(|resumed| {
        let image = WorldImage::new(recipe, &partition, &store, options.noise);
        Ok((resumed, job.publish(output, &image, options, started)?))
    });
    let (resumed, (counts, range)) = done.inspect_err(|_| {
        let kept = "keeps the sub-tiles done so far; the same command goes on from there";
        progress.warn(&format!("{} {kept}", store.folder().display()));
    })?;
    store.remove()?;
    Ok(Summary {
        path: output.to_owned(),
        grid: field.built_grid(),
        fov_nm: shape.map(|n| n as f64 * field.pixel_nm()),
        counts,
        engine: job.method.name(),
        audit: job.audit,
        library,
        subtiles: partition.len(),
        subtiles_resumed: resumed,
        range,
        wall_time_s: started.elapsed().as_secs_f64(),
    })
}

fn check_output(output: &Path, overwrite: bool) -> Result<()> {
    let refuse = |why: &str| Err(Error::invalid(crate::Setting::Output, output.display(), why));
    if output.is_dir() {
        return refuse("is a folder; name a file in it, such as world.h5");
    }
    if output.exists() && !overwrite {
        return refuse("exists; name another file, or allow overwriting");
    }
    let parent = output.parent().filter(|p| !p.as_os_str().is_empty());
    match parent {
        Some(parent) if !parent.is_dir() => {
            fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create", e))
        }
        _ => Ok(()),
    }
}

struct Job<'a> {
    recipe: &'a Recipe,
    method: Method<'a>,
    specimen: &'a dyn Specimen,
    audit: Option<Audit>,
    progress: &'a dyn Progress,
}

impl Job<'_> {
    /// All that decides the image of a sub-tile.
    fn key(&self, partition: &Partition) -> String {
        let key = serde_json::json!({
            "stemgen": env!("CARGO_PKG_VERSION"),
            "recipe": self.recipe.to_toml(),
            "engine": self.method.name(),
            "parameters": self.method.parameters(),
            "partition": format!("{partition:?}"),
        });
        key.to_string()
    }

    /// Simulates what is missing; returns how many sub-tiles were there.
    fn simulate(&self, partition: &Partition, store: &Store) -> Result<usize> {
        let work: Vec<usize> = partition.subtiles().map(|t| self.work(&t)).collect();
        let (stage, unit) = match &self.method {
            Method::Field(field) => ("assembling", field.unit()),
            _ => ("simulating", "probe"),
        };
        self.progress.start(stage, unit, work.iter().sum::<usize>() as u64);
        let mut resumed = 0;
        for (tile, work) in partition.subtiles().zip(work) {
            if self.progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let share = SubProgress::new(self.progress, work);
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

    /// Pixel (row, column) of the full field at which a sub-tile begins.
    fn start(&self, tile: &SubTile) -> [usize; 2] {
        let first = self.recipe.field.crop_origin_px();
        [first[0] + tile.rows.start, first[1] + tile.columns.start]
    }

    fn work(&self, tile: &SubTile) -> usize {
        match &self.method {
            Method::Field(field) => field.work(self.start(tile), tile.shape()),
            _ => tile.rows.len() * tile.columns.len(),
        }
    }

    fn simulate_one(&self, tile: &SubTile, progress: &dyn Progress) -> Result<Array2<f32>> {
        let (start, pixel) = (self.start(tile), self.recipe.field.pixel_nm());
        let engine: &dyn SubTileEngine = match &self.method {
            Method::Field(field) => {
                let configurations = self.recipe.phonons.configurations.max(1);
                let image = field.mean_of(start, tile.shape(), configurations, progress)?;
                return Ok(image.mapv(|v| v as f32));
            }
            Method::SubTiles(engine) => *engine,
            Method::Instead(simulator) => &**simulator,
        };
        let (margin, thickness) = (engine.margin_angstrom(), self.specimen.thickness_nm());
        let PixelBox { area, size_angstrom, scan } =
            PixelBox::new((start, tile.shape(), 1), pixel, margin, thickness);
        let image = engine.image(&self.atoms(&area), size_angstrom, &scan, progress)?;
        if image.shape() != scan.shape {
            let expected = format!("the engine was asked for {:?}", scan.shape);
            return Err(Error::invalid(
                crate::Setting::EngineImageShape,
                format!("{:?}", image.shape()),
                expected,
            ));
        }
        match image.iter().find(|v| !v.is_finite()) {
            Some(bad) => {
                let place = format!("sub-tile {} of engine {}", tile.index, engine.name());
                Err(Error::invalid(
                    crate::Setting::Intensity,
                    bad,
                    format!("{place}: must be finite"),
                ))
            }
            None => Ok(image),
        }
    }

    /// The atoms of an area, relative to its corner.
    fn atoms(&self, area: &Region) -> Vec<Site> {
        let corner = [area.x[0], area.y[0]];
        // A displaced atom may lie on the other side of the edge than its column.
        let mut sites = self.specimen.sites(&area.grown(DISPLACED_NM));
        sites.retain(|s| area.contains([s.position_nm[0], s.position_nm[1]]));
        sites.iter().filter_map(|s| s.atom(corner, &self.recipe.phonons)).collect()
    }

    /// Writes the file under another name and puts it in place when it is complete.
    fn publish(
        &self,
        output: &Path,
        image: &WorldImage,
        options: &BuildOptions,
        started: Instant,
    ) -> Result<(Counts, [f32; 2])> {
        let partial = beside(output, ".partial");
        let written = self.write_file(&partial, image, options, started).and_then(|written| {
            check_output(output, options.overwrite)?;
            fs::rename(&partial, output).map_err(|e| Error::io(output, "write", e))?;
            Ok(written)
        });
        if written.is_err() {
            // What is there is of no use; the reason for the failure matters more.
            let _ = fs::remove_file(&partial);
        }
        written
    }

    fn write_file(
        &self,
        path: &Path,
        image: &WorldImage,
        options: &BuildOptions,
        started: Instant,
    ) -> Result<(Counts, [f32; 2])> {
        let writer = WorldWriter::create(path, &self.header(options.noise), options.keep_clean)?;
        let range = image.range(self.progress)?;
        image.write(&writer, range, options.keep_clean, self.progress)?;
        let counts = truth::write(self.specimen, &self.recipe.field, &writer, self.progress)?;
        writer.finish(started.elapsed().as_secs_f64())?;
        verify(path, counts)?;
        Ok((counts, range))
    }

    fn header(&self, noise: bool) -> Header {
        let recipe = self.recipe;
        let field = &recipe.field;
        let shape = field.pixels(field.built_grid());
        let mut texts = vec![
            ("material", recipe.id.clone()),
            ("zone_axis", recipe.zone_axis.clone()),
            ("recipe", recipe.to_toml()),
            ("stemgen_version", env!("CARGO_PKG_VERSION").into()),
            ("engine", self.method.name()),
            ("engine_parameters", self.method.parameters().to_string()),
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
            thickness_nm: self.specimen.thickness_nm(),
            dose: recipe.dose.electrons_per_angstrom2,
            noise,
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
