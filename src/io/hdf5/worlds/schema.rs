//! Names and types of the datasets in a world file. Positions are in nm.

use hdf5::types::FixedAscii;

/// Group whose attributes describe the world.
pub(crate) const METADATA: &str = "metadata";
/// Low-resolution overview, normalised like the tiles.
pub(crate) const OVERVIEW: &str = "overview";
/// Group of normalised tiles.
pub const TILES: &str = "tiles";
/// Group of noiseless tiles, in fractions of the beam.
pub(crate) const CLEAN: &str = "clean";
/// Group of the detectors of a world with several: one group each, with its tiles, overview and noiseless tiles. The group of the main
/// detector links to the place of the images of a single detector.
pub(crate) const DETECTORS: &str = "detectors";
/// Attribute of a detector's group: the axis of an image of a centre of mass.
pub(crate) const CENTRE_OF_MASS: &str = "centre_of_mass";
/// Group of the ground truth.
pub(crate) const TRUTH: &str = "ground_truth";
/// Dataset that is true for pixels that show specimen.
pub const VALID_REGION: &str = "valid_region";
/// Group of polylines below the ground truth.
pub(crate) const GRAIN_BOUNDARIES: &str = "grain_boundaries";
/// Group of polylines between phases below the ground truth.
pub(crate) const PHASE_BOUNDARIES: &str = "phase_boundaries";
/// Group of polylines of planar faults below the ground truth; only if there are some.
pub(crate) const FAULT_LINES: &str = "fault_lines";
/// Group of dislocations below the ground truth; only in stacks.
pub(crate) const DISLOCATIONS: &str = "dislocations";
/// Group of layers below the ground truth; only in stacks.
pub(crate) const LAYERS: &str = "layers";
/// Distance of each column from the nearest interface, in the group of columns; only in stacks with interfaces along the beam.
pub(crate) const INTERFACE_DISTANCE: &str = "interface_distance";
/// Phase of every pixel, below the ground truth; only if there is more than one phase.
pub(crate) const PHASE_MAP: &str = "phase_map";
/// Group of particles below the ground truth; only if there are particles.
pub(crate) const PARTICLES: &str = "particles";
/// Centres of clusters of vacancies below the ground truth; only if the recipe has clusters.
pub(crate) const CLUSTER_POSITIONS: &str = "cluster_positions";
/// Group of projected atomic columns below the ground truth.
pub(crate) const COLUMNS: &str = "columns";
/// Group below the ground truth with the unit cells that a recorded file lists; only if it lists some.
pub(crate) const UNIT_CELLS: &str = "unit_cells";

/// `defect_types`: `""`, `"vacancy_O"`, `"substitution_Ge"`.
pub(crate) type DefectName = FixedAscii<16>;
/// Shape of a particle: `wulff`.
pub(crate) type MorphologyName = FixedAscii<16>;
/// Composition of a column, vacant sites left out: `"O25 Ti26"`.
pub(crate) type CompositionText = FixedAscii<32>;

/// Returns the name of the dataset of a tile.
pub(crate) fn tile_name(row: usize, column: usize) -> String {
    format!("{row}_{column}")
}

/// Returns the path of the group of a detector.
pub(crate) fn detector_group(name: &str) -> String {
    format!("{DETECTORS}/{name}")
}
