//! Finds the dose at which a defect is seen.

use crate::errors::{Fault, OrRaise};
use crate::long_call::{LongCall, Running, run};
use crate::recipes::checked;
use crate::request::{AtomArrays, of_json};
use pyo3::prelude::*;
use pythonize::depythonize;
use serde_json::Value;
use stemgen::detectability::{DetectabilityJob, DetectabilityRequest, power_svg};
use stemgen::progress::Progress;
use stemgen::simulation::AtomsSource;

/// The atoms without defects: a recipe's crystal, arrays, or the file that the request names.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct DefectSource {
    /// A resolved recipe.
    recipe: Option<String>,
    atoms: Option<AtomArrays>,
    /// Name of the material.
    name: String,
}

/// Puts the given values into the tables of a request, key by key.
fn put(given: Value, to: &mut Value) {
    match (given, to) {
        (Value::Object(given), Value::Object(to)) => {
            for (key, value) in given {
                // Displacements by element are one value, not a table of the request.
                match to.get_mut(&key) {
                    Some(known) if key != "sigma_angstrom" => put(value, known),
                    _ => {
                        to.insert(key, value);
                    }
                }
            }
        }
        (given, to) => *to = given,
    }
}

/// Returns the request: the recipe's values, replaced by the given ones; or the given ones with the library's defaults.
fn request_of(
    py: Python<'_>,
    given: Value,
    source: &DefectSource,
) -> PyResult<DetectabilityRequest> {
    let Some(toml) = &source.recipe else {
        let mut request: DetectabilityRequest = of_json(py, given)?;
        if let Some(atoms) = &source.atoms {
            request.structure = AtomsSource::Given(atoms.structure().or_raise(py)?);
        }
        return Ok(request);
    };
    let recipe = checked(toml).or_raise(py)?;
    let mut base = DetectabilityRequest::of_recipe(&recipe).or_raise(py)?;
    let structure = std::mem::replace(&mut base.structure, AtomsSource::File("".into()));
    let mut merged = serde_json::to_value(&base).map_err(Fault::from).or_raise(py)?;
    put(given, &mut merged);
    Ok(DetectabilityRequest { structure, ..of_json(py, merged)? })
}

/// Tests a defect. Returns the report as JSON, its sentences, its table (CSV) and its curves (SVG).
#[pyfunction]
pub fn detectability(
    py: Python<'_>,
    request: &Bound<'_, PyAny>,
    source: DefectSource,
    force: bool,
    running: Running,
) -> PyResult<(String, Vec<String>, String, String)> {
    let given: Value = depythonize(request)?;
    let request = request_of(py, given, &source)?;
    let work = move |call: &LongCall| -> Result<_, Fault> {
        let job = DetectabilityJob::new(request, &source.name)?;
        job.warnings().iter().for_each(|warning| call.warn(&warning.message));
        if !force {
            job.check_memory()?;
        }
        let report = job.run(call)?;
        let json = serde_json::to_string(&report)?;
        Ok((json, report.sentences(), report.to_csv(), power_svg(&report)))
    };
    run(py, running, work)
}
