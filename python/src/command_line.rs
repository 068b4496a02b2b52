//! The program `stemgen`, in a process of Python.

use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;
use stemgen_cli::{Invocation, run};

/// Runs the command line with `arguments`, once in a process, and returns the exit code. `again` is program and first arguments that
/// start it once more.
#[pyfunction]
pub fn main(py: Python<'_>, arguments: Vec<OsString>, again: Vec<OsString>) -> u8 {
    py.detach(|| run(Invocation { arguments, again }))
}

/// Reads through an HDF5 file in a process of its own, which `again` starts: damaged files may end or hang it.
///
/// # Errors
/// A file that cannot be read through.
#[pyfunction]
pub fn check_file(py: Python<'_>, path: PathBuf, again: Vec<OsString>) -> PyResult<()> {
    use crate::errors::Told;
    Invocation { arguments: Vec::new(), again }.remember();
    py.detach(|| stemgen_cli::survive(&path)).or_raise(py)
}
