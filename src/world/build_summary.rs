//! What a build tells of its result.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::truth::Counts;
use crate::imaging::Audit;

/// What was built.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct BuildSummary {
    /// The file.
    pub path: PathBuf,
    /// Rows and columns of tiles.
    pub grid: [usize; 2],
    /// Height and width in nm.
    pub fov_nm: [f64; 2],
    /// Lattice sites, vacancies and columns listed.
    pub counts: Counts,
    /// Name of the method.
    pub engine: String,
    /// The audit made before, if one was asked for.
    pub audit: Option<Audit>,
    /// Images of the mosaic's library, and how many of them had to be simulated.
    pub library: Option<[usize; 2]>,
    /// Sub-tiles in all.
    pub subtiles: usize,
    /// Sub-tiles that an earlier run had left.
    pub subtiles_resumed: usize,
    /// Least and greatest value of the stored image, in fractions of the beam.
    pub range: [f32; 2],
    /// Time of this run in s.
    pub wall_time_s: f64,
}
