//! Errors on standard error, each with a hint.

use super::progress::INTERRUPTED;
use super::text;
use std::process::ExitCode;
use stemgen::Error;

/// A failure together with what to do about it.
#[derive(Debug)]
pub struct Hinted {
    /// What went wrong.
    pub source: anyhow::Error,
    /// What to do.
    pub hint: String,
}

impl std::fmt::Display for Hinted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.source.fmt(f)
    }
}

impl std::error::Error for Hinted {}

/// An error with a hint of its own.
pub fn hinted(source: impl Into<anyhow::Error>, hint: impl Into<String>) -> anyhow::Error {
    anyhow::Error::new(Hinted { source: source.into(), hint: hint.into() })
}

/// Prints the error and its hint; returns the exit code.
pub fn report(error: &anyhow::Error, subcommand: &str) -> ExitCode {
    let (error, own) = match error.downcast_ref::<Hinted>() {
        Some(h) => (&h.source, Some(h.hint.clone())),
        None => (error, None),
    };
    let known = error.chain().find_map(|e| e.downcast_ref::<Error>());
    let hint = own.or_else(|| known.and_then(hint));
    let fallback = || format!("`stemgen {subcommand} --help` explains every option");
    text::complain(&format!("error: {error:#}"));
    text::complain(&format!("hint: {}", hint.unwrap_or_else(fallback)));
    match known {
        Some(Error::Interrupted) => ExitCode::from(INTERRUPTED),
        _ => ExitCode::FAILURE,
    }
}

/// What would mend an error of the library.
fn hint(error: &Error) -> Option<String> {
    match error {
        Error::Io { source, action, .. } => io_hint(source, action).map(str::to_owned),
        Error::Parse { .. } => {
            Some("the file is not as expected there; mend or export it again".into())
        }
        Error::Set { .. } => {
            Some("`stemgen show-recipe` with the same MATERIAL prints all keys and values".into())
        }
        Error::DiskSpace { .. } | Error::Locked { .. } => {
            Some("--output names another place".into())
        }
        Error::UnknownElement(_) => Some("elements H to Lr can be simulated".into()),
        Error::Invalid { what, .. } => Some(format!("see {}", flag(what)?)),
        Error::DetectorBeyondBandLimit { needed_angstrom, .. } => Some(format!(
            "--sampling {:.4} (or no --sampling at all) carries it; --allow-empty-angles goes on \
             with that part of the detector empty",
            floored(*needed_angstrom)
        )),
        Error::Hdf5 { .. } => Some("is the disk full, or the file open elsewhere?".into()),
        Error::Interrupted => Some("nothing was written; run the same command again".into()),
    }
}

/// Rounded down to four digits, so that what is printed is fine enough.
fn floored(sampling: f64) -> f64 {
    (sampling * 1e4).floor() * 1e-4
}

fn io_hint(source: &std::io::Error, action: &str) -> Option<&'static str> {
    use std::io::ErrorKind::{NotADirectory, NotFound, PermissionDenied, StorageFull};
    match source.kind() {
        NotFound if action == "read" => Some("check the name and the current folder"),
        NotFound | NotADirectory => Some("check the name of the folder; --output names another"),
        PermissionDenied if action == "read" => Some("you may not read this file"),
        PermissionDenied => Some("you may not write there; --output names another place"),
        StorageFull => Some("free some space, or name another place with --output"),
        _ => None,
    }
}

/// The option behind a setting of the library.
fn flag(what: &str) -> Option<&'static str> {
    Some(match what {
        "energy (keV)" => "--energy",
        "semiangle (mrad)" => "--semiangle, or --sampling for a finer grid",
        "detector" | "detectors" | "detector name" => "--detector",
        "sampling (A)" => "--sampling",
        "gpts" => "--gpts",
        "slice thickness (A)" => "--slice-thickness",
        "band fraction" => "--band-fraction",
        "band taper" => "--band-taper",
        "oversampling" => "--oversampling",
        "phonon configurations" => "--phonons",
        "interpolation" => "--interpolation",
        "window (A)" => "--window",
        "thickness (A)" => "--thicknesses, and --repeat for a thicker specimen",
        "output" => "--output and --overwrite",
        "zone" | "cell" => "--zone and --up",
        "up" => "--up",
        "repeat" | "number of atoms in the supercell" => "--repeat",
        "grid" => "--grid",
        "sub-tile (nm)" => "--subtile and --subtile-overlap",
        "case" => "--case, and --list for what there is",
        "alpha" => "--alpha",
        "material" => "MATERIAL, and --recipe for a recipe of your own",
        _ => return None,
    })
}
