//! Names and types of the datasets in a world file. Positions are in nm.

use hdf5::types::FixedAscii;

/// Group whose attributes describe the world.
pub const METADATA: &str = "metadata";
/// Low-resolution overview, normalised like the tiles.
pub const OVERVIEW: &str = "overview";
/// Group of normalised tiles.
pub const TILES: &str = "tiles";
/// Group of noiseless tiles, in fractions of the beam.
pub const CLEAN: &str = "clean";
/// Group of the detectors of a world with several: one group each, with its tiles, overview and noiseless tiles. The group of the main
/// detector links to the place of the images of a single detector.
pub const DETECTORS: &str = "detectors";
/// Group of the ground truth.
pub const TRUTH: &str = "ground_truth";
/// Dataset that is true for pixels that show specimen.
pub const VALID_REGION: &str = "valid_region";
/// Group of polylines below the ground truth.
pub const GRAIN_BOUNDARIES: &str = "grain_boundaries";
/// Group of polylines between phases below the ground truth.
pub const PHASE_BOUNDARIES: &str = "phase_boundaries";
/// Group of polylines of planar faults below the ground truth; only if there are some.
pub const FAULT_LINES: &str = "fault_lines";
/// Group of dislocations below the ground truth; only in stacks.
pub const DISLOCATIONS: &str = "dislocations";
/// Group of layers below the ground truth; only in stacks.
pub const LAYERS: &str = "layers";
/// Distance of each column from the nearest interface, in the group of columns; only in stacks with interfaces along the beam.
pub const INTERFACE_DISTANCE: &str = "interface_distance";
/// Phase of every pixel, below the ground truth; only if there is more than one phase.
pub const PHASE_MAP: &str = "phase_map";
/// Group of particles below the ground truth; only if there are particles.
pub const PARTICLES: &str = "particles";
/// Centres of clusters of vacancies below the ground truth; only if the recipe has clusters.
pub const CLUSTER_POSITIONS: &str = "cluster_positions";
/// Group of projected atomic columns below the ground truth.
pub const COLUMNS: &str = "columns";
/// Group below the ground truth with the unit cells that a recorded file lists; only if it lists some.
pub const UNIT_CELLS: &str = "unit_cells";

/// `defect_types`: `""`, `"vacancy_O"`, `"substitution_Ge"`.
pub type DefectName = FixedAscii<16>;
/// Shape of a particle: `wulff`.
pub type MorphologyName = FixedAscii<16>;
/// Composition of a column, vacant sites left out: `"O25 Ti26"`.
pub type CompositionText = FixedAscii<32>;

/// Returns the name of the dataset of a tile.
pub fn tile_name(row: usize, column: usize) -> String {
    format!("{row}_{column}")
}

/// Returns the path of the group of a detector.
pub fn detector_group(name: &str) -> String {
    format!("{DETECTORS}/{name}")
}
