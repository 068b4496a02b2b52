//! The table `[stack]` of a recipe: a specimen made of several crystals, with faults, dislocations and precipitates.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::crystal_source::CrystalSource;
use super::vacancy_groups_table::{DoubleVacancies, StackEdge, VacancyLines};
use crate::models::particles::Morphology;

/// Largest number of layers, and of faults, dislocations and precipitates each.
pub const MOST_PARTS: usize = 200;
/// Poisson's ratio where a recipe gives none.
pub const DEFAULT_POISSON_RATIO: f64 = 0.3;
/// Correlation length of rough interfaces in nm where a recipe gives none.
pub const DEFAULT_CORRELATION_NM: f64 = 3.0;

/// The direction in which layers follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StackDirection {
    /// Along x: interfaces are seen edge on, along y.
    #[default]
    X,
    /// Along y: interfaces are seen edge on, along x.
    Y,
    /// Along the beam: interfaces lie across the beam.
    Z,
}

impl StackDirection {
    /// Returns the number of the axis: 0 is x.
    pub fn axis(self) -> usize {
        self as usize
    }
    /// Returns the numbers of the two axes in the plane of the interfaces.
    pub fn in_plane(self) -> [usize; 2] {
        match self {
            StackDirection::X => [1, 2],
            StackDirection::Y => [0, 2],
            StackDirection::Z => [0, 1],
        }
    }
}

/// Layers of crystals and amorphous matter, with defects that extend through them. Layers count from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackTable {
    /// Direction in which layers follow each other.
    #[serde(default)]
    pub along: StackDirection,
    /// Largest strain, in the plane of the interfaces, of a layer that is made to fit the first crystal: 0.02 is two per cent.
    #[serde(default = "default_max_strain")]
    pub max_strain: f64,
    /// Height at which the first layer of a stack along z begins, in nm from the entrance face: vacuum in which particles have room.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub begin_nm: f64,
    /// The layers, in the order of their positions.
    pub layers: Vec<StackLayer>,
    /// Twin boundaries, stacking faults and antiphase boundaries.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<StackFault>,
    /// Edge dislocations along the beam.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dislocations: Vec<StackDislocation>,
    /// Crystals inside the layers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub precipitates: Vec<Precipitate>,
    /// Particles on the layers of a stack along z.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub particles: Vec<StackParticles>,
    /// Straight edges at which a layer ends.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edges: Vec<StackEdge>,
    /// Rows of vacancies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vacancy_lines: Vec<VacancyLines>,
    /// Pairs of vacancies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub double_vacancies: Vec<DoubleVacancies>,
}

fn default_max_strain() -> f64 {
    0.02
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// How a layer fits the first crystal of the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LayerFit {
    /// One cell on one cell, or on up to four; strained within `max_strain`.
    #[default]
    Coherent,
    /// Some cells on some others, the fewest whose strain is within `max_strain`.
    Coincident,
    /// The layer keeps its own lattice.
    Misfit,
}

/// A layer: a crystal, or amorphous matter.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackLayer {
    /// Name of its phase; by default the name of the crystal or of the amorphous matter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The crystal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crystal: Option<CrystalSource>,
    /// Direction of the crystal along the beam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zone_axis: Option<String>,
    /// Direction of the crystal along +y; the shortest one perpendicular to the beam when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Formula of amorphous matter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amorphous: Option<String>,
    /// Density of amorphous matter in g/cm3.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density_g_per_cm3: Option<f64>,
    /// Thickness along the direction of the stack in nm, moved to whole atomic planes; the last layer ends with the field when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness_nm: Option<f64>,
    /// How the layer fits the first crystal.
    #[serde(default)]
    pub fit: LayerFit,
    /// Poisson's ratio of a strained layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<f64>,
    /// Shift along the two axes of the interface (in the order x, y, z), in cells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shift_cells: Option<[f64; 2]>,
    /// Angle in degrees, from +x to +y, by which a layer of a stack along z is turned about the beam, at the middle of the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
    /// Formula of the atomic plane that begins the layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_plane: Option<String>,
    /// Formula of the atomic plane that ends the layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_plane: Option<String>,
    /// Standard deviation of the interface at which the layer begins about its mean plane, in nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roughness_nm: Option<f64>,
    /// Correlation length of this roughness in nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roughness_correlation_nm: Option<f64>,
    /// Width of the profile with which elements are exchanged over the interface at which the layer begins: the standard deviation of the
    /// Gaussian whose integral it is, in nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interdiffusion_nm: Option<f64>,
    /// The elements that are exchanged: element of the layer before, and the element of this layer that takes its sites.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub exchange: BTreeMap<String, String>,
    /// Least distances of pairs of elements (`"Si-O"`) in amorphous matter, in Angstrom.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub least_distance_angstrom: BTreeMap<String, f64>,
}

