//! Nanoparticles: Wulff polyhedra and spheres of any crystal ([`crystal_particle`]), and Wulff polyhedra, icosahedra and decahedra of
//! face-centred cubic metals.
//!
//! Among all clusters of a shape whose diameter is near enough to the requested one, the cluster with the least surface energy is chosen
//! ([`build`]). The diameter of N atoms is the diameter of a sphere of the bulk metal with N atoms.

pub mod crystal_particle;
mod decahedron;
pub mod facets;
mod icosahedron;
mod point_group;
pub mod rotation;
mod wulff;

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex, PoisonError};

use crate::error::{Error, Result};
use crate::lengths;
use crate::setting::Setting;
use crate::structure::for_each_pair;
use crate::structure::lattice::Vec3;
use crate::structure::{Atom, Structure};

pub use decahedron::Decahedron;
pub use icosahedron::Icosahedron;
pub use wulff::Wulff;

/// Shape of a particle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Morphology {
    /// Single crystal bounded by {111} and {100}: the truncated octahedron of Wulff's construction. Its frame is the frame of the cubic
    /// cell.
    Wulff,
    /// Mackay's icosahedron: twenty strained tetrahedra. A five-fold axis lies along z, a vertex of the upper ring towards x.
    Icosahedral,
    /// Marks' decahedron: five strained crystals about a common \[110\] axis, which lies along z; the {100} facet of the first
    /// faces x.
    Decahedral,
}

impl Morphology {
    /// All shapes.
    pub const ALL: [Morphology; 3] =
        [Morphology::Wulff, Morphology::Icosahedral, Morphology::Decahedral];

    /// Returns the name that recipes and files use.
    pub fn name(self) -> &'static str {
        match self {
            Morphology::Wulff => "wulff",
            Morphology::Icosahedral => "icosahedral",
            Morphology::Decahedral => "decahedral",
        }
    }

    /// Returns directions in the frame of the particle along which rows of atoms are seen end on.
    ///
    /// Wulff: \[100\], \[110\], \[111\]. Icosahedron: five-fold, three-fold and two-fold axis. Decahedron: the five-fold axis, and the
    /// \[001\] and \[110\] of the first crystal that are normal to it.
    pub fn zone_axes(self) -> [Vec3; 3] {
        match self {
            Morphology::Wulff => [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]],
            Morphology::Icosahedral => icosahedron::axes(),
            Morphology::Decahedral => [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        }
    }
}

/// The metal of the particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metal {
    /// Edge of the cubic cell in Angstrom.
    pub a: f64,
    /// Surface energy of {100} divided by the surface energy of {111}.
    pub surface_energy_ratio: f64,
}

impl Metal {
    /// Reads the metal from a crystal; also returns its atomic number.
    ///
    /// # Errors
    /// [`Error::Invalid`] unless the cell is cubic with one element at the corner and the centres of its faces.
    pub fn of(structure: &Structure, surface_energy_ratio: f64) -> Result<(u8, Metal)> {
        let Some(first) = structure.atoms.first() else { return not_a_metal("no atoms") };
        let a = structure.cell[0][0];
        let cubic =
            structure.orthogonal_box().is_ok_and(|b| b.iter().all(|e| (e - a).abs() < 1e-4));
        let half = |v: f64| (2.0 * v / a).round();
        let mut corners: Vec<[i64; 3]> = Vec::new();
        for atom in &structure.atoms {
            let d: Vec3 = std::array::from_fn(|k| atom.position[k] - first.position[k]);
            let off = d.iter().any(|v| (2.0 * v / a - half(*v)).abs() > 1e-3);
            if off || atom.number != first.number || atom.occupancy < 1.0 {
                return not_a_metal("other atoms or places");
            }
            corners.push(d.map(|v| half(v) as i64 & 1));
        }
        corners.sort_unstable();
        match cubic && corners == [[0, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]] {
            true => Ok((first.number, Metal { a, surface_energy_ratio })),
            false => not_a_metal("another cell"),
        }
    }

    /// Returns the distance of nearest neighbours in the bulk, in Angstrom.
    pub fn bond(&self) -> f64 {
        self.a * std::f64::consts::FRAC_1_SQRT_2
    }

    /// Returns the diameter in nm of `count` atoms.
    pub fn diameter_nm(&self, count: usize) -> f64 {
        let volume = count as f64 * self.a * self.a * self.a / 4.0;
        lengths::nm(libm::cbrt(6.0 * volume / std::f64::consts::PI))
    }

    /// Returns the number of atoms that fill a sphere of this diameter.
    pub fn count(&self, diameter_nm: f64) -> f64 {
        let d = lengths::angstrom(diameter_nm) / self.a;
        4.0 * std::f64::consts::PI / 6.0 * d * d * d
    }
}

fn not_a_metal<T>(found: &str) -> Result<T> {
    let expected = "particles need a face-centred cubic metal: a cubic cell with one element at the corner and the \
                    centres of the faces, such as \"pt\"";
    Err(Error::invalid(Setting::Crystal, found, expected))
}

/// The atoms of a particle.
#[derive(Debug, Clone, PartialEq)]
pub struct Cluster {
    /// Positions in Angstrom relative to their mean, in the frame of the particle.
    pub positions: Vec<Vec3>,
}

/// Atoms nearer than this are neighbours, in units of the bulk bond: a distance between the longest bond of an icosahedron (1.02) and the
/// second neighbours (1.37 and more).
pub const NEIGHBOUR: f64 = 1.2;

