//! Builds a world: image sub-tile by sub-tile, then the file.

use std::fs;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use super::blended_image::kept_pixels;
use super::build_options::{BuildOptions, BuildPolicy};
use super::build_summary::{BuildSummary, layer_warning};
use super::field_scan::FieldScan;
use super::footprint;
use super::noise_free::{refined, refinement, too_coarse};
use super::publish::{Companion, partial, place, publish_companion, try_companion, try_partial};
use super::subtile_store::SubtileStore;
use super::subtiles::Partition;
use super::work_folder::{WorkFolder, remove_leftovers};
use super::world_job::{BuildLayout, Job};
use crate::error::{Error, Result};
use crate::files::outputs::check_outputs;
use crate::files::unfinished::Unfinished;
use crate::files::{OutputLock, disk_space};
use crate::imaging::direct::rectangle_plan;
use crate::imaging::{
    AUDIT_REMEDY, Audit, Cache, ChosenImager, ImagingChoice, ImagingCost, MethodChoice,
    MosaicImager, RegionImager, SimulationRuns, audit_cost,
};
use crate::numerics::NUMERICS_VERSION;
use crate::progress::Progress;
use crate::recipe::CheckedRecipe;
use crate::simulation::check_hdf5_name;
use crate::specimen::{Specimen, estimated_sites, specimen};

