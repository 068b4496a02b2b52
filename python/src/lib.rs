//! The extension module of `stemworlds`: thin glue between Python and the library.
//!
//! Python passes all options in dicts, which the package's Python sources (`stemworlds/`) document. Long calls run by `long_call`;
//! `stemworlds.errors` makes the exceptions.

mod bench;
mod builds;
mod caches;
mod checks;
mod command_line;
mod detectability;
mod errors;
mod files;
mod live;
mod long_call;
mod pattern_cubes;
mod recipes;
mod recordings;
mod replays;
mod request;
mod simulate;
mod specimens;
mod tiles;
mod words;
mod worlds;

use pyo3::prelude::*;
use pyo3::types::PyModule;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<bench::Episodes>()?;
    module.add_class::<live::LiveField>()?;
    module.add_class::<pattern_cubes::PatternReader>()?;
    module.add_class::<tiles::TileSource>()?;
    module.add_class::<worlds::WorldReader>()?;
    module.add_function(wrap_pyfunction!(bench::dose_checkpoints, module)?)?;
    module.add_function(wrap_pyfunction!(bench::dose_metrics, module)?)?;
    module.add_function(wrap_pyfunction!(builds::build_part, module)?)?;
    module.add_function(wrap_pyfunction!(builds::build_world, module)?)?;
    module.add_function(wrap_pyfunction!(builds::plan_build, module)?)?;
    module.add_function(wrap_pyfunction!(checks::audit_field, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_clear, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_export, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_fill, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_folder, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_import, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_list, module)?)?;
    module.add_function(wrap_pyfunction!(caches::cache_verify, module)?)?;
    module.add_function(wrap_pyfunction!(caches::library_folder, module)?)?;
    module.add_function(wrap_pyfunction!(caches::library_list, module)?)?;
    module.add_function(wrap_pyfunction!(caches::set_library, module)?)?;
    module.add_function(wrap_pyfunction!(checks::compare_worlds, module)?)?;
    module.add_function(wrap_pyfunction!(checks::verify_world, module)?)?;
    module.add_function(wrap_pyfunction!(checks::validate_suite, module)?)?;
    module.add_function(wrap_pyfunction!(checks::validation_cases, module)?)?;
    module.add_function(wrap_pyfunction!(command_line::check_file, module)?)?;
    module.add_function(wrap_pyfunction!(command_line::main, module)?)?;
    module.add_function(wrap_pyfunction!(detectability::detectability, module)?)?;
    module.add_function(wrap_pyfunction!(errors::settings, module)?)?;
    module.add_function(wrap_pyfunction!(files::save_hspy, module)?)?;
    module.add_function(wrap_pyfunction!(files::save_tiff, module)?)?;
    module.add_function(wrap_pyfunction!(pattern_cubes::detector_weights, module)?)?;
    module.add_function(wrap_pyfunction!(pattern_cubes::integrated_centre_of_mass, module)?)?;
    module.add_function(wrap_pyfunction!(pattern_cubes::simulate_patterns, module)?)?;
    module.add_function(wrap_pyfunction!(pattern_cubes::write_pattern_page, module)?)?;
    module.add_function(wrap_pyfunction!(pattern_cubes::write_patterns, module)?)?;
    module.add_function(wrap_pyfunction!(recipes::describe_recipe, module)?)?;
    module.add_function(wrap_pyfunction!(recipes::recipes, module)?)?;
    module.add_function(wrap_pyfunction!(recipes::resolve_recipe, module)?)?;
    module.add_function(wrap_pyfunction!(recordings::record_field, module)?)?;
    module.add_function(wrap_pyfunction!(replays::import_image, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::diffraction, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::exit_waves, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::plan_simulation, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate_places, module)?)?;
    module.add_function(wrap_pyfunction!(simulate::simulate_plane_wave, module)?)?;
    module.add_function(wrap_pyfunction!(specimens::draw_recipe, module)?)?;
    module.add_function(wrap_pyfunction!(specimens::specimen_sites, module)?)?;
    module.add_function(wrap_pyfunction!(worlds::png, module)?)?;
    module.add_function(wrap_pyfunction!(worlds::view_world, module)?)?;
    module.add_function(wrap_pyfunction!(worlds::write_file, module)?)?;
    Ok(())
}