impl Cluster {
    fn centred(mut positions: Vec<Vec3>) -> Self {
        let n = positions.len().max(1) as f64;
        let mean = [0, 1, 2].map(|k| positions.iter().map(|p| p[k]).sum::<f64>() / n);
        positions.iter_mut().for_each(|p| (0..3).for_each(|k| p[k] -= mean[k]));
        Cluster { positions }
    }

    /// Returns the number of nearest neighbours of each atom.
    pub fn coordination(&self, metal: &Metal) -> Vec<usize> {
        let reach = NEIGHBOUR * metal.bond();
        let size = self.radius() * 2.0 + 2.0 * reach;
        let cell = [[size, 0.0, 0.0], [0.0, size, 0.0], [0.0, 0.0, size]];
        let atom = |&position: &Vec3| Atom::new(1, position);
        let structure = Structure { cell, atoms: self.positions.iter().map(atom).collect() };
        let mut counts = vec![0; self.positions.len()];
        for_each_pair(&structure, reach, |i, j, _| {
            counts[i] += 1;
            counts[j] += 1;
        });
        counts
    }

    /// Returns the greatest distance of an atom from the centre, in Angstrom.
    pub fn radius(&self) -> f64 {
        let square = |p: &Vec3| p.iter().map(|v| v * v).sum::<f64>();
        self.positions.iter().map(square).fold(0.0, f64::max).sqrt()
    }

    /// Returns the energy of the broken bonds per area: the sum of `sqrt(12) - sqrt(coordination)` (the energy of a bond falls as the root
    /// of the coordination number in the second-moment approximation of tight binding, F. Ducastelle, J. Phys. (Paris) 31, 1055 (1970))
    /// divided by `N^(2/3)`.
    fn surface_energy(&self, metal: &Metal) -> f64 {
        let counts = self.coordination(metal);
        let missing: f64 = counts.iter().map(|&c| 12f64.sqrt() - (c as f64).sqrt()).sum();
        let edge = libm::cbrt(self.positions.len() as f64);
        missing / (edge * edge)
    }
}

/// Largest difference in nm from the requested diameter within which the surface energy decides.
const TOLERANCE_NM: f64 = 0.04;

/// The parameters of a cluster.
pub trait Candidate {
    /// Shape of the cluster.
    const MORPHOLOGY: Morphology;
    /// Number of atoms.
    fn count(&self) -> usize;
    /// Makes the cluster.
    fn cluster(&self, metal: &Metal) -> Cluster;
    /// Returns numbers that identify the cluster among others of its shape.
    fn key(&self) -> [u64; 4];
}

/// Key of a cluster: the bits of the metal's numbers, the shape, and [`Candidate::key`].
type ClusterKey = ([u64; 2], Morphology, [u64; 4]);

/// Surface energies of clusters that were computed before: particles of other specimens are chosen among the same clusters.
static ENERGIES: LazyLock<Mutex<HashMap<ClusterKey, f64>>> = LazyLock::new(Mutex::default);
/// Number of surface energies that are kept; 64 bytes each.
const KEPT_ENERGIES: usize = 1 << 18;

fn surface_energy<R: Candidate>(candidate: &R, metal: &Metal) -> f64 {
    let of_metal = [metal.a, metal.surface_energy_ratio].map(f64::to_bits);
    let key = (of_metal, R::MORPHOLOGY, candidate.key());
    let energies = || ENERGIES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = energies().get(&key) {
        return *known;
    }
    let energy = candidate.cluster(metal).surface_energy(metal);
    let mut energies = energies();
    if energies.len() >= KEPT_ENERGIES {
        energies.clear();
    }
    energies.insert(key, energy);
    energy
}

/// Builds the particle of a shape whose diameter is nearest to `diameter_nm` and within `limits_nm`, both in nm. Among the clusters within
/// 0.04 nm of it, the one with the least surface energy is built.
///
/// # Errors
/// [`Error::Invalid`] if no cluster has a diameter within the limits.
pub fn build(
    morphology: Morphology,
    metal: &Metal,
    diameter_nm: f64,
    limits_nm: [f64; 2],
) -> Result<Cluster> {
    match morphology {
        Morphology::Wulff => {
            let candidates = wulff::candidates(metal, diameter_nm, limits_nm[1]);
            choose(candidates, metal, diameter_nm, limits_nm)
        }
        Morphology::Icosahedral => {
            choose(icosahedron::candidates(metal, diameter_nm), metal, diameter_nm, limits_nm)
        }
        Morphology::Decahedral => {
            choose(decahedron::candidates(metal, diameter_nm), metal, diameter_nm, limits_nm)
        }
    }
}

fn choose<R: Candidate>(
    candidates: Vec<R>,
    metal: &Metal,
    diameter_nm: f64,
    limits_nm: [f64; 2],
) -> Result<Cluster> {
    let with_diameter = candidates.into_iter().map(|r| (metal.diameter_nm(r.count()), r));
    let inside = |(diameter, _): &(f64, R)| (limits_nm[0]..=limits_nm[1]).contains(diameter);
    let mut candidates: Vec<(f64, R)> = with_diameter.filter(inside).collect();
    let off = |(diameter, _): &(f64, R)| (diameter - diameter_nm).abs();
    let nearest = candidates.iter().map(off).fold(f64::INFINITY, f64::min);
    candidates.retain(|r| off(r) <= nearest.max(TOLERANCE_NM));
    let scored = candidates.into_iter().map(|(_, r)| (surface_energy(&r, metal), r));
    let best = scored.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, candidate)| candidate);
    best.map(|candidate| candidate.cluster(metal)).ok_or_else(|| {
        let [low, high] = limits_nm;
        let expected =
            format!("no particle has a diameter from {low} to {high} nm; widen the range");
        Error::invalid(Setting::ClusterDiameterNm, diameter_nm, expected)
    })
}