/// Builds the world of `recipe` into the file `output`, as `stemgen build` does. Finished sub-tiles are kept in the folder `<output>.work`
/// until the file is complete; a later build that finds them continues from there.
///
/// # Errors
/// [`Error::Invalid`] when `output` exists, [`Error::Locked`] when another process builds it, [`Error::DiskSpace`] when the disk has too
/// little room, [`Error::Interrupted`] when asked to stop, and errors of the recipe, the engine, the file system and HDF5.
pub fn build(
    recipe: &CheckedRecipe,
    output: &Path,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<BuildSummary> {
    WorldBuild::new(recipe, options)?.run(output, progress)
}

/// A build that is laid out but has not run: its cost is known before it runs.
pub struct WorldBuild {
    pub(super) layout: BuildLayout,
    pub(super) policy: BuildPolicy,
    /// An imager of the caller, in place of the imager that the options choose.
    pub(super) own: Option<Box<dyn RegionImager>>,
    /// The imager that the options choose. Choosing it looks at the whole field, and is done once.
    pub(super) chosen: OnceLock<ChosenImager>,
}

impl WorldBuild {
    /// Lays out the specimen and divides the field.
    ///
    /// # Errors
    /// Errors of the options and the specimen.
    pub fn new(recipe: &CheckedRecipe, options: &BuildOptions) -> Result<Self> {
        let (specimen, policy) = (specimen(recipe)?, options.policy(recipe)?);
        WorldBuild::of_parts(recipe, options, specimen, policy, None)
    }

    /// Lays out a build with an imager of the caller; `imager` makes it for the specimen that was laid out. No audit is made.
    ///
    /// # Errors
    /// Errors of the options, the specimen and `imager`.
    pub fn with_imager(
        recipe: &CheckedRecipe,
        options: &BuildOptions,
        imager: impl FnOnce(&Arc<dyn Specimen>) -> Result<Box<dyn RegionImager>>,
    ) -> Result<Self> {
        let specimen = specimen(recipe)?;
        let own = Some(imager(&specimen)?);
        WorldBuild::of_parts(recipe, options, specimen, options.policy(recipe)?, own)
    }

    fn of_parts(
        recipe: &CheckedRecipe,
        options: &BuildOptions,
        specimen: Arc<dyn Specimen>,
        policy: BuildPolicy,
        own: Option<Box<dyn RegionImager>>,
    ) -> Result<Self> {
        // A field that cannot be recorded is refused before the work.
        let scan = FieldScan::of(recipe)?;
        let detectors = recipe.detector.count();
        if scan.is_some() && detectors > 1 {
            let expected = "a recording has one detector; write one table [detector], or take the table [acquisition] out";
            let value = format!("[table] with {detectors} detectors");
            return Err(Error::invalid(crate::Setting::Acquisition, value, expected));
        }
        if scan.is_some() && !options.noise {
            let expected = "a recording has noise; take the table out, or leave the noise in";
            return Err(Error::invalid(
                crate::Setting::Acquisition,
                "[table] without noise",
                expected,
            ));
        }
        let parts = if recipe.acquisition.is_some() { refinement(recipe) } else { 1 };
        if let Some(fault) = too_coarse(recipe).filter(|_| own.is_some() && parts > 1) {
            return Err(fault);
        }
        let imaged = refined(recipe, parts)?;
        let field = &imaged.field;
        let shape = field.pixels(field.built_grid());
        let [size, overlap] = policy.subtile_nm;
        let partition = Partition::new(shape, field.pixel_nm(), size, overlap)?;
        let (recipe, options) = (recipe.clone(), options.clone());
        let layout = BuildLayout { recipe, imaged, parts, specimen, options, partition };
        Ok(WorldBuild { layout, policy, own, chosen: OnceLock::new() })
    }

    /// The specimen.
    pub(crate) fn specimen(&self) -> &Arc<dyn Specimen> {
        &self.layout.specimen
    }

    /// Returns the method, the check and the sub-tiles that the options choose.
    pub(crate) fn policy(&self) -> &BuildPolicy {
        &self.policy
    }

    /// Returns the warnings about the accuracy and about the files of crystals and atoms.
    ///
    /// # Errors
    /// Errors of the settings.
    pub fn warnings(&self) -> Result<Vec<String>> {
        let mut warnings = self.policy.warnings.clone();
        // The audit of an installed library has measured what the warning of the windows says is not measured.
        if !warnings.is_empty() && self.own.is_none() && self.chosen()?.is_known() {
            warnings.clear();
        }
        // Only a recipe with a layer needs the imager here: choosing it looks at the whole field.
        if let Some(warning) = layer_warning(&self.layout.recipe)
            && self.own.is_none()
            && self.chosen()?.shares()
        {
            warnings.push(warning);
        }
        warnings.extend(self.layout.recipe.notes()?);
        Ok(warnings)
    }

    /// Returns the number of sub-tiles, and their shape [rows, columns] in pixels.
    pub(crate) fn subtiles(&self) -> (usize, [usize; 2]) {
        let shape = self.layout.partition.subtiles().next().map_or([1, 1], |t| t.shape());
        (self.layout.partition.len(), shape)
    }

    /// Returns the simulation of one sub-tile, and the distance of its probes (x, y) in Angstrom.
    ///
    /// # Errors
    /// Errors of the plan.
    pub(crate) fn subtile_plan(&self) -> Result<(SimulationRuns, [f64; 2])> {
        let (count, shape) = self.subtiles();
        let simulator = &self.policy.imaging.simulator;
        rectangle_plan(&self.layout.imaged, &*self.layout.specimen, simulator, shape, count)
    }

    /// Estimates the cost of the image.
    ///
    /// # Errors
    /// Errors of the plan.
    pub fn cost(&self) -> Result<ImagingCost> {
        let (count, shape) = self.subtiles();
        match &self.own {
            Some(imager) => imager.cost(shape, count),
            None => self.chosen()?.cost(shape, count),
        }
    }

    fn chosen(&self) -> Result<&ChosenImager> {
        if let Some(chosen) = self.chosen.get() {
            return Ok(chosen);
        }
        let BuildLayout { imaged, specimen, .. } = &self.layout;
        let chosen = self.policy.imaging.chosen(imaged, specimen)?;
        Ok(self.chosen.get_or_init(|| chosen))
    }

    /// Returns the mosaic that the image is made from, with its library; `None` if the image is made otherwise.
    ///
    /// # Errors
    /// Errors of the settings.
    pub fn library(&self) -> Result<Option<MosaicImager>> {
        let BuildLayout { imaged, specimen, .. } = &self.layout;
        self.policy.imaging.mosaic(imaged, specimen)
    }

    /// Estimates the cost of the audit before the build, if one is made; `cost` is the cost of the image.
    ///
    /// # Errors
    /// Errors of the plan.
    pub(crate) fn audit_cost(&self, cost: &ImagingCost) -> Result<Option<SimulationRuns>> {
        let BuildPolicy { imaging, check, .. } = &self.policy;
        let mosaic = cost.mosaic.as_ref();
        let forced = imaging.method == MethodChoice::Mosaic;
        let known = mosaic.is_some_and(|m| m.is_known(&self.layout.recipe) && (m.pays || forced));
        let shares = cost.particle_probes.is_some() || mosaic.is_some_and(|m| m.pays) || forced;
        let audited = check
            .audit
            .as_ref()
            .filter(|_| self.own.is_none() && (check.asked() || (shares && !known)));
        let BuildLayout { imaged, specimen, .. } = &self.layout;
        audited.map(|options| audit_cost(imaged, &**specimen, options)).transpose()
    }

    /// Estimates the bytes of memory of the largest arrays that the build, or its audit, holds at a time on `threads` threads; also returns
    /// advice on how to need less. `cost` is the cost of the image.
    ///
    /// # Errors
    /// Errors of the plan.
    pub fn memory(&self, cost: &ImagingCost, threads: usize) -> Result<(u64, &'static str)> {
        let field = &self.layout.imaged.field;
        let kept = size_of::<f32>() * kept_pixels(field.pixels(field.built_grid()));
        let written = cost.image_bytes + kept as u64;
        let image = (cost.memory_bytes(threads).max(written), cost.memory_remedy(threads));
        let audit = self.audit_cost(cost)?.map(|audit| audit.cost.memory_bytes(threads));
        Ok(match audit.filter(|bytes| *bytes > image.0) {
            Some(bytes) => (bytes, AUDIT_REMEDY),
            None => image,
        })
    }

    /// Estimates the bytes on disk that the build needs, output and sub-tiles included; the cache and companions come on top.
    pub fn disk_bytes(&self) -> u64 {
        self.world_bytes() + self.work_bytes()
    }

    fn work_bytes(&self) -> u64 {
        let BuildLayout { imaged, partition, .. } = &self.layout;
        let measured = imaged.detector.measured().len();
        footprint::work_bytes(&imaged.field, partition.len(), measured)
    }

    fn world_bytes(&self) -> u64 {
        let sites = estimated_sites(&*self.layout.specimen, &self.layout.recipe.field);
        let recipe = &self.layout.recipe;
        let images = recipe.detector.count() * if self.layout.options.keep_clean { 2 } else { 1 };
        footprint::world_bytes(&recipe.field, sites, images)
    }

    /// Whether an earlier run of this build has finished the world `output` but ended before its last steps. [`WorldBuild::run`] then makes
    /// those steps, and replaces nothing.
    pub fn is_complete(&self, output: &Path) -> bool {
        WorkFolder::of(output).completed(&self.request()).is_some()
    }

    /// Builds the world, as [`build`] does.
    ///
    /// # Errors
    /// As [`build`].
    pub fn run(self, output: &Path, progress: &dyn Progress) -> Result<BuildSummary> {
        self.run_with(output, &[], progress)
    }

    /// Builds a world as [`build`] does, and the files that belong to it. The paths of the companions are not checked. If a run ends before
    /// all companions are written, the next run writes the others.
    ///
    /// # Errors
    /// As [`build`], and errors of the companions.
    pub fn run_with(
        self,
        output: &Path,
        companions: &[Companion],
        progress: &dyn Progress,
    ) -> Result<BuildSummary> {
        check_hdf5_name(output)?;
        let (started, work, request) = (Instant::now(), WorkFolder::of(output), self.request());
        self.check_output(output, work.completed(&request).is_some())?;
        let _lock = OutputLock::hold(output)?;
        // Checked once more, now under the lock: another process may have finished the world meanwhile.
        let completed = work.completed(&request);
        self.check_output(output, completed.is_some())?;
        let partials = std::iter::once(output).chain(companions.iter().map(|c| c.path));
        partials.clone().try_for_each(|path| work.check_partial(&partial(path)))?;
        let _unfinished: Vec<Unfinished> =
            partials.map(|path| Unfinished::at(&partial(path))).collect();
        let made = match completed {
            Some(summary) => Ok(summary),
            None => self.make(output, (&work, &request), companions, progress),
        };
        let summary = made.inspect_err(|_| work.remove_if_empty())?;
        companions.iter().try_for_each(|companion| publish_companion(companion, output))?;
        work.remove()?;
        Ok(BuildSummary { wall_time_s: started.elapsed().as_secs_f64(), ..summary })
    }

    pub(super) fn check_output(&self, output: &Path, complete: bool) -> Result<()> {
        let overwrite = self.layout.options.overwrite || complete;
        check_outputs([output], [] as [&Path; 0], overwrite)
            .inspect_err(|_| remove_leftovers(output))
    }

    /// Makes the world and moves it to its final path.
    fn make(
        self,
        output: &Path,
        (work, request): (&WorkFolder, &str),
        companions: &[Companion],
        progress: &dyn Progress,
    ) -> Result<BuildSummary> {
        if !self.layout.options.overwrite {
            SubtileStore::check_recipe(output, &self.layout.recipe.to_toml())?;
        }
        // The work folder is made first: its presence shows that an unfinished file belongs to a build.
        work.create()?;
        try_partial(output)?;
        companions.iter().try_for_each(try_companion)?;
        self.check_disk(output, companions)?;
        if self.own.is_none() {
            self.check_space(output, companions, self.library_bytes()?)?;
        }
        let WorldBuild { layout, policy, own, chosen } = self;
        let (imager, audit) = match own {
            Some(mut imager) => {
                imager.prepare(progress)?;
                (imager, None)
            }
            None => {
                let again = || policy.imaging.chosen(&layout.imaged, &layout.specimen);
                let first = chosen.into_inner().map_or_else(again, Ok)?;
                checked(&layout, &policy, first, work, progress)?
            }
        };
        let job = Job { layout: &layout, imager: &*imager, audit, progress };
        let store = work.subtiles(&job.key(), layout.options.overwrite, progress)?;
        let resumed = job.simulate(&store)?;
        let partial = partial(output);
        let publish = || {
            let (counts, range) = job.write_file(&partial, &store)?;
            let summary = job.summary(output, resumed, counts, range);
            work.complete(&partial, request, &summary)?;
            check_outputs([output], [] as [&Path; 0], layout.options.overwrite)?;
            place(&partial, output).map(|()| summary)
        };
        // If publishing fails, the partial file is removed and the first error is returned.
        publish().inspect_err(|_| drop(fs::remove_file(&partial)))
    }

    /// Describes all settings that decide the bytes of the file, except the imager that will be chosen.
    fn request(&self) -> String {
        let options =
            BuildOptions { cache: Cache::none(), overwrite: false, ..self.layout.options.clone() };
        let request = serde_json::json!({
            "numerics": NUMERICS_VERSION,
            "version": env!("CARGO_PKG_VERSION"),
            "recipe": self.layout.recipe.to_toml(),
            "options": format!("{options:?}"),
        });
        request.to_string()
    }

    /// Finds, without looking at the field, whether a disk has too little room for the files of the build.
    ///
    /// # Errors
    /// [`Error::DiskSpace`].
    pub fn check_disk(&self, output: &Path, companions: &[Companion]) -> Result<()> {
        self.check_space(output, companions, 0)
    }

    /// Estimates the bytes on disk of the library's images that are yet to be made.
    fn library_bytes(&self) -> Result<u64> {
        let (count, shape) = self.subtiles();
        let mosaic = self.chosen()?.imager.cost(shape, count)?.mosaic;
        Ok(mosaic.map_or(0, |m| m.missing_bytes))
    }

    fn check_space(&self, output: &Path, companions: &[Companion], library: u64) -> Result<()> {
        let work = WorkFolder::of(output);
        // A cache without room is no error: the work folder then keeps the images.
        let cache = self.policy.imaging.cache.folder();
        let cache = cache.filter(|f| disk_space::free_bytes_below(f).is_none_or(|b| b > library));
        let sub_tiles = self.work_bytes();
        let kept_here = if cache.is_none() { library } else { 0 };
        let mut needed = vec![
            (output, self.world_bytes()),
            (work.path(), (sub_tiles + kept_here).saturating_sub(work.bytes())),
            (cache.unwrap_or(work.path()), library - kept_here),
        ];
        needed.extend(companions.iter().map(|c| (c.path, c.most_bytes)));
        disk_space::check_places(&needed)
    }
}

/// Prepares an imager that passes the check of the policy; also returns its audit.
pub(super) fn checked(
    layout: &BuildLayout,
    policy: &BuildPolicy,
    mut first: ChosenImager,
    work: &WorkFolder,
    progress: &dyn Progress,
) -> Result<(Box<dyn RegionImager>, Option<Audit>)> {
    let BuildPolicy { imaging, check, .. } = policy;
    if let Some(library) = first.imager.library_mut() {
        library.keep_in(&work.library());
    }
    let cache = imaging.cache.clone().with_fallback(work.library());
    let imaging = ImagingChoice { cache, ..imaging.clone() };
    let BuildLayout { imaged, specimen, .. } = layout;
    imaging.checked_imager(imaged, specimen, first, (check, &work.audits()), progress)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::Cache;
    use crate::progress::Silent;
    use crate::recipe::{Override, Recipe};
    use crate::specimen::LAID_OUT;
    use crate::structure::PARSED;
    use crate::world::BuildMethod;

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
        // A recipe of domains has two crystals.
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
    fn the_memory_of_a_build_is_that_of_its_audit_where_that_takes_more() {
        let tiny = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/tiny.toml"));
        let recipe = CheckedRecipe::from_file(tiny, None).unwrap();
        let with = |audit_regions| BuildOptions {
            cache: Cache::none(),
            method: BuildMethod::Mosaic,
            window_angstrom: Some(5.0),
            audit_regions,
            ..BuildOptions::default()
        };
        let (audited, plain) = (with(1), with(0));
        let build = WorldBuild::new(&recipe, &audited).unwrap();
        let cost = build.cost().unwrap();
        let image = cost.memory_bytes(2);
        let audit = build.audit_cost(&cost).unwrap().unwrap().cost.memory_bytes(2);
        assert!(audit > image, "{audit} {image}");
        assert_eq!(build.memory(&cost, 2).unwrap(), (audit, AUDIT_REMEDY));
        let build = WorldBuild::new(&recipe, &plain).unwrap();
        assert_eq!(build.memory(&cost, 2).unwrap().0, image);
    }
}
