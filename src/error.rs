//! Errors of the library. Each gives the fault, its place, and the remedy.

use crate::setting::Setting;
use std::path::{Path, PathBuf};

/// Result of the library's functions.
pub type Result<T> = std::result::Result<T, Error>;

/// Errors of the library. A front end adds to the message which of its options mends the fault: see [`Setting`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The attempted action: "read", "create", "rename" ...
        action: &'static str,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A text file is malformed; `line` counts from 1, or is 0 when the fault has no line.
    #[error("{}{}: {message}", path.display(), at_line(*line))]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line number from 1, or 0.
        line: usize,
        /// The fault, and the expected text.
        message: String,
    },
    /// An unknown element symbol or number.
    #[error("unknown element `{0}`; symbols such as `Sr` or atomic numbers 1-{max} are known", max = crate::constants::MAX_ATOMIC_NUMBER)]
    UnknownElement(String),
    /// A setting is outside its limits.
    #[error("{}: {expected}", assignment(*setting, value))]
    Invalid {
        /// The setting.
        setting: Setting,
        /// The value given.
        value: String,
        /// The allowed values, and the remedy.
        expected: String,
    },
    /// A file leaves a setting open, or contradicts the one that was chosen.
    #[error("{}: {message}", path.display())]
    Choice {
        /// The file.
        path: PathBuf,
        /// The setting that decides.
        setting: Setting,
        /// The content of the file, and the remedy.
        message: String,
    },
    /// A changed value of a recipe is invalid.
    #[error("{assignment}: {message}")]
    Set {
        /// The assignment, `key=value`.
        assignment: String,
        /// The fault, and the expected value.
        message: String,
    },
    /// A disk has not enough room for the output.
    #[error(
        "{}: about {} are needed and {} are free; free some space, or name another place",
        path.display(),
        megabytes(*needed_bytes),
        megabytes(*free_bytes)
    )]
    DiskSpace {
        /// The folder.
        path: PathBuf,
        /// Estimated size of the output.
        needed_bytes: u64,
        /// Free bytes of the disk.
        free_bytes: u64,
    },
    /// There is less memory than a simulation needs.
    #[error(
        "about {} of memory are needed and {} are free; {remedy}",
        megabytes(*needed_bytes),
        megabytes(*free_bytes)
    )]
    Memory {
        /// Estimated size of the largest arrays.
        needed_bytes: u64,
        /// Bytes that this process may still allocate.
        free_bytes: u64,
        /// Advice that needs less memory.
        remedy: String,
    },
    /// Another process is writing the same output.
    #[error("{}: is being written by {holder}; wait for it, or name another output", path.display())]
    Locked {
        /// The output.
        path: PathBuf,
        /// Who holds the lock.
        holder: String,
    },
    /// The detector needs angles that the grid does not carry.
    #[error(
        "detector `{name}` reaches {outer_mrad:.1} mrad, but the grid carries scattering only to \
         {limit_mrad:.1} mrad (sampling {sampling_angstrom:.4} A); use a sampling of \
         {needed_angstrom:.4} A or finer, or an outer angle up to {limit_mrad:.1} mrad"
    )]
    DetectorBeyondBandLimit {
        /// Detector name.
        name: String,
        /// Requested outer angle.
        outer_mrad: f64,
        /// The grid's band limit.
        limit_mrad: f64,
        /// The grid's coarser sampling.
        sampling_angstrom: f64,
        /// Sampling that carries the outer angle.
        needed_angstrom: f64,
    },
    /// HDF5 library failure.
    #[error("{}: HDF5: {source}", path.display())]
    Hdf5 {
        /// The file.
        path: PathBuf,
        /// The library's reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The user has stopped the computation.
    #[error("interrupted")]
    Interrupted,
}

/// Largest number of characters of a number that is written with all its digits.
const LONGEST_NUMBER: usize = 24;

/// Shortens numbers of hundreds of digits, such as 1e308; other values stay as given.
fn readable(value: String) -> String {
    match value.parse::<f64>() {
        Ok(number) if value.len() > LONGEST_NUMBER => format!("{number:e}"),
        _ => value,
    }
}

impl Error {
    /// Builds an [`Error::Io`].
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Error::Io { path: path.to_owned(), action, source }
    }
    /// Builds an [`Error::Invalid`].
    pub fn invalid(setting: Setting, value: impl ToString, expected: impl Into<String>) -> Self {
        Error::Invalid { setting, value: readable(value.to_string()), expected: expected.into() }
    }
    /// Builds an [`Error::Parse`].
    pub fn parse(path: &Path, line: usize, message: impl Into<String>) -> Self {
        Error::Parse { path: path.to_owned(), line, message: message.into() }
    }
    /// Builds an [`Error::Choice`].
    pub(crate) fn choice(path: &Path, setting: Setting, message: impl Into<String>) -> Self {
        Error::Choice { path: path.to_owned(), setting, message: message.into() }
    }
    /// Builds an [`Error::Set`].
    pub(crate) fn set(assignment: &str, message: impl Into<String>) -> Self {
        Error::Set { assignment: assignment.to_owned(), message: message.into() }
    }
    /// Builds an [`Error::Hdf5`].
    #[cfg(feature = "hdf5")]
    pub(crate) fn hdf5(path: &Path, source: hdf5::Error) -> Self {
        Error::Hdf5 { path: path.to_owned(), source: Box::new(source) }
    }
}

/// `:12`, or nothing for a fault without a line.
fn at_line(line: usize) -> String {
    if line == 0 { String::new() } else { format!(":{line}") }
}

/// `setting = value`. For a recipe, whose values are assignments already, only the value.
fn assignment(setting: Setting, value: &str) -> String {
    match setting {
        Setting::Recipe => value.to_owned(),
        _ => format!("{setting} = {value}"),
    }
}

fn megabytes(bytes: u64) -> String {
    match bytes {
        1_000_000_000.. => format!("{:.1} GB", bytes as f64 / 1e9),
        _ => format!("{:.1} MB", bytes as f64 / 1e6),
    }
}
