//! Errors of the library. Each says what was wrong, where, and what would do instead.

use crate::setting::Setting;
use std::path::{Path, PathBuf};

/// Result of the library's functions.
pub type Result<T> = std::result::Result<T, Error>;

/// What can go wrong. A front end adds to the message which of its own options mends it: see [`Setting`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read or written.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What was tried: "read", "create", "rename" ...
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
        /// What is wrong and what was expected.
        message: String,
    },
    /// An element symbol or number that is not known.
    #[error("unknown element `{0}`; symbols such as `Sr` or atomic numbers 1-{max} are known", max = crate::constants::MAX_ATOMIC_NUMBER)]
    UnknownElement(String),
    /// A setting is outside its limits.
    #[error("{}: {expected}", assignment(*setting, value))]
    Invalid {
        /// The setting.
        setting: Setting,
        /// The value given.
        value: String,
        /// What is allowed, and what to do.
        expected: String,
    },
    /// A file leaves a setting open, or contradicts the one that was chosen.
    #[error("{}: {message}", path.display())]
    Choice {
        /// The file.
        path: PathBuf,
        /// The setting that decides.
        setting: Setting,
        /// What the file holds, and what to do.
        message: String,
    },
    /// A changed value of a recipe does not fit.
    #[error("{assignment}: {message}")]
    Set {
        /// The assignment, `key=value`.
        assignment: String,
        /// What is wrong and what was expected.
        message: String,
    },
    /// A disk has no room for what will be written.
    #[error(
        "{}: about {} are needed and {} are free; free some space, or name another place",
        path.display(),
        megabytes(*needed_bytes),
        megabytes(*free_bytes)
    )]
    DiskSpace {
        /// The folder.
        path: PathBuf,
        /// Estimate of what will be written.
        needed_bytes: u64,
        /// What is free.
        free_bytes: u64,
    },
    /// There is less memory than a simulation will take.
    #[error(
        "about {} of memory are needed and {} are free; {remedy}",
        megabytes(*needed_bytes),
        megabytes(*free_bytes)
    )]
    Memory {
        /// Estimate of the largest arrays.
        needed_bytes: u64,
        /// What this process may still take.
        free_bytes: u64,
        /// What takes less.
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
    /// The detector asks for angles that the grid does not carry.
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
        /// Sampling that would carry the outer angle.
        needed_angstrom: f64,
    },
    /// HDF5 library failure.
    #[cfg(feature = "hdf5")]
    #[error("{}: HDF5: {source}", path.display())]
    Hdf5 {
        /// The file.
        path: PathBuf,
        /// The library's reason.
        source: hdf5::Error,
    },
    /// The user asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Longest number that is written with all its digits.
const LONGEST_NUMBER: usize = 24;

/// A value as it was given, but for numbers of hundreds of digits, such as 1e308.
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
    pub fn choice(path: &Path, setting: Setting, message: impl Into<String>) -> Self {
        Error::Choice { path: path.to_owned(), setting, message: message.into() }
    }
    /// Builds an [`Error::Set`].
    pub fn set(assignment: &str, message: impl Into<String>) -> Self {
        Error::Set { assignment: assignment.to_owned(), message: message.into() }
    }
    /// Builds an [`Error::Hdf5`].
    #[cfg(feature = "hdf5")]
    pub fn hdf5(path: &Path, source: hdf5::Error) -> Self {
        Error::Hdf5 { path: path.to_owned(), source }
    }
}

/// `:12`, or nothing where there is no line.
fn at_line(line: usize) -> String {
    if line == 0 { String::new() } else { format!(":{line}") }
}

/// `setting = value`; of a recipe, whose values are assignments themselves, the value alone.
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
