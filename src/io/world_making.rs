//! How a world was made, as far as its file tells and [`super::WorldMetadata`] does not.

use super::hdf5_guard::{number, pair, text};
use super::schema;
use super::world_file::WorldFile;

/// How a world was made. Other programs may write fewer attributes: those are `None`.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct WorldMaking {
    /// Version of pixel values ([`crate::numerics`]).
    pub numerics_version: Option<u32>,
    /// Largest width, and overlap, of sub-tiles in nm, as they were asked for.
    pub subtile_nm: Option<[f64; 2]>,
    /// What an audit beforehand found, as JSON.
    pub audit: Option<String>,
    /// What the tiles were recorded with, as JSON.
    pub acquisition: Option<String>,
    /// Current of the beam of a recording in pA.
    pub beam_current_pa: Option<f64>,
}

impl WorldFile {
    /// How it was made.
    pub fn making(&self) -> WorldMaking {
        let Ok(group) = self.file.group(schema::METADATA) else { return WorldMaking::default() };
        WorldMaking {
            numerics_version: text(&group, "numerics_version").and_then(|t| t.parse().ok()),
            subtile_nm: pair(&group, "subtile_nm").filter(|nm| nm.iter().all(|v| v.is_finite())),
            audit: text(&group, "audit"),
            acquisition: text(&group, "acquisition"),
            beam_current_pa: number(&group, "beam_current_pa").filter(|v: &f64| v.is_finite()),
        }
    }
}
