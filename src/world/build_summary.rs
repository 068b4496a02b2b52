//! Reports of a build: its result, and warnings about its accuracy beforehand.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::truth::Counts;
use crate::imaging::Audit;
use crate::recipe::Recipe;

/// Rms error in per cent at bright columns where the effect of carbon before the specimen on the probe is left out: a constant, and the
/// increase for each nm of carbon. Audits of SrTiO3 of 4 nm found 1.15, 2.0 and 3.7 with 1, 3 and 5 nm.
const LAYER_ERROR_PERCENT: [f64; 2] = [0.4, 0.65];

/// The result of a build.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct BuildSummary {
    /// The file.
    pub path: PathBuf,
    /// Rows and columns of tiles.
    pub grid: [usize; 2],
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Numbers of sites, vacancies and columns in the file.
    pub counts: Counts,
    /// Name of the method.
    pub engine: String,
    /// The audit before the build, if one was made.
    pub audit: Option<Audit>,
    /// Number of images in the mosaic's library, and how many of them had to be simulated.
    pub library: Option<[usize; 2]>,
    /// Number of sub-tiles.
    pub subtiles: usize,
    /// Number of sub-tiles that an earlier run had left.
    pub subtiles_resumed: usize,
    /// Least and greatest value of the stored image, in fractions of the beam.
    pub range: [f32; 2],
    /// Time of this run in s.
    pub wall_time_s: f64,
}

/// Warns of a layer before the specimen whose effect on the probe is left out because columns share simulations.
pub(super) fn layer_warning(recipe: &Recipe) -> Option<String> {
    let nm = recipe.surface.map_or(0.0, |table| table.entrance_nm);
    let percent = LAYER_ERROR_PERCENT[0] + LAYER_ERROR_PERCENT[1] * nm;
    (nm > 0.0).then(|| {
        format!(
            "the {nm} nm of carbon before the specimen scatter the probe, which a mosaic leaves out: bright columns are about {percent:.1} \
             % off; windows without a mosaic include this scattering, but need more time"
        )
    })
}
