//! Kinds of files for patterns, which are recognised by the ending of their name.

use std::path::{Path, PathBuf};

use super::pattern_file::{PatternHeader, data_bytes};
use crate::detect::PatternDetector;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Number of pixels along an edge of the EMPAD.
pub(crate) const EMPAD_PIXELS: usize = 128;
/// Number of rows of an EMPAD frame behind the rows of its pixels.
pub(crate) const EMPAD_SPARE_ROWS: usize = 2;

/// A kind of file of patterns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PatternFormat {
    /// `.emd`: HDF5 that this program, py4DSTEM, LiberTEM and HyperSpy read.
    Emd,
    /// `.hspy`: HDF5 of HyperSpy.
    Hspy,
    /// `.toml`: counted electrons as sparse arrays (raw CSR of LiberTEM), with three files beside it.
    SparseCsr,
    /// `.raw`: float32 frames of the EMPAD, with their description as `.json` and `.xml` beside it.
    Empad,
}

impl PatternFormat {
    /// Returns the kind of a file.
    ///
    /// # Errors
    /// [`Error::Invalid`] for any other ending.
    pub fn of(path: &Path) -> Result<Self> {
        let ending = path.extension().map(|e| e.to_ascii_lowercase()).unwrap_or_default();
        match ending.to_str() {
            Some("emd") => Ok(PatternFormat::Emd),
            Some("hspy") => Ok(PatternFormat::Hspy),
            Some("toml") => Ok(PatternFormat::SparseCsr),
            Some("raw") => Ok(PatternFormat::Empad),
            _ => {
                let meant = path.with_extension("emd");
                let expected = format!(
                    "patterns are written as .emd, .hspy (HyperSpy), .toml (sparse counts for LiberTEM) or .raw (EMPAD); did you mean {}?",
                    meant.display()
                );
                Err(Error::invalid(Setting::OutputName, path.display(), expected))
            }
        }
    }

    /// Returns the ending, with the dot.
    pub(crate) fn ending(self) -> &'static str {
        match self {
            PatternFormat::Emd => ".emd",
            PatternFormat::Hspy => ".hspy",
            PatternFormat::SparseCsr => ".toml",
            PatternFormat::Empad => ".raw",
        }
    }

    /// Returns the further files that belong to a file of this kind.
    pub(crate) fn companions(self, path: &Path) -> Vec<PathBuf> {
        match self {
            PatternFormat::Emd | PatternFormat::Hspy => Vec::new(),
            PatternFormat::SparseCsr => ["indptr", "indices", "values"]
                .map(|part| {
                    let mut name = path.file_stem().unwrap_or_default().to_owned();
                    name.push(format!("_{part}.dat"));
                    path.with_file_name(name)
                })
                .to_vec(),
            PatternFormat::Empad => ["json", "xml"].map(|e| path.with_extension(e)).to_vec(),
        }
    }

    /// Refuses patterns that this kind of file cannot hold.
    ///
    /// # Errors
    /// [`Error::Invalid`] for rings in other files than `.emd`, for sparse files of patterns that are not counted, and for EMPAD files of
    /// other patterns than 128 x 128.
    pub(crate) fn check(self, header: &PatternHeader) -> Result<()> {
        let bad =
            |expected: &str| Err(Error::invalid(Setting::OutputName, self.ending(), expected));
        let pixels = match header.detector {
            PatternDetector::Pixels(detector) => detector.pixels,
            PatternDetector::Rings(_) if self == PatternFormat::Emd => return Ok(()),
            PatternDetector::Rings(_) => return bad("stores pixels only; write rings as .emd"),
        };
        match self {
            PatternFormat::SparseCsr if header.counted.is_none() => {
                bad("stores counted electrons only; give a dose, or write .emd")
            }
            PatternFormat::Empad if pixels != EMPAD_PIXELS => {
                bad("holds frames of 128 x 128 pixels; simulate as many, or write .emd")
            }
            _ => Ok(()),
        }
    }

    /// Estimates the number of bytes of the patterns; for sparse files one entry for each electron is assumed.
    pub fn bytes(self, header: &PatternHeader) -> u64 {
        let dense = data_bytes(header);
        match (self, header.counted) {
            (PatternFormat::SparseCsr, Some((electrons, _))) => {
                let hit = electrons.min(header.detector.values() as f64);
                8 * (header.scan.len() as u64) * (hit as u64 + 1)
            }
            (PatternFormat::Empad, _) => {
                dense / EMPAD_PIXELS as u64 * (EMPAD_PIXELS + EMPAD_SPARE_ROWS) as u64
            }
            _ => dense,
        }
    }
}
