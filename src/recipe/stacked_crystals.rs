//! The layers of a stack in their places: what the check of a recipe makes of its table `[stack]`. Lengths are in Angstrom; x and y count
//! from the centre of the first pixel of the full field, z from the entrance face.

use super::stack_table::FaultKind;
use crate::models::particles::facets::Polyhedron;
use crate::models::particles::rotation::Rotation;
use crate::models::particles::{Metal, Morphology};
use crate::models::stack::Isometry;
use crate::models::stack::edge_dislocation::EdgeDislocation;
use crate::models::stack::fault_planes::FaultPlane;
use crate::models::stack::least_distances::LeastDistances;
use crate::models::stack::random_packing::Packing;
use crate::structure::lattice::{Mat3, Vec3, dot, inverse, norm, plane_normal, subtract};
use crate::structure::{OrientedBox, Structure};

/// An oriented crystal, strained and in its place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FittedCrystal {
    /// The crystal in a box along x, y and z, strained.
    pub structure: Structure,
    /// The cell vectors of the crystal's file, in the axes of the field and strained, as rows.
    pub cell: Mat3,
    /// Strain along x, y and z.
    pub strain: [f64; 3],
    /// Place of the corner of a box.
    pub origin: Vec3,
}

impl FittedCrystal {
    /// Takes an oriented crystal, unstrained, with the corner of a box at the origin.
    pub(crate) fn new(oriented: &OrientedBox) -> Self {
        let edges = [0, 1, 2].map(|k| oriented.structure.cell[k][k]);
        // The edges of the box are known combinations of the cell vectors, and each lies along its axis.
        let indices: Mat3 = oriented.axes.map(|axis| axis.map(|i| i as f64));
        let to_edges = inverse(&indices).unwrap_or([[0.0; 3]; 3]);
        FittedCrystal {
            structure: oriented.structure.clone(),
            cell: to_edges.map(|row| std::array::from_fn(|k| row[k] * edges[k])),
            strain: [0.0; 3],
            origin: [0.0; 3],
        }
    }

    /// Returns the crystal strained along x, y and z.
    pub(crate) fn strained(&self, strain: [f64; 3]) -> Self {
        let stretched = |row: Vec3| std::array::from_fn(|k| row[k] * (1.0 + strain[k]));
        let mut structure = self.structure.clone();
        structure.cell = structure.cell.map(stretched);
        structure.atoms.iter_mut().for_each(|atom| atom.position = stretched(atom.position));
        FittedCrystal { structure, cell: self.cell.map(stretched), strain, origin: self.origin }
    }

    /// Returns the edges of the box in Angstrom.
    pub(crate) fn edges(&self) -> Vec3 {
        [0, 1, 2].map(|k| self.structure.cell[k][k])
    }

    /// Returns the unit normal of the plane with Miller indices.
    pub(crate) fn normal(&self, miller: [i32; 3]) -> Vec3 {
        plane_normal(&self.cell, miller)
    }

    /// Whether a shift by a vector puts every atom within `tolerance` Angstrom of an atom of its element.
    pub(crate) fn repeats(&self, by: Vec3, tolerance: f64) -> bool {
        let edges = self.edges();
        let atoms = &self.structure.atoms;
        atoms.iter().all(|atom| {
            let moved: Vec3 = std::array::from_fn(|k| atom.position[k] + by[k]);
            atoms.iter().filter(|other| other.number == atom.number).any(|other| {
                let apart = subtract(moved, other.position);
                let nearest: Vec3 =
                    std::array::from_fn(|k| apart[k] - edges[k] * (apart[k] / edges[k]).round());
                norm(nearest) <= tolerance
            })
        })
    }

    /// Returns the number of atoms per cubic Angstrom.
    pub(crate) fn density(&self) -> f64 {
        self.structure.atoms.len() as f64 / self.edges().iter().product::<f64>()
    }
}

/// What a layer is made of.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum StackedMatter {
    /// A crystal.
    Crystal(FittedCrystal),
    /// An amorphous layer.
    Amorphous(Packing),
}

/// A layer in its place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StackedLayer {
    /// Index of its phase in [`StackedCrystals::phases`].
    pub phase: usize,
    /// What it is made of.
    pub matter: StackedMatter,
    /// Height at which it begins, without roughness.
    pub begin: f64,
    /// Turns it about the beam.
    pub turn: Isometry,
    /// Its planar faults, parallel to each other, by their distance.
    pub faults: Vec<FaultPlane>,
    /// The kinds of these faults.
    pub fault_kinds: Vec<FaultKind>,
    /// Its edges.
    pub edges: Vec<LayerEdge>,
}

