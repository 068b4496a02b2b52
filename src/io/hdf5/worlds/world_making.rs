//! Reads how a world was made, as far as [`super::WorldMetadata`] does not hold it.

use serde::Serialize;

use super::schema;
use super::world_file::WorldFile;
use crate::io::hdf5::hdf5_guard::{number, pair, text};

/// How a world was made. Other programs may write fewer attributes: those are `None`.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct WorldMaking {
    /// Version of the numerics ([`crate::numerics`]).
    pub numerics_version: Option<u32>,
    /// Largest width and overlap of sub-tiles in nm, as requested.
    pub subtile_nm: Option<[f64; 2]>,
    /// The audit before the build, as JSON.
    pub audit: Option<String>,
    /// The settings of the recording, as JSON.
    pub acquisition: Option<String>,
    /// Current of the beam of a recording in pA.
    pub beam_current_pa: Option<f64>,
    /// Origin of a recorded image.
    pub recorded: Option<RecordedSource>,
}

/// Origin of the image of a world that was recorded at a microscope and not simulated.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RecordedSource {
    /// Name of the recorded file.
    pub file: String,
    /// Checksum of that file.
    pub sha256: Option<String>,
    /// Kind of that file.
    pub format: Option<String>,
    /// Name of the image in that file.
    pub image: Option<String>,
    /// Origin of the size of a pixel.
    pub pixel_size_from: Option<String>,
    /// Recorded values that became 0 and 1.
    pub normalisation: Option<String>,
    /// Replacement of missing values.
    pub gaps: Option<String>,
    /// Name of the detector.
    pub detector: Option<String>,
    /// Energy of the electrons.
    pub energy_kev: Option<f64>,
}

impl RecordedSource {
    fn of(group: &hdf5::Group) -> Option<Self> {
        let stated = |name: &str| text(group, name).filter(|value| !value.is_empty());
        Some(RecordedSource {
            file: stated("source_file")?,
            sha256: stated("source_sha256"),
            format: stated("source_format"),
            image: stated("source_image"),
            pixel_size_from: stated("pixel_size_from"),
            normalisation: stated("normalisation"),
            gaps: stated("gaps"),
            detector: stated("recorded_detector"),
            energy_kev: number(group, "recorded_energy_kev").filter(|v: &f64| v.is_finite()),
        })
    }
}

impl WorldFile {
    /// Reads how the world was made.
    pub fn making(&self) -> WorldMaking {
        let Ok(group) = self.file.group(schema::METADATA) else { return WorldMaking::default() };
        WorldMaking {
            numerics_version: text(&group, "numerics_version").and_then(|t| t.parse().ok()),
            subtile_nm: pair(&group, "subtile_nm").filter(|nm| nm.iter().all(|v| v.is_finite())),
            audit: text(&group, "audit"),
            acquisition: text(&group, "acquisition"),
            recorded: RecordedSource::of(&group),
            beam_current_pa: number(&group, "beam_current_pa").filter(|v: &f64| v.is_finite()),
        }
    }
}
