//! The interface of every specimen: its sites region by region, boundaries, phases and particles.

use super::atom_columns::{AtomColumn, Sites};
use super::sites::SpecimenSite;
use super::units::library_cell::LibraryCell;
use super::units::unit_tag::UnitFamily;
use crate::lengths;
use crate::recipe::region::Region;

/// A line between grains or phases.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    /// Corners (x, y) in nm of the full field.
    pub line_nm: Vec<[f64; 2]>,
    /// The parts that the boundary separates.
    pub kind: BoundaryKind,
}

/// The parts that a boundary separates.
#[derive(Debug, Clone, PartialEq)]
pub enum BoundaryKind {
    /// Two grains.
    Grain {
        /// Rotation between the grains in degrees.
        misorientation_deg: f64,
        /// Coincidence index, where there is one.
        sigma: Option<u32>,
    },
    /// Two phases.
    Phase {
        /// The phases left and right of the line, as in [`SpecimenFacts::phases`].
        sides: [usize; 2],
        /// Standard deviation of the transition in nm (see [`crate::recipe::DomainTable`]): 0 if abrupt.
        sharpness_sigma_nm: f64,
    },
    /// A planar fault of a crystal, seen edge on.
    Fault {
        /// `twin`, `stacking_fault` or `antiphase`.
        kind: &'static str,
        /// Unit normal (x, y) of the plane; the crystal on this side is mirrored or shifted.
        normal: [f64; 2],
        /// Shift (x, y, z) of the crystal on that side in nm; 0 for a twin.
        shift_nm: [f64; 3],
    },
}

/// A layer of a stack.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerTruth {
    /// Angle in degrees by which the layer is turned about the beam.
    pub turn_deg: f64,
    /// Phase, as an index into [`StackTruth::phases`].
    pub phase: usize,
    /// Height at which it begins in nm, without roughness.
    pub begin_nm: f64,
    /// Height at which it ends in nm; infinite for a layer that continues beyond the field.
    pub end_nm: f64,
    /// Strain along x, y and z.
    pub strain: [f64; 3],
}

/// An edge dislocation along the beam.
#[derive(Debug, Clone, PartialEq)]
pub struct DislocationTruth {
    /// Place (x, y) of the line in nm of the full field.
    pub position_nm: [f64; 2],
    /// Burgers vector (x, y, z) in nm: the displacement gained on a circuit from x to y about the line.
    pub burgers_nm: [f64; 3],
}

/// The layers and dislocations of a stack.
#[derive(Debug, Clone, PartialEq)]
pub struct StackTruth {
    /// Axis along which layers follow each other: 0 is x.
    pub axis: usize,
    /// Names of the phases.
    pub phases: Vec<String>,
    /// The layers, by their heights.
    pub layers: Vec<LayerTruth>,
    /// The dislocations.
    pub dislocations: Vec<DislocationTruth>,
}

/// A particle, as the ground truth lists it.
#[derive(Debug, Clone, PartialEq)]
pub struct ParticleTruth {
    /// Centre (x, y, z) in nm of the full field.
    pub centre_nm: [f64; 3],
    /// Diameter in nm.
    pub diameter_nm: f64,
    /// Shape: `wulff`, `icosahedral`, `decahedral` ... (at most 16 ASCII characters).
    pub morphology: String,
    /// Rotation from the axes of the particle to the axes of the field as a unit quaternion (w, x, y, z).
    pub orientation: [f64; 4],
}

impl ParticleTruth {
    /// Returns the projection of the particle along the beam.
    pub fn outline(&self) -> ParticleOutline {
        let [x, y, _] = self.centre_nm;
        let morphology = self.morphology.clone();
        ParticleOutline { centre_nm: [x, y], diameter_nm: self.diameter_nm, morphology }
    }
}

/// The projection of a particle along the beam.
#[derive(Debug, Clone, PartialEq)]
pub struct ParticleOutline {
    /// Centre (x, y) in nm of the full field.
    pub centre_nm: [f64; 2],
    /// Diameter in nm.
    pub diameter_nm: f64,
    /// Shape, as in [`ParticleTruth`].
    pub morphology: String,
}

impl ParticleOutline {
    /// Whether a sphere of its diameter reaches into a region.
    pub fn reaches(&self, region: &Region) -> bool {
        region.grown(0.5 * self.diameter_nm).contains(self.centre_nm)
    }
}

/// Returns the particles of a specimen whose centre lies in a region.
pub(crate) fn outlines_in(specimen: &dyn Specimen, region: &Region) -> Vec<ParticleOutline> {
    let all = specimen.facts().particle_outlines.iter();
    all.filter(|p| region.contains(p.centre_nm)).cloned().collect()
}

/// A thin film of weakly scattering atoms behind everything else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinFilm {
    /// Atomic number of its atoms. Other atoms of the specimen may be of the same element.
    pub number: u8,
    /// First and last depth along the beam, in nm.
    pub depth_nm: [f64; 2],
    /// Mean number of atoms per square nm.
    pub atoms_per_nm2: f64,
    /// Bits of keys that are set in all atoms except the atoms of the film.
    pub other_keys: u64,
}

impl ThinFilm {
    /// Whether the atom with this key is part of the film.
    pub fn holds(&self, key: u64) -> bool {
        key & self.other_keys == 0
    }

    /// Returns the height in Angstrom of the slice that an atom of the film at `z_angstrom` belongs to: the middle of the slice. The film
    /// is divided into equal slices of at most `thickness_angstrom`.
    pub(crate) fn slice_height_angstrom(&self, z_angstrom: f64, thickness_angstrom: f64) -> f64 {
        let [start, end] = lengths::angstrom(self.depth_nm);
        let slices = ((end - start) / thickness_angstrom).ceil().max(1.0);
        let each = (end - start) / slices;
        start + (((z_angstrom - start) / each).floor().clamp(0.0, slices - 1.0) + 0.5) * each
    }
}

