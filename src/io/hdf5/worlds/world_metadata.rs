//! Reads the description of a world: the attributes of its file.

use std::path::Path;

use hdf5::File;

use super::{schema, world_detectors};
use crate::detect::Detector;
use crate::error::{Error, Result};
use crate::io::hdf5::hdf5_guard::{self, number, text};
use crate::setting::Setting;

/// Allowed edges of a pixel in nm.
const PIXELS_NM: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

/// Description of a world. Other programs may write fewer attributes; missing ones are `None`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct WorldMetadata {
    /// Edge of a pixel in nm.
    pub pixel_size_nm: f64,
    /// Edge of a tile in pixels.
    pub tile_size_px: usize,
    /// Pixels that neighbouring tiles share.
    pub overlap_px: usize,
    /// Rows and columns of tiles.
    pub grid_shape: [usize; 2],
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Fraction of the beam = value * scale + offset.
    pub scaling: Option<[f64; 2]>,
    /// Resolved recipe as TOML.
    pub recipe: Option<String>,
    /// Version of stemgen that built it.
    pub version: Option<String>,
    /// Origin of the data, if the recipe gives it: `synthetic_replay`.
    pub source: Option<String>,
    /// Name of the engine that simulated the image.
    pub engine: Option<String>,
    /// Version of the numerics ([`crate::numerics`]).
    pub numerics: Option<u32>,
    /// Settings of the engine as JSON.
    pub engine_parameters: Option<String>,
    /// Material or identifier of the recipe.
    pub material: Option<String>,
    /// Thickness of the specimen in nm.
    pub thickness_nm: Option<f64>,
    /// Electrons per square Angstrom.
    pub dose_electrons_per_angstrom2: Option<f64>,
    /// Whether the tiles hold the noise of the dose.
    pub noise: Option<bool>,
    /// Seed of all random numbers.
    pub seed: Option<u64>,
    /// Time that the last run of the build took, in s.
    pub wall_time_s: Option<f64>,
    /// The detectors of a world with names for them, the main one first; otherwise empty.
    pub detectors: Vec<Detector>,
}

/// Returns the error for a file that is no world, or no complete one.
pub(super) fn not_a_world(path: &Path, what: impl Into<String>) -> Error {
    Error::invalid(Setting::WorldFile, path.display(), what)
}

/// Reads `/metadata` of a file.
///
/// # Errors
/// [`Error::Invalid`] for a file that is no world, and for values that no world can have.
pub(super) fn read_metadata(path: &Path, file: &File) -> Result<WorldMetadata> {
    let group = file.group(schema::METADATA);
    let group = group.map_err(|_| not_a_world(path, format!("is not a world: {}", found(file))))?;
    let missing = |name: &str| not_a_world(path, format!("/metadata has no usable `{name}`"));
    let need = |name: &str| number::<f64>(&group, name).ok_or_else(|| missing(name));
    let pair = |name: &str| hdf5_guard::pair(&group, name).ok_or_else(|| missing(name));
    let size = |value: f64, name: &str| match (0.0..1e9).contains(&value) && value.fract() == 0.0 {
        true => Ok(value as usize),
        false => Err(missing(name)),
    };
    let grid = pair("grid_shape")?;
    let metadata = WorldMetadata {
        pixel_size_nm: need("pixel_size_nm")?,
        tile_size_px: size(need("tile_size_px")?, "tile_size_px")?,
        overlap_px: size(need("overlap_px")?, "overlap_px")?,
        grid_shape: [size(grid[0], "grid_shape")?, size(grid[1], "grid_shape")?],
        fov_nm: pair("fov_nm")?,
        scaling: scaling(file, schema::TILES),
        recipe: text(&group, "recipe"),
        version: text(&group, "stemgen_version"),
        numerics: text(&group, "numerics_version").and_then(|v| v.parse().ok()),
        source: text(&group, "source"),
        engine: text(&group, "engine"),
        engine_parameters: text(&group, "engine_parameters"),
        material: text(&group, "material"),
        thickness_nm: number(&group, "thickness_nm"),
        noise: number::<u8>(&group, "noise").map(|value| value != 0),
        dose_electrons_per_angstrom2: number(&group, "dose_electrons_per_angstrom2"),
        seed: number(&group, "seed"),
        wall_time_s: number(&group, "wall_time_s"),
        detectors: world_detectors::read(file).map_err(|fault| not_a_world(path, fault))?,
    };
    if !PIXELS_NM.contains(&metadata.pixel_size_nm) {
        return Err(missing("pixel_size_nm"));
    }
    let finite = |value: &f64| value.is_finite();
    if metadata.scaling.is_some_and(|s| !s.iter().all(finite)) {
        return Err(not_a_world(path, "/tiles has a scale or offset that is no finite number"));
    }
    if metadata.scaling.is_some_and(|[scale, _]| scale <= 0.0) {
        return Err(not_a_world(path, "/tiles has a scale that is not above 0"));
    }
    if metadata.dose_electrons_per_angstrom2.is_some_and(|d| !(d > 0.0 && d.is_finite())) {
        return Err(missing("dose_electrons_per_angstrom2"));
    }
    if metadata.thickness_nm.is_some_and(|t| !(t > 0.0 && t.is_finite())) {
        return Err(missing("thickness_nm"));
    }
    if metadata.overlap_px >= metadata.tile_size_px {
        return Err(missing("overlap_px"));
    }
    if metadata.grid_shape.contains(&0) || metadata.grid_shape.iter().any(|n| *n > 100_000) {
        return Err(missing("grid_shape"));
    }
    Ok(metadata)
}

/// Reads scale and offset of a group of tiles.
pub(super) fn scaling(file: &File, tiles: &str) -> Option<[f64; 2]> {
    let tiles = file.group(tiles).ok()?;
    Some([number::<f64>(&tiles, "scale")?, number::<f64>(&tiles, "offset")?])
}

/// Describes an HDF5 file without the metadata of a world.
fn found(file: &File) -> String {
    if text(file, "format").as_deref() == Some("stemgen images") {
        return "it holds images of `stemgen simulate`, which can draw them itself".into();
    }
    let mut names = file.member_names().unwrap_or_default();
    names.sort();
    let more = if names.len() > 5 { ", ..." } else { "" };
    names.truncate(5);
    match names.is_empty() {
        true => "it is empty; a world has the group /metadata".into(),
        false => format!("it has no group /metadata, but {}{more}", names.join(", ")),
    }
}