/// Kinds of planar faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The crystal beyond the plane is the mirror image of the crystal before it.
    Twin,
    /// The crystal beyond the plane is shifted by a vector in the plane.
    StackingFault,
    /// The crystal beyond the plane is shifted by a vector that puts other atoms in the places of atoms.
    Antiphase,
}

impl FaultKind {
    /// Returns the name that recipes use.
    pub fn name(self) -> &'static str {
        match self {
            FaultKind::Twin => "twin",
            FaultKind::StackingFault => "stacking_fault",
            FaultKind::Antiphase => "antiphase",
        }
    }
}

/// A planar fault of one layer, seen edge on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackFault {
    /// Kind.
    pub kind: FaultKind,
    /// Number of the layer.
    #[serde(default = "first")]
    pub layer: usize,
    /// Miller indices of the plane, which holds the beam direction. The side to which its normal points changes.
    pub plane: String,
    /// A point (x, y) of the plane in nm. The plane moves by at most 0.65 nm to its place between the atoms.
    pub position_nm: [f64; 2],
    /// The shift of a stacking fault or antiphase boundary, `1/6[11-2]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shift: Option<String>,
}

fn first() -> usize {
    1
}

/// A straight edge dislocation along the beam.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackDislocation {
    /// Number of the layer in whose indices the Burgers vector is given.
    #[serde(default = "first")]
    pub layer: usize,
    /// Place (x, y) of the line in nm; it moves along the normal of the slip plane to the nearest place between two atomic planes.
    pub position_nm: [f64; 2],
    /// Burgers vector, a lattice vector perpendicular to the beam: `[100]`, `1/2[110]`.
    pub burgers: String,
    /// Poisson's ratio.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<f64>,
}

/// Shapes of precipitates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PrecipitateShape {
    /// An ellipsoid.
    #[default]
    Ellipsoid,
    /// A cylinder whose axis is the beam.
    Cylinder,
    /// A box.
    Box,
}

/// A crystal inside the layers, with its own lattice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Precipitate {
    /// Name of its phase; by default the name of the crystal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The crystal.
    pub crystal: CrystalSource,
    /// Direction of the crystal along the beam.
    pub zone_axis: String,
    /// Direction of the crystal along +y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Shape.
    #[serde(default)]
    pub shape: PrecipitateShape,
    /// Centre (x, y, z) in nm; z from the entrance face.
    pub centre_nm: [f64; 3],
    /// Extent along x, y and z in nm, before the shape is turned.
    pub size_nm: [f64; 3],
    /// Angle by which the shape, not the crystal, is turned about the beam, from x to y in degrees.
    #[serde(default)]
    pub turn_deg: f64,
}

/// Shapes of particles on layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ParticleShape {
    /// The polyhedron of least surface energy of its volume.
    #[default]
    Wulff,
    /// A sphere.
    Sphere,
    /// An icosahedron of a face-centred cubic metal.
    Icosahedral,
    /// A decahedron of a face-centred cubic metal.
    Decahedral,
}

impl ParticleShape {
    /// Returns the shape of a cluster that consists of several crystals; `None` for shapes that are cut from one.
    pub fn cluster(self) -> Option<Morphology> {
        match self {
            ParticleShape::Icosahedral => Some(Morphology::Icosahedral),
            ParticleShape::Decahedral => Some(Morphology::Decahedral),
            ParticleShape::Wulff | ParticleShape::Sphere => None,
        }
    }

    /// Returns the name that recipes and files use.
    pub fn name(self) -> &'static str {
        match self {
            ParticleShape::Wulff => "wulff",
            ParticleShape::Sphere => "sphere",
            ParticleShape::Icosahedral => "icosahedral",
            ParticleShape::Decahedral => "decahedral",
        }
    }
}

/// The face of the layers on which particles lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ParticleSide {
    /// Where the beam enters.
    #[default]
    Entrance,
    /// Where the beam leaves.
    Exit,
}

