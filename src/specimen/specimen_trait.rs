//! What every specimen can tell: its sites region by region, boundaries, phases and particles.

use super::atom_columns::{AtomColumn, Sites};
use super::sites::SpecimenSite;
use super::units::library_cell::LibraryCell;
use super::units::unit_tag::UnitFamily;
use crate::recipe::region::Region;

/// A line between grains or phases.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    /// Corners (x, y) in nm of the full field.
    pub line_nm: Vec<[f64; 2]>,
    /// What it separates.
    pub kind: BoundaryKind,
}

/// What a boundary separates.
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
        /// The phases left and right of the line, as in [`Specimen::phases`].
        sides: [usize; 2],
        /// Standard deviation of the transition in nm (see [`crate::recipe::DomainTable`]): 0 if abrupt.
        sharpness_sigma_nm: f64,
    },
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
    /// Rotation from the particle's own axes to those of the field as a unit quaternion (w, x, y, z).
    pub orientation: [f64; 4],
}

impl ParticleTruth {
    /// The particle as it is seen along the beam.
    pub fn outline(&self) -> ParticleOutline {
        let [x, y, _] = self.centre_nm;
        let morphology = self.morphology.clone();
        ParticleOutline { centre_nm: [x, y], diameter_nm: self.diameter_nm, morphology }
    }
}

/// A particle as it is seen along the beam.
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

/// The particles of a specimen with their centre in a region.
pub fn outlines_in(specimen: &dyn Specimen, region: &Region) -> Vec<ParticleOutline> {
    let mut outlines = specimen.particle_outlines();
    outlines.retain(|p| region.contains(p.centre_nm));
    outlines
}

/// A thin film of weakly scattering atoms behind everything else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinFilm {
    /// Atomic number of its atoms. Other atoms of the specimen may be of the same element.
    pub number: u8,
    /// Where it begins and ends along the beam, in nm.
    pub depth_nm: [f64; 2],
    /// Its atoms in the mean.
    pub atoms_per_nm2: f64,
    /// Bits of keys that all atoms but those of the film have.
    pub other_keys: u64,
}

impl ThinFilm {
    /// Whether the atom of this key is part of the film.
    pub fn holds(&self, key: u64) -> bool {
        key & self.other_keys == 0
    }

    /// The height in Angstrom of an atom of the film at `z_angstrom`, with the film in equal slices of at most this
    /// thickness: the middle of its slice.
    pub fn slice_height_angstrom(&self, z_angstrom: f64, thickness_angstrom: f64) -> f64 {
        let [start, end] = self.depth_nm.map(|z| 10.0 * z);
        let slices = ((end - start) / thickness_angstrom).ceil().max(1.0);
        let each = (end - start) / slices;
        start + (((z_angstrom - start) / each).floor().clamp(0.0, slices - 1.0) + 0.5) * each
    }
}

/// A specimen of the full field.
pub trait Specimen: Send + Sync {
    /// The columns whose position lies in a region. The specimen ends [`BEYOND_FIELD_NM`](crate::recipe::BEYOND_FIELD_NM) outside
    /// the field; a region has the same sites whichever way it is asked for.
    fn query(&self, region: &Region) -> Sites;
    /// The same columns in the same order, none with its sites. Takes less time where units say what columns are.
    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        let mut columns = self.query(region).columns;
        columns.iter_mut().for_each(|column| column.sites = 0..0);
        columns
    }
    /// The sites of those columns.
    fn sites(&self, region: &Region) -> Vec<SpecimenSite> {
        self.query(region).sites
    }
    /// Number of sites in a region, of a specimen that knows it to within a few percent without making
    /// them, and takes long to make them.
    fn expected_sites(&self, _region: &Region) -> Option<u64> {
        None
    }
    /// Thickness in nm.
    fn thickness_nm(&self) -> f64;
    /// Boundaries between grains and phases.
    fn boundaries(&self) -> Vec<Boundary> {
        Vec::new()
    }
    /// Names of the phases; empty when there is only one. Their indices are the codes of the
    /// phase map.
    fn phases(&self) -> Vec<String> {
        Vec::new()
    }
    /// The phase at a point (x, y) in nm, as an index into [`Specimen::phases`].
    fn phase_at(&self, _position_nm: [f64; 2]) -> usize {
        0
    }
    /// The sheet in which units of a family are simulated, for specimens that tag columns with units.
    fn library_cell(&self, _family: UnitFamily) -> Option<LibraryCell> {
        None
    }
    /// The families that units of a family may come to belong to while the specimen changes; itself among them.
    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        vec![family]
    }
    /// The film behind everything else, for specimens that have one.
    fn film(&self) -> Option<ThinFilm> {
        None
    }
    /// Particles whose centre lies in the specimen.
    fn particles(&self) -> Vec<ParticleTruth> {
        Vec::new()
    }
    /// Those of them that reach into a region. How deep the others lie is not found out, which may take long.
    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        let mut particles = self.particles();
        particles.retain(|p| p.outline().reaches(region));
        particles
    }
    /// All particles as they are seen along the beam: how deep they lie is not found out.
    fn particle_outlines(&self) -> Vec<ParticleOutline> {
        self.particles().iter().map(ParticleTruth::outline).collect()
    }
    /// The columns of particles in a region, on a film that is as flat as a plane: for overviews, since no atom of the film has to be
    /// made. Nothing of specimens without a film.
    fn particles_on_a_plane(&self, _region: &Region) -> Sites {
        Sites::default()
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
