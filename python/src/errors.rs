//! Converts errors of the library to exceptions, which `stemworlds.errors` makes.

use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use stemgen::{Error, Setting};

/// The system's error number for a file that exists already.
const EXISTS: i32 = 17;

/// A fault in Rust code.
#[derive(Debug)]
pub enum Fault {
    /// An error of the library.
    Library(Box<Error>),
    /// A value that this module refuses: setting, value, expected values.
    Value(Setting, String, String),
    /// A request that cannot be fulfilled, with the message.
    Words(String),
    /// A fault of the program.
    Internal(String),
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        Fault::Library(Box::new(error))
    }
}

impl From<serde_json::Error> for Fault {
    fn from(error: serde_json::Error) -> Self {
        Fault::Internal(error.to_string())
    }
}

/// The facts that `stemworlds.errors` needs.
#[derive(Default)]
struct Facts {
    kind: &'static str,
    message: String,
    setting: Option<Setting>,
    path: Option<PathBuf>,
    errno: Option<i32>,
}

impl Facts {
    fn of(fault: &Fault) -> Self {
        match fault {
            Fault::Library(error) => {
                Facts { message: error.to_string(), ..Self::of_library(error) }
            }
            Fault::Value(setting, value, expected) => Facts {
                kind: "value",
                message: format!("{setting} = {value}: {expected}"),
                setting: Some(*setting),
                ..Facts::default()
            },
            Fault::Words(message) => {
                Facts { kind: "value", message: message.clone(), ..Facts::default() }
            }
            Fault::Internal(message) => {
                Facts { kind: "internal", message: message.clone(), ..Facts::default() }
            }
        }
    }

    fn of_library(error: &Error) -> Self {
        let of = |kind| Facts { kind, ..Facts::default() };
        let at = |kind, path: &PathBuf| Facts { path: Some(path.clone()), ..of(kind) };
        match error {
            Error::Io { path, source, .. } => Facts { errno: errno(source), ..at("file", path) },
            Error::Parse { path, .. } => at("format", path),
            Error::Choice { setting, .. } => Facts { setting: Some(*setting), ..of("value") },
            Error::Invalid { setting: Setting::Output, value, .. } if Path::new(value).exists() => {
                Facts {
                    setting: Some(Setting::Output),
                    errno: Some(EXISTS),
                    ..at("file", &PathBuf::from(value))
                }
            }
            Error::Invalid { setting: setting @ Setting::WorldFile, value, .. } => {
                Facts { setting: Some(*setting), ..at("format", &PathBuf::from(value)) }
            }
            Error::Invalid { setting, .. } => Facts { setting: Some(*setting), ..of("value") },
            Error::DetectorBeyondBandLimit { .. } => {
                Facts { setting: Some(Setting::SamplingAngstrom), ..of("value") }
            }
            Error::UnknownElement(_) | Error::Set { .. } => of("value"),
            Error::DiskSpace { path, .. } => at("disk", path),
            Error::Locked { path, .. } => at("locked", path),
            Error::Hdf5 { path, .. } => at("file", path),
            Error::Memory { .. } => of("memory"),
            Error::Interrupted => of("interrupted"),
            _ => of("internal"),
        }
    }
}

/// Returns the system's error number, also for an error that the library made.
fn errno(source: &std::io::Error) -> Option<i32> {
    use std::io::ErrorKind::{AlreadyExists, IsADirectory, NotFound, PermissionDenied};
    let of_kind = || match source.kind() {
        NotFound => Some(2),
        PermissionDenied => Some(13),
        AlreadyExists => Some(EXISTS),
        IsADirectory => Some(21),
        _ => None,
    };
    source.raw_os_error().or_else(of_kind)
}

/// Makes the exception for a fault.
pub fn error(py: Python<'_>, fault: Fault) -> PyErr {
    let Facts { kind, message, setting, path, errno } = Facts::of(&fault);
    if kind == "interrupted" {
        return PyKeyboardInterrupt::new_err(());
    }
    let setting = setting.map(|setting| format!("{setting:?}"));
    let make = || {
        let module = py.import("stemworlds.errors")?;
        module.call_method1("_of_library", (kind, &message, setting, path, errno))
    };
    match make() {
        Ok(exception) => PyErr::from_value(exception),
        Err(_) => PyRuntimeError::new_err(message),
    }
}

/// Returns the names of all settings of the library, for the test that each has a keyword.
#[pyfunction]
pub fn settings() -> Vec<String> {
    Setting::ALL.iter().map(|setting| format!("{setting:?}")).collect()
}

/// Converts the results of short calls for Python.
pub trait OrRaise<T> {
    /// Returns the value, or the exception.
    ///
    /// # Errors
    /// The fault as an exception.
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T, E: Into<Fault>> OrRaise<T> for Result<T, E> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|fault| error(py, fault.into()))
    }
}