impl ParticleSide {
    /// Returns the sign of the direction along z from a particle to its layers.
    pub fn inward(self) -> f64 {
        match self {
            ParticleSide::Entrance => 1.0,
            ParticleSide::Exit => -1.0,
        }
    }
}

/// Particles of one crystal on the layers of a stack along z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackParticles {
    /// Name of their phase; by default the name of the crystal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The crystal.
    pub crystal: CrystalSource,
    /// Shape.
    #[serde(default)]
    pub shape: ParticleShape,
    /// Surface energies of families of planes, `{ "(111)" = 1.28, "(100)" = 1.63 }`, in J/m2; only their ratios count.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub surface_energies: BTreeMap<String, f64>,
    /// Least and greatest diameter in nm, of a sphere that as many atoms fill; diameters between them are equally frequent.
    pub diameter_nm: [f64; 2],
    /// Number of particles at random places; 1 by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<usize>,
    /// Places (x, y) in nm of the particles, instead of random ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub positions_nm: Vec<[f64; 2]>,
    /// Least distance in nm between the circles around two particles.
    #[serde(default = "default_gap_nm")]
    pub gap_nm: f64,
    /// The face of the layers on which they lie.
    #[serde(default)]
    pub side: ParticleSide,
    /// Direction of the crystal along the beam; any orientation without it and `contact_plane`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zone_axis: Option<String>,
    /// Plane of the crystal that lies on the layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_plane: Option<String>,
    /// Direction of the crystal along +y; any rotation about the beam when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_axis: Option<String>,
    /// Largest angle in degrees between the beam and the zone axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_tilt_deg: Option<f64>,
    /// Energy of the interface less the surface energy of the layer, in the unit of `surface_energies`: the particle is cut at the contact
    /// plane as if this were the energy of a facet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_energy: Option<f64>,
    /// Distance in Angstrom from each particle to the nearest atom of the layer; by default the mean of the shortest distances of both
    /// elements in their own crystals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub contact_angstrom: Option<f64>,
}

fn default_gap_nm() -> f64 {
    0.5
}

impl StackTable {
    /// Returns all crystals that the table names.
    pub fn crystals(&self) -> impl Iterator<Item = &CrystalSource> {
        let layers = self.layers.iter().filter_map(|layer| layer.crystal.as_ref());
        let precipitates = self.precipitates.iter().map(|p| &p.crystal);
        layers.chain(precipitates).chain(self.particles.iter().map(|p| &p.crystal))
    }

    /// Returns all crystals that the table names, to read their files.
    pub(super) fn crystals_mut(&mut self) -> impl Iterator<Item = &mut CrystalSource> {
        let layers = self.layers.iter_mut().filter_map(|layer| layer.crystal.as_mut());
        let precipitates = self.precipitates.iter_mut().map(|p| &mut p.crystal);
        layers.chain(precipitates).chain(self.particles.iter_mut().map(|p| &mut p.crystal))
    }

    /// Returns the names of the phases: of the layers in their order, then of precipitates and particles, each name once.
    pub fn phases(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let all = self.layers.iter().map(StackLayer::phase);
        let all = all.chain(self.precipitates.iter().map(Precipitate::phase));
        for name in all.chain(self.particles.iter().map(StackParticles::phase)) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }
}

/// Returns the name of a crystal without folder and ending.
fn crystal_name(crystal: &CrystalSource) -> String {
    let path = std::path::Path::new(&crystal.name);
    path.file_stem().map_or(crystal.name.clone(), |stem| stem.to_string_lossy().into_owned())
}

impl StackLayer {
    /// Returns the name of the phase of the layer.
    pub fn phase(&self) -> String {
        let of_crystal = || self.crystal.as_ref().map(crystal_name);
        let of_glass = || self.amorphous.as_ref().map(|formula| format!("amorphous_{formula}"));
        self.name.clone().or_else(of_crystal).or_else(of_glass).unwrap_or_default()
    }
}

impl Precipitate {
    /// Returns the name of the phase of the precipitate.
    pub fn phase(&self) -> String {
        self.name.clone().unwrap_or_else(|| crystal_name(&self.crystal))
    }
}

impl StackParticles {
    /// Returns the name of the phase of the particles.
    pub fn phase(&self) -> String {
        self.name.clone().unwrap_or_else(|| crystal_name(&self.crystal))
    }

    /// Returns the number of particles.
    pub fn number(&self) -> usize {
        if self.positions_nm.is_empty() { self.count.unwrap_or(1) } else { self.positions_nm.len() }
    }
}
