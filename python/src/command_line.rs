//! Runs the program `stemgen` in a process of Python.

use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;
use stemgen_cli::{Invocation, run};

/// Runs the command line with `arguments`, at most once in a process. Returns the exit code. `again` holds the program and the first
/// arguments that start it again.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<OsString>, again: Vec<OsString>) -> u8 {
    py.detach(|| run(Invocation { arguments, again }))
}

/// Reads an HDF5 file in a separate process, which `again` starts, since a damaged file may crash or hang the process.
///
/// # Errors
/// The file cannot be read completely.
#[pyfunction]
pub fn check_file(py: Python<'_>, path: PathBuf, again: Vec<OsString>) -> PyResult<()> {
    use crate::errors::OrRaise;
    Invocation { arguments: Vec::new(), again }.remember();
    py.detach(|| stemgen_cli::survive(&path)).or_raise(py)
}
