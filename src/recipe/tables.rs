//! The tables of a recipe.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::lengths;
use crate::models::particles::Morphology;
use crate::plane;
use crate::recipe::crystal_source::CrystalSource;
use crate::recipe::region::Region;
use crate::structure::elements;

/// Specimen builders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StructureKind {
    /// A crystal in grains that are rotated alternately about the beam.
    Grains,
    /// A crystal in domains of two phases with smooth, wavy boundaries.
    Domains,
    /// A crystal grown along +x, of which one element is partly replaced: a composition gradient, or
    /// quantum wells.
    Epitaxy,
    /// Metal particles on a film of amorphous carbon.
    Particles,
    /// The atoms of a file.
    Atoms,
    /// Layers of several crystals.
    Stack,
}

impl StructureKind {
    /// Returns the name that recipes use.
    pub(crate) fn name(self) -> &'static str {
        match self {
            StructureKind::Grains => "grains",
            StructureKind::Domains => "domains",
            StructureKind::Epitaxy => "epitaxy",
            StructureKind::Particles => "particles",
            StructureKind::Atoms => "atoms",
            StructureKind::Stack => "stack",
        }
    }

    /// Whether recipes of this kind name no crystal and no zone axis of their own.
    pub(crate) fn lacks_crystal(self) -> bool {
        matches!(self, StructureKind::Atoms | StructureKind::Stack)
    }
}

/// Number of pixels along each axis that one pixel of a world's overview averages.
pub(crate) const OVERVIEW_FACTOR: usize = 8;

/// Field of view, tiles and thickness.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// Height and width of the full field in nm.
    pub fov_nm: [f64; 2],
    /// Rows and columns of tiles of the full field.
    pub grid: [usize; 2],
    /// Rows and columns of tiles of the central part that is built; all when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<[usize; 2]>,
    /// Edge of a tile in pixels.
    pub tile_px: usize,
    /// Pixels shared by neighbouring tiles.
    pub overlap_px: usize,
    /// Thickness along the beam in nm, rounded to whole cells of a crystal. For particles on a film: the thickness of the film. For the
    /// atoms of a file: at least their extent.
    pub thickness_nm: f64,
}

/// Straight symmetric tilt boundaries along y, equally spaced in x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Boundaries {
    /// Number of boundaries.
    pub count: usize,
    /// Rotation between neighbouring grains in degrees.
    pub misorientation_deg: f64,
    /// Coincidence index; the exact coincidence angle then replaces `misorientation_deg`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<u32>,
    /// Least distance per pair of elements (`"Ti-O"`) in Angstrom. Other pairs keep 0.8 times their shortest distance
    /// in the crystal.
    #[serde(default)]
    pub min_distance_angstrom: BTreeMap<String, f64>,
}

/// Least distance at a boundary divided by the shortest in the crystal, for pairs that a recipe leaves out.
pub(crate) const DEFAULT_MIN_DISTANCE: f64 = 0.8;

/// Domains of two phases that share one lattice of atoms, side by side along x; the first phase is
/// the recipe's crystal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DomainTable {
    /// Crystal of the second phase: the same atoms, moved by less than a tenth of the cell.
    pub crystal: CrystalSource,
    /// Direction of the second phase along the beam.
    pub zone_axis: String,
    /// Direction of the second phase along +y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Names of the two phases.
    pub phases: [String; 2],
    /// Number of phase boundaries, equally spaced in x; the leftmost domain is of the first phase.
    pub boundaries: usize,
    /// The order parameter passes from one phase to the other as a Gaussian cumulative distribution
    /// of this standard deviation, in pixels.
    pub sharpness_sigma_px: f64,
    /// Greatest excursion of a boundary from its mean line, as a fraction of the field's width.
    pub waviness: f64,
}

/// An alloy: a guest element on some sites of a host element. The crystal grows along +x on a substrate of the pure crystal and is coherent
/// with it: across x it has the lattice parameters of the substrate. Along x it has the parameter of Vegard's law, lengthened by elastic
/// strain if stiffness constants are given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alloy {
    /// Symbol of the element that is replaced.
    pub host: String,
    /// Symbol of the element that replaces it.
    pub guest: String,
    /// Mean fraction of guests on the host's sites of the full field.
    pub rate: f64,
    /// Composition as a function of x.
    pub profile: CompositionProfile,
    /// The crystal with all hosts replaced: same structure, other lattice parameters.
    pub end_member: CrystalSource,
    /// Stiffness C13 (of a cubic crystal grown along a cube axis C12) of crystal and end member in GPa.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c13_gpa: Option<[f64; 2]>,
    /// Stiffness C33 (C11) of crystal and end member in GPa.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c33_gpa: Option<[f64; 2]>,
}

/// Composition of an alloy as a function of x.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompositionProfile {
    /// Rises linearly across the full field from 0 to twice the rate.
    Linear,
    /// Quantum wells in barriers without guests.
    Wells,
}

/// Quantum wells normal to x, centred in equal parts of the full field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wells {
    /// Number of wells.
    pub count: usize,
    /// Width of each well in nm.
    pub width_nm: f64,
    /// Standard deviation of the interfaces about their mean planes, in nm.
    pub roughness_nm: f64,
    /// Correlation length of the roughness in nm: its correlation falls as exp(-r^2 / 2 L^2).
    pub roughness_correlation_nm: f64,
}

