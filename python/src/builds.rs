//! Builds and plans worlds.

use crate::errors::Fault;
use crate::long_call::{LongCall, Running, run};
use crate::recipes::checked;
use crate::words::{WordOrNumber, choice, expansion};
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::Setting;
use stemgen::engine::check_memory;
use stemgen::files::Shard;
use stemgen::files::outputs::check_outputs;
use stemgen::imaging::Cache;
use stemgen::progress::Progress;
use stemgen::render::image_pictures::write_world;
use stemgen::simulation;
use stemgen::world::footprint::PICTURE;
use stemgen::world::{BuildMethod, BuildOptions, BuildProfile, Companion, WorldBuild, WorldPlan};

/// Greatest number of regions that a build may audit.
const MOST_REGIONS: usize = 1000;

/// The options of a build.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Building {
    toml: String,
    out: PathBuf,
    noise: bool,
    keep_clean: bool,
    overwrite: bool,
    engine: Option<String>,
    profile: Option<String>,
    window_angstrom: Option<f64>,
    accuracy_percent: Option<f64>,
    expansion_percent: WordOrNumber,
    interpolation: Option<[usize; 2]>,
    audit: Option<usize>,
    max_error_percent: Option<f64>,
    cache: CacheChoice,
    subtile_nm: Option<f64>,
    subtile_overlap_nm: Option<f64>,
    /// Also write a picture beside the file.
    png: bool,
    force: bool,
}

/// The choice of a cache: the user's cache, none, or a folder.
#[derive(FromPyObject)]
pub enum CacheChoice {
    #[pyo3(transparent)]
    Used(bool),
    #[pyo3(transparent)]
    Folder(PathBuf),
}

impl CacheChoice {
    /// Returns the chosen cache.
    pub fn cache(&self) -> Cache {
        match self {
            CacheChoice::Used(true) => Cache::of_user(),
            CacheChoice::Used(false) => Cache::supplied(),
            CacheChoice::Folder(folder) => Cache::supplied().in_folder(folder.clone()),
        }
    }
}

/// Returns the method with a name.
fn method(name: &str) -> Result<BuildMethod, Fault> {
    let known = [
        ("auto", BuildMethod::Auto),
        ("mosaic", BuildMethod::Mosaic),
        ("window", BuildMethod::Window),
        ("prism", BuildMethod::Prism),
        ("multislice", BuildMethod::Multislice),
    ];
    choice(Setting::Algorithm, name, &known)
}

impl Building {
    fn options(&self) -> Result<BuildOptions, Fault> {
        let profiles = [("default", BuildProfile::Default), ("published", BuildProfile::Published)];
        let profile = self.profile.as_deref().unwrap_or("default");
        if let Some(regions) = self.audit.filter(|n| *n > MOST_REGIONS) {
            let expected = format!("audits take up to {MOST_REGIONS} regions");
            return Err(Fault::Value(Setting::AuditCentreNm, regions.to_string(), expected));
        }
        let usual = BuildOptions::default();
        Ok(BuildOptions {
            noise: self.noise,
            keep_clean: self.keep_clean,
            overwrite: self.overwrite,
            method: self.engine.as_deref().map_or(Ok(usual.method), method)?,
            profile: choice(Setting::BuildProfile, profile, &profiles)?,
            window_angstrom: self.window_angstrom,
            accuracy_percent: self.accuracy_percent,
            expansion: expansion(&self.expansion_percent)?,
            interpolation: self.interpolation,
            audit_regions: self.audit.unwrap_or(usual.audit_regions),
            audit_direct: self.audit.is_some_and(|n| n > 0),
            max_error_percent: self.max_error_percent,
            cache: self.cache.cache(),
            subtile_nm: self.subtile_nm,
            subtile_overlap_nm: self.subtile_overlap_nm,
        })
    }

    fn run(&self, call: &LongCall) -> Result<String, Fault> {
        let recipe = checked(&self.toml)?;
        let build = WorldBuild::new(&recipe, &self.options()?)?;
        let picture = self.png.then(|| self.out.with_extension("png"));
        let outputs = [Some(&self.out), picture.as_ref()].into_iter().flatten();
        let complete = build.is_complete(&self.out);
        check_outputs(outputs, [] as [&PathBuf; 0], self.overwrite || complete)?;
        let companion = picture.as_deref().map(|path| Companion {
            path,
            most_bytes: PICTURE,
            write: &write_world,
        });
        if !complete {
            build.check_disk(&self.out, companion.as_slice())?;
            let warnings = build.warnings()?.into_iter().chain(WorldPlan::warnings(&build)?);
            warnings.for_each(|warning| call.warn(&warning));
            let (needed, remedy) = build.memory(&build.cost()?, simulation::threads())?;
            match check_memory(needed, remedy) {
                Err(e) if self.force => call.warn(&e.to_string()),
                checked => checked?,
            }
        }
        let summary = build.run_with(&self.out, companion.as_slice(), call)?;
        Ok(serde_json::to_string(&summary)?)
    }

    fn run_part(&self, shard: [usize; 2], call: &LongCall) -> Result<String, Fault> {
        let shard = Shard::new(shard[0], shard[1])?;
        let build = WorldBuild::new(&checked(&self.toml)?, &self.options()?)?;
        check_outputs([&self.out], [] as [&PathBuf; 0], false)?;
        build.warnings()?.iter().for_each(|warning| call.warn(warning));
        let (needed, remedy) = build.memory(&build.cost()?, simulation::threads())?;
        match check_memory(needed, remedy) {
            Err(e) if self.force => call.warn(&e.to_string()),
            checked => checked?,
        }
        Ok(serde_json::to_string(&build.run_part(&self.out, shard, call)?)?)
    }
}

/// Builds a world. Returns its summary as JSON.
#[pyfunction]
pub fn build_world(py: Python<'_>, options: Building, running: Running) -> PyResult<String> {
    run(py, running, move |call| options.run(call))
}

/// Makes part `shard[0]` (from 0) of `shard[1]` parts of a world. Returns a summary as JSON.
#[pyfunction]
pub fn build_part(
    py: Python<'_>,
    options: Building,
    shard: [usize; 2],
    running: Running,
) -> PyResult<String> {
    run(py, running, move |call| options.run_part(shard, call))
}

/// Estimates size, memory and time of a build. Returns them as JSON. Writes no file.
#[pyfunction]
pub fn plan_build(py: Python<'_>, options: Building, running: Running) -> PyResult<String> {
    run(py, running, move |_| {
        let recipe = checked(&options.toml)?;
        let build = WorldBuild::new(&recipe, &options.options()?)?;
        let mut report =
            serde_json::to_value(WorldPlan::new(&recipe, &build, options.out.clone())?)?;
        let more = WorldPlan::warnings(&build)?.into_iter().chain(build.warnings()?);
        if let Some(warnings) = report["warnings"].as_array_mut() {
            let known = warnings.clone();
            warnings.extend(more.map(Into::into).filter(|text| !known.contains(text)));
        }
        Ok(report.to_string())
    })
}
