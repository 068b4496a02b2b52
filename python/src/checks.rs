//! Audits, validation, comparison of worlds.

use crate::builds::CacheChoice;
use crate::errors::{Fault, OrRaise};
use crate::long_call::{Running, run};
use crate::recipes::checked;
use pyo3::prelude::*;
use std::path::PathBuf;
use stemgen::engine::check_memory;
use stemgen::files::{atomic_write, outputs::check_outputs};
use stemgen::imaging::AuditOptions;
use stemgen::io::WorldFile;
use stemgen::progress::Progress;
use stemgen::recipe::CheckedRecipe;
use stemgen::simulation;
use stemgen::validate::check_world;
use stemgen::validate::report::{Report, ReportOrigin, sentence, suite_page, worlds_page};
use stemgen::validate::suite::{Case, selected};
use stemgen::validate::worlds::compare;
use stemgen::world::{AuditJob, WorldEngine};

/// A recipe, or a world, whose file contains its recipe.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Field {
    toml: Option<String>,
    pub world: Option<PathBuf>,
    /// Changes of the table [acquisition] of a world's recipe: `key=value`.
    acquisition: Vec<String>,
}

impl Field {
    /// Returns the recipe and, for a world, the engine of its build.
    ///
    /// # Errors
    /// Errors of the recipe and the file.
    pub fn resolve(&self) -> Result<(CheckedRecipe, Option<WorldEngine>), Fault> {
        let (recipe, made) = match (&self.world, &self.toml) {
            (Some(path), _) => {
                let (recipe, made) = WorldEngine::of_world(&WorldFile::open(path)?)?;
                (recipe.checked()?, made)
            }
            (None, toml) => (checked(toml.as_deref().unwrap_or_default())?, None),
        };
        if self.acquisition.is_empty() {
            return Ok((recipe, made));
        }
        let changes = self.acquisition.iter().map(|change| change.parse());
        let changes = changes.collect::<stemgen::Result<Vec<_>>>()?;
        Ok((recipe.recipe().with_overrides(&changes)?.checked()?, made))
    }
}

/// The options of an audit.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Auditing {
    field: Field,
    regions: usize,
    at_nm: Vec<[f64; 2]>,
    size_nm: f64,
    stride: Option<usize>,
    configurations: Option<usize>,
    seed: u64,
    cache: CacheChoice,
    force: bool,
}

/// Simulates regions of a world exactly, and compares them. Returns JSON.
#[pyfunction]
pub fn audit_field(py: Python<'_>, options: Auditing, running: Running) -> PyResult<String> {
    run(py, running, move |call| {
        let (recipe, made) = options.field.resolve()?;
        let asked = AuditOptions {
            regions: options.regions,
            size_nm: options.size_nm,
            stride: options.stride,
            seed: options.seed,
            at_nm: options.at_nm.clone(),
            configurations: options.configurations,
        };
        let job = AuditJob::new(recipe, made.as_ref(), asked, options.cache.cache(), None)?;
        let (bytes, remedy) = job.memory(simulation::threads())?;
        match check_memory(bytes, remedy) {
            Err(e) if options.force => call.warn(&e.to_string()),
            checked => checked?,
        }
        Ok(serde_json::to_string(&job.run(call)?)?)
    })
}

/// Runs cases of the validation. Returns JSON. Writes a page (HTML) to `out`.
#[pyfunction]
pub fn validate_suite(
    py: Python<'_>,
    cases: Vec<String>,
    quick: bool,
    out: Option<PathBuf>,
    overwrite: bool,
    running: Running,
) -> PyResult<String> {
    run(py, running, move |call| {
        let subject = match (cases.is_empty(), quick) {
            (true, false) => "its shipped references",
            (true, true) => "the quick part of its shipped references",
            (false, _) => "some of its shipped references",
        };
        let chosen = selected(&cases, quick)?;
        check_outputs(&out, [] as [&PathBuf; 0], overwrite)?;
        call.start("validating", "steps", chosen.iter().map(Case::units).sum());
        let outcomes = chosen.iter().map(|case| case.run(call)).collect::<Result<_, _>>()?;
        call.finish();
        let report =
            Report::new(subject, ReportOrigin::now("stemworlds.validate".into()), outcomes);
        if let Some(out) = &out {
            atomic_write::write(out, suite_page(&report)?.as_bytes())?;
        }
        Ok(serde_json::to_string(&report)?)
    })
}

/// Lists the cases of the validation: name, title, whether it is quick, seconds on two cores.
#[pyfunction]
pub fn validation_cases(py: Python<'_>) -> PyResult<Vec<(String, String, bool, f64)>> {
    let cases = selected(&[], false).or_raise(py)?;
    let row = |case: Case| (case.name.to_owned(), case.title.to_owned(), case.quick, case.seconds);
    Ok(cases.into_iter().map(row).collect())
}

/// Compares two worlds by their statistics. Returns JSON. Writes a page (HTML) to `out`.
#[pyfunction]
pub fn compare_worlds(
    py: Python<'_>,
    paths: [PathBuf; 2],
    alpha: f64,
    out: Option<PathBuf>,
    overwrite: bool,
    running: Running,
) -> PyResult<String> {
    run(py, running, move |call| {
        let [a, b] = &paths;
        let worlds = [WorldFile::open(a)?, WorldFile::open(b)?];
        check_outputs(&out, &paths, overwrite)?;
        let comparison = compare(a, b, alpha, call)?;
        if let Some(out) = &out {
            let origin = ReportOrigin::now("stemworlds.compare".into());
            let page = worlds_page(&comparison, [&worlds[0], &worlds[1]], &origin)?;
            atomic_write::write(out, page.as_bytes())?;
        }
        let mut report = serde_json::to_value(&comparison)?;
        report["summary"] = sentence(&comparison).into();
        Ok(report.to_string())
    })
}

/// Checks the consistency of a world file. Returns JSON.
#[pyfunction]
pub fn verify_world(py: Python<'_>, path: PathBuf, running: Running) -> PyResult<String> {
    run(py, running, move |call| Ok(serde_json::to_string(&check_world(&path, call)?)?))
}