/// Particles of the recipe's crystal, a face-centred cubic metal, on a film of amorphous carbon. They lie on its side
/// towards the gun, each wholly inside the full field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Particles {
    /// Number of particles in the full field.
    pub count: usize,
    /// Shapes, in equal shares.
    pub morphologies: Vec<Morphology>,
    /// Least and greatest diameter in nm: the diameter of a sphere of bulk metal with the same number of atoms. Between them every diameter
    /// is equally likely.
    pub diameter_nm: [f64; 2],
    /// Greatest angle between the beam and a zone axis of the particle in degrees; all directions within it are equally likely. From 90 on,
    /// all orientations are.
    pub max_tilt_deg: f64,
    /// Least distance between the circles around two particles, in projection along the beam, in nm.
    pub gap_nm: f64,
    /// Surface energy of {100} divided by the surface energy of {111}.
    pub surface_energy_ratio: f64,
    /// Distance of each particle's nearest atom from the carbon, in Angstrom.
    pub contact_angstrom: f64,
}

/// Most clusters of vacancies.
pub(crate) const MOST_CLUSTERS: usize = 1000;

fn none(count: &usize) -> bool {
    *count == 0
}

/// Vacancies of one element.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vacancies {
    /// Symbol of the element that is missing.
    pub element: String,
    /// Vacant fraction of all sites of the element.
    pub rate: f64,
    /// Share of the vacancies gathered about the boundaries, or in clusters.
    pub cluster_fraction: f64,
    /// Standard deviation of the distance of gathered vacancies from the boundary, or from the centre of the cluster along each axis, in nm.
    pub cluster_sigma_nm: f64,
    /// Number of clusters in the full field, at random places; with 0, vacancies gather about the boundaries.
    #[serde(default, skip_serializing_if = "none")]
    pub clusters: usize,
    /// Upper limit of the local vacancy probability.
    pub max_probability: f64,
    /// Distance by which cations beside a vacancy move away from it, in Angstrom.
    #[serde(default)]
    pub relaxation_angstrom: f64,
}

/// Random substitutions of one element by another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Substitutions {
    /// Symbol of the element that is replaced.
    pub element: String,
    /// Symbol of the element that replaces it.
    pub by: String,
    /// Replaced fraction of all sites of the element.
    pub rate: f64,
}

/// A further kind of point defect, on sites drawn at random.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointDefect {
    /// Symbol of the element concerned.
    pub element: String,
    /// Symbol of the element that replaces it; without it the site is vacant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Fraction of all sites of the element that are defects of this kind.
    pub rate: f64,
}

/// Largest number of kinds of point defects in `[[defects]]`.
pub(crate) const MOST_POINT_DEFECTS: usize = 6;

/// Thermal vibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhononTable {
    /// Number of frozen configurations that are averaged.
    pub configurations: usize,
    /// Seed of the library's displacements and depths of defects. All worlds with one number share their library, with any `seed`;
    /// another number gives a library without any image of this one.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub library_seed: u64,
    /// Standard deviation of each Cartesian component in Angstrom, per element.
    pub sigma_angstrom: BTreeMap<String, f64>,
}

/// Noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dose {
    /// Electrons per square Angstrom of the field.
    pub electrons_per_angstrom2: f64,
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

impl PhononTable {
    /// Returns the standard deviation of an element's displacements in Angstrom; 0 if the table leaves it out.
    pub(crate) fn sigma_angstrom(&self, number: u8) -> f64 {
        self.sigma_angstrom.get(elements::symbol(number)).copied().unwrap_or(0.0)
    }
}

impl Field {
    /// Returns the rows and columns of the tiles that are built.
    pub fn built_grid(&self) -> [usize; 2] {
        self.crop.unwrap_or(self.grid)
    }
    /// Returns height and width in pixels of `grid` tiles.
    pub fn pixels(&self, grid: [usize; 2]) -> [usize; 2] {
        grid.map(|n| n * self.stride_px() + self.overlap_px)
    }
    /// Returns the distance between neighbouring tiles in pixels.
    pub fn stride_px(&self) -> usize {
        self.tile_px - self.overlap_px
    }
    /// Returns the edge of a (square) pixel in nm: width of the full field divided by its number of pixels.
    pub fn pixel_nm(&self) -> f64 {
        self.fov_nm[1] / self.pixels(self.grid)[1] as f64
    }
    /// Returns the edge of a pixel in Angstrom.
    pub(crate) fn pixel_angstrom(&self) -> f64 {
        lengths::angstrom(self.pixel_nm())
    }
    /// Returns the thickness in Angstrom.
    pub(crate) fn thickness_angstrom(&self) -> f64 {
        lengths::angstrom(self.thickness_nm)
    }
    /// Returns the area of the full field.
    pub fn full_region(&self) -> Region {
        Region::of_pixels([0, 0], self.pixels(self.grid), self.pixel_nm())
    }
    /// Returns the area that is built.
    pub fn built_region(&self) -> Region {
        let shape = self.pixels(self.built_grid());
        Region::of_pixels(self.crop_origin_px(), shape, self.pixel_nm())
    }
    /// Returns the position (x, y), in nm of the full field, of the centre of the first pixel that is built. Positions in world files count
    /// from there.
    pub fn origin_nm(&self) -> [f64; 2] {
        let [row, column] = self.crop_origin_px();
        [column, row].map(|p| p as f64 * self.pixel_nm())
    }
    /// Returns row and column, in pixels of the full field, of the first pixel that is built.
    pub fn crop_origin_px(&self) -> [usize; 2] {
        let built = self.built_grid();
        plane::sub(self.grid, built).map(|n| n / 2 * self.stride_px())
    }
}