/// The expected number of sites, to within a few percent, of a specimen that takes long to make them.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedSites {
    /// Mean number of sites per square nm without particles.
    pub per_nm2: f64,
    /// Centre (x, y) in nm and number of sites of each particle.
    pub particles: Vec<([f64; 2], u64)>,
}

impl ExpectedSites {
    /// Returns the number of sites in a region; particles count where their centre lies.
    pub(crate) fn within(&self, region: &Region) -> u64 {
        let area = (region.x[1] - region.x[0]) * (region.y[1] - region.y[0]);
        let inside = self.particles.iter().filter(|(centre, _)| region.contains(*centre));
        (self.per_nm2 * area).round() as u64 + inside.map(|(_, sites)| sites).sum::<u64>()
    }
}

/// Facts about a whole specimen that do not change while it relaxes or loses atoms.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SpecimenFacts {
    /// Thickness in nm.
    pub thickness_nm: f64,
    /// Names of the phases; empty when there is only one. Their indices are the codes of the phase map.
    pub phases: Vec<String>,
    /// Centres (x, y) of clusters of vacancies in nm.
    pub clusters_nm: Vec<[f64; 2]>,
    /// The film behind everything else, if the specimen has one.
    pub film: Option<ThinFilm>,
    /// Projections of all particles along the beam; the depth of particles is not computed for them.
    pub particle_outlines: Vec<ParticleOutline>,
    /// Expected number of sites, for specimens that take long to make them.
    pub expected_sites: Option<ExpectedSites>,
    /// The layers of a stack.
    pub stack: Option<StackTruth>,
    /// The largest distance in Angstrom from a column at which the library shows the image, where it is limited.
    pub(crate) shown_within_angstrom: Option<f64>,
}

impl SpecimenFacts {
    /// Thickness in Angstrom.
    pub(crate) fn thickness_angstrom(&self) -> f64 {
        lengths::angstrom(self.thickness_nm)
    }
}

/// The layout of a specimen, which does not change when single atoms do.
pub trait SpecimenLayout: Send + Sync {
    /// Returns the facts about the whole specimen.
    fn facts(&self) -> &SpecimenFacts;
    /// Returns the boundaries between grains and phases.
    fn boundaries(&self) -> Vec<Boundary>;
    /// Returns the phase at a point (x, y) in nm, as an index into [`SpecimenFacts::phases`].
    fn phase_at(&self, position_nm: [f64; 2]) -> usize;
    /// Returns the cell in which units of a family are simulated, for specimens that tag columns with units.
    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell>;
    /// Returns the particles that reach into a region. The depth of other particles, which may take long, is not computed.
    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth>;
}

/// A specimen of the full field. No method has a default: a specimen that changes another specimen passes on its layout, and must implement
/// all other methods.
pub trait Specimen: Send + Sync {
    /// Returns the layout; a specimen that changes another specimen returns the layout of that one.
    fn layout(&self) -> &dyn SpecimenLayout;
    /// Returns the columns whose position lies in a region. The specimen ends 12 nm (`BEYOND_FIELD_NM`) outside the
    /// field. A region has the same sites in every query.
    fn query(&self, region: &Region) -> Sites;
    /// Returns the columns of [`Specimen::query`] in the same order, without their sites. Faster where units describe the columns.
    fn columns(&self, region: &Region) -> Vec<AtomColumn>;
    /// Returns the columns of particles in a region on a plane film, for overviews: no atom of the film has to be made. Empty for specimens
    /// without a film.
    fn particles_on_a_plane(&self, region: &Region) -> Sites;
    /// Returns the families that units of a family may belong to while the specimen changes, the family itself included.
    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily>;
}

/// Methods of the layout, for convenience.
impl dyn Specimen + '_ {
    /// Returns [`SpecimenLayout::facts`].
    pub fn facts(&self) -> &SpecimenFacts {
        self.layout().facts()
    }
    /// Returns [`SpecimenLayout::boundaries`].
    pub fn boundaries(&self) -> Vec<Boundary> {
        self.layout().boundaries()
    }
    /// Returns [`SpecimenLayout::phase_at`].
    pub fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        self.layout().phase_at(position_nm)
    }
    /// Returns [`SpecimenLayout::library_cell`].
    pub fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        self.layout().library_cell(family)
    }
    /// Returns [`SpecimenLayout::particles_reaching`].
    pub fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        self.layout().particles_reaching(region)
    }
    /// Returns all particles. Computing the depth of each may take long.
    pub fn particles(&self) -> Vec<ParticleTruth> {
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        self.particles_reaching(&Region { x: all, y: all })
    }
    /// Returns the sites of the columns whose position lies in a region.
    pub fn sites(&self, region: &Region) -> Vec<SpecimenSite> {
        self.query(region).sites
    }
}

#[cfg(test)]
mod tests {
    use crate::recipe::region::Region;
    use crate::recipe::{CheckedRecipe, Difficulty};
    use crate::specimen::specimen;

    #[test]
    fn columns_are_those_of_the_query_without_their_sites() {
        for id in ["srtio3", "batio3", "gan", "sige", "pt"] {
            let recipe = CheckedRecipe::load(id, Difficulty::Hard).unwrap();
            let specimen = specimen(&recipe).unwrap();
            let region = Region { x: [20.0, 35.0], y: [4.0, 6.0] };
            let mut expected = specimen.query(&region).columns;
            assert!(expected.len() > 10, "{id}");
            expected.iter_mut().for_each(|column| column.sites = 0..0);
            assert_eq!(specimen.columns(&region), expected, "{id}");
        }
    }
}