/// The edge of a layer: atoms at r with r . `normal` > `distance` are absent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LayerEdge {
    /// Unit vector (x, y, 0) into the vacuum.
    pub normal: Vec3,
    /// Distance from the origin.
    pub distance: f64,
}

impl LayerEdge {
    /// Whether a point lies beyond the edge.
    pub(crate) fn cuts(&self, at: Vec3) -> bool {
        dot(at, self.normal) > self.distance
    }
}

/// Rows of vacancies of a layer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CheckedLines {
    /// Index of the layer.
    pub layer: usize,
    /// Atomic number of the missing element.
    pub element: u8,
    /// From one column of a row to the next.
    pub step: [f64; 2],
    /// Number of columns of each row.
    pub columns: usize,
    /// Number of rows in the field, if their places are random.
    pub count: usize,
}

/// A precipitate in its place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PlacedPrecipitate {
    /// Index of its phase in [`StackedCrystals::phases`].
    pub phase: usize,
    /// Its crystal.
    pub crystal: FittedCrystal,
}

/// The outline of particles before they have a size.
#[derive(Debug, Clone, PartialEq)]
pub enum ParticleForm {
    /// A polyhedron whose size is to be chosen, in the axes of the crystal; of unit volume.
    Wulff(Polyhedron),
    /// A sphere.
    Sphere,
    /// A cluster of a face-centred cubic metal.
    Cluster(Morphology, Metal),
}

/// How particles are turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParticleOrientation {
    /// Any orientation.
    Any,
    /// One of the zone axes of a cluster along the beam, to within an angle in degrees.
    ZoneAxes(f64),
    /// A rotation from the axes of the crystal to the axes of the field.
    Axis {
        /// The rotation.
        rotation: Rotation,
        /// Whether any rotation about the beam follows it.
        turned: bool,
        /// Largest angle in degrees by which the particles are tilted.
        max_tilt_deg: f64,
    },
}

/// Particles on layers, before they are made.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedParticles {
    /// Index of their phase in [`StackedCrystals::phases`].
    pub phase: usize,
    /// Their crystal.
    pub structure: Structure,
    /// Their outline.
    pub form: ParticleForm,
    /// How they are turned.
    pub orientation: ParticleOrientation,
}

/// The layers of a stack and their defects, in their places.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StackedCrystals {
    /// Names of the phases.
    pub phases: Vec<String>,
    /// The layers, by their heights.
    pub layers: Vec<StackedLayer>,
    /// Height at which the last layer ends.
    pub end: f64,
    /// The dislocations.
    pub dislocations: Vec<EdgeDislocation>,
    /// The precipitates, as the recipe lists them.
    pub precipitates: Vec<PlacedPrecipitate>,
    /// The particles, as the recipe lists them.
    pub particles: Vec<CheckedParticles>,
    /// The rows of vacancies, as the recipe lists them.
    pub lines: Vec<CheckedLines>,
    /// Least distances of atoms.
    pub least: LeastDistances,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals;
    use crate::structure::lattice::row_times;

    #[test]
    fn directions_and_planes_keep_their_places_in_the_box() {
        let silicon = crystals::crystal("si").unwrap();
        let oriented = silicon.oriented_within([1, 1, 0], Some([1, -1, 1]), None).unwrap();
        let fitted = FittedCrystal::new(&oriented);
        let lab = |v: [f64; 3]| row_times(v, &fitted.cell);
        let near = |a: Vec3, b: Vec3| norm(subtract(a, b)) < 1e-9;
        let a = 5.431;
        assert!(near(lab([1.0, 1.0, 0.0]), [0.0, 0.0, a * 2f64.sqrt()]));
        assert!(near(lab([1.0, -1.0, 1.0]), [0.0, a * 3f64.sqrt(), 0.0]));
        assert!(near(fitted.normal([1, -1, 1]), [0.0, 1.0, 0.0]));
        assert!(fitted.normal([1, -1, -1])[2].abs() < 1e-12);
        let angle = dot(fitted.normal([1, -1, 1]), fitted.normal([1, -1, -1]));
        assert!((angle - 1.0 / 3.0).abs() < 1e-12);
        assert!(fitted.repeats(lab([0.5, 0.5, 0.0]), 1e-6));
        assert!(!fitted.repeats(lab([0.25, 0.25, 0.25]), 0.1));
        let strained = fitted.strained([0.01, 0.0, 0.0]);
        assert!((strained.edges()[0] / fitted.edges()[0] - 1.01).abs() < 1e-12);
        assert!((fitted.density() / strained.density() - 1.01).abs() < 1e-12);
        assert!(near(row_times([1.0, -1.0, 1.0], &strained.cell), [0.0, a * 3f64.sqrt(), 0.0]));
    }
}
