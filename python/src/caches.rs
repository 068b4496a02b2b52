//! The cache of the simulations that worlds share, and the supplied library.

use crate::errors::{Fault, OrRaise};
use crate::long_call::{Running, run};
use crate::recipes::checked;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use stemgen::Setting;
use stemgen::files::Shard;
use stemgen::files::outputs::check_outputs;
use stemgen::imaging::{Cache, SuppliedLibrary, library_archive};
use stemgen::world::{BuildOptions, WorldBuild};

/// Writes the simulations of a material, or all, from the user's cache to a file. Returns the file's contents as JSON.
#[pyfunction]
pub fn cache_export(
    py: Python<'_>,
    out: PathBuf,
    material: Option<String>,
    overwrite: bool,
    running: Running,
) -> PyResult<String> {
    run(py, running, move |call| {
        check_outputs([&out], [] as [&PathBuf; 0], overwrite)?;
        let cache = Cache::of_user();
        check_known(&cache, material.as_deref(), false)?;
        let found = library_archive::export(&cache, material.as_deref(), &out, call)?;
        Ok(serde_json::to_string(&found)?)
    })
}

/// Copies the images of a file into the user's cache. Returns the file's contents as JSON.
#[pyfunction]
pub fn cache_import(py: Python<'_>, path: PathBuf, running: Running) -> PyResult<String> {
    run(py, running, move |call| {
        let found = library_archive::import(&Cache::of_user(), &path, call)?;
        Ok(serde_json::to_string(&found)?)
    })
}

/// Returns the folder of the user's cache.
#[pyfunction]
pub fn cache_folder() -> Option<PathBuf> {
    Cache::of_user().folder().map(Path::to_owned)
}

/// Sets the folder of the supplied library.
#[pyfunction]
pub fn set_library(folder: PathBuf) {
    SuppliedLibrary::set_of_program(folder);
}

/// Returns the folder of the supplied library.
#[pyfunction]
pub fn library_folder() -> Option<PathBuf> {
    SuppliedLibrary::of_program().map(|library| library.folder().to_owned())
}

/// Lists the contents of the supplied library: material, images, bytes.
#[pyfunction]
pub fn library_list(py: Python<'_>) -> Holdings {
    let held = py.detach(|| SuppliedLibrary::of_program().map(|library| library.holdings()));
    held.into_iter().flatten().map(|h| (h.material, h.images, h.bytes)).collect()
}

type Holdings = Vec<(String, usize, u64)>;

/// Lists the contents of the user's cache: material, images, bytes.
#[pyfunction]
pub fn cache_list(py: Python<'_>) -> PyResult<Holdings> {
    let held = py.detach(|| Cache::of_user().holdings()).or_raise(py)?;
    Ok(held.into_iter().map(|h| (h.material, h.images, h.bytes)).collect())
}

/// Removes the simulations of a material, or all, from the user's cache. Returns the removed ones.
#[pyfunction]
pub fn cache_clear(py: Python<'_>, material: Option<String>) -> PyResult<Holdings> {
    let removed = py.detach(|| -> Result<Holdings, Fault> {
        let cache = Cache::of_user();
        let removed = cache.clear(material.as_deref())?;
        if removed.is_empty() {
            check_known(&cache, material.as_deref(), false)?;
        }
        Ok(removed.into_iter().map(|h| (h.material, h.images, h.bytes)).collect())
    });
    removed.or_raise(py)
}

/// Refuses a material without images in the cache, and with `supplied` also in the supplied library.
fn check_known(cache: &Cache, material: Option<&str>, supplied: bool) -> Result<(), Fault> {
    let Some(name) = material else { return Ok(()) };
    let library = cache.supplied_library().filter(|_| supplied);
    let mut held = cache.holdings()?;
    held.extend(library.map(|library| library.holdings()).into_iter().flatten());
    let mut known: Vec<String> = held.into_iter().map(|h| h.material).collect();
    known.sort();
    known.dedup();
    if known.iter().any(|material| material == name) {
        return Ok(());
    }
    let known = if known.is_empty() { "nothing".into() } else { known.join(", ") };
    let expected = format!("the cache has no simulations of it; it holds {known}");
    Err(Fault::Value(Setting::Material, name.into(), expected))
}

/// Numbers of images of a library: all, simulated by this call, and still missing.
type Filling = (usize, usize, usize);

/// Makes part `shard[0]` (from 0) of `shard[1]` parts of the simulations that worlds of a recipe share. Some recipes share none.
#[pyfunction]
pub fn cache_fill(
    py: Python<'_>,
    toml: String,
    shard: [usize; 2],
    supplied: bool,
    running: Running,
) -> PyResult<Option<Filling>> {
    run(py, running, move |call| {
        let shard = Shard::new(shard[0], shard[1])?;
        let cache = Cache::of_user();
        let cache = if supplied { cache } else { cache.without_supplied() };
        let build = build_of(&toml, cache)?;
        let Some(library) = build.library()? else { return Ok(None) };
        let images = library.mosaic_cost().images;
        let simulated = library.fill_part(shard, call)?;
        Ok(Some((images, simulated, library.mosaic_cost().missing)))
    })
}

/// Files of damaged images, and descriptions of the damage.
type Damaged = Vec<(PathBuf, &'static str)>;
/// Names of images, the greatest difference, and whether it is a rounding error.
type Again = Vec<(String, f64, bool)>;

/// Reads the images of a material, or all, and simulates some images of a recipe again. Returns the numbers of images in the cache and the
/// library.
#[pyfunction]
pub fn cache_verify(
    py: Python<'_>,
    material: Option<String>,
    again: Option<(String, usize, u64)>,
    running: Running,
) -> PyResult<(usize, usize, Damaged, Again)> {
    run(py, running, move |call| {
        let cache = Cache::of_user();
        check_known(&cache, material.as_deref(), true)?;
        let (images, damaged) = cache.verify(material.as_deref(), call)?;
        let supplied = match cache.supplied_library() {
            Some(library) => library.verified(call)?.iter().map(|h| h.images).sum(),
            None => 0,
        };
        let mut recomputed = Vec::new();
        if let Some((toml, count, seed)) = again {
            let build = build_of(&toml, cache)?;
            if let Some(library) = build.library()? {
                recomputed = library.recomputed(count, seed, call)?;
            }
            if recomputed.is_empty() {
                let words = "the cache holds no simulations that worlds of this recipe use; sw.cache.fill makes them";
                return Err(Fault::Words(words.into()));
            }
        }
        let damaged = damaged.into_iter().map(|one| (one.path, one.fault)).collect();
        let again = recomputed
            .into_iter()
            .map(|one| (one.agrees(), one))
            .map(|(agrees, one)| (one.key, one.difference, agrees));
        Ok((images, supplied, damaged, again.collect()))
    })
}

/// Returns a build with default options.
fn build_of(toml: &str, cache: Cache) -> Result<WorldBuild, Fault> {
    Ok(WorldBuild::new(&checked(toml)?, &BuildOptions { cache, ..BuildOptions::default() })?)
}
