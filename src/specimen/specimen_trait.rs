//! What every specimen is asked for: its sites region by region, boundaries, phases and particles.

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
        /// The phases left and right of the line, as in [`SpecimenFacts::phases`].
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
    let all = specimen.facts().particle_outlines.iter();
    all.filter(|p| region.contains(p.centre_nm)).cloned().collect()
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

/// How many sites a specimen has that takes long to make them, to within a few percent.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedSites {
    /// Sites of what is the same everywhere.
    pub per_nm2: f64,
    /// Centre (x, y) in nm and number of sites of each particle.
    pub particles: Vec<([f64; 2], u64)>,
}

impl ExpectedSites {
    /// Those in a region; particles count where their centre lies.
    pub fn within(&self, region: &Region) -> u64 {
        let area = (region.x[1] - region.x[0]) * (region.y[1] - region.y[0]);
        let inside = self.particles.iter().filter(|(centre, _)| region.contains(*centre));
        (self.per_nm2 * area).round() as u64 + inside.map(|(_, sites)| sites).sum::<u64>()
    }
}

/// What is the same for all of a specimen, and stays so while it relaxes or loses atoms.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SpecimenFacts {
    /// Thickness in nm.
    pub thickness_nm: f64,
    /// Names of the phases; empty when there is only one. Their indices are the codes of the phase map.
    pub phases: Vec<String>,
    /// The film behind everything else, for specimens that have one.
    pub film: Option<ThinFilm>,
    /// All particles as they are seen along the beam: how deep they lie is not found out.
    pub particle_outlines: Vec<ParticleOutline>,
    /// How many sites there are, where making them takes long.
    pub expected_sites: Option<ExpectedSites>,
}

/// How a specimen is laid out, whatever becomes of single atoms.
pub trait SpecimenLayout: Send + Sync {
    /// What is the same for all of it.
    fn facts(&self) -> &SpecimenFacts;
    /// Boundaries between grains and phases.
    fn boundaries(&self) -> Vec<Boundary>;
    /// The phase at a point (x, y) in nm, as an index into [`SpecimenFacts::phases`].
    fn phase_at(&self, position_nm: [f64; 2]) -> usize;
    /// The cell in which units of a family are simulated, for specimens that tag columns with units.
    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell>;
    /// Particles that reach into a region. How deep the others lie is not found out, which may take long.
    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth>;
}

/// A specimen of the full field. No method has a default: one that changes another specimen passes on its layout, and has to say what
/// becomes of everything else.
pub trait Specimen: Send + Sync {
    /// How it is laid out; one that changes another specimen has the layout of that one.
    fn layout(&self) -> &dyn SpecimenLayout;
    /// The columns whose position lies in a region. The specimen ends [`BEYOND_FIELD_NM`](crate::recipe::BEYOND_FIELD_NM) outside
    /// the field; a region has the same sites whichever way it is asked for.
    fn query(&self, region: &Region) -> Sites;
    /// The same columns in the same order, none with its sites. Takes less time where units say what columns are.
    fn columns(&self, region: &Region) -> Vec<AtomColumn>;
    /// The columns of particles in a region, on a film that is as flat as a plane: for overviews, since no atom of the film has to be
    /// made. Nothing of specimens without a film.
    fn particles_on_a_plane(&self, region: &Region) -> Sites;
    /// The families that units of a family may come to belong to while the specimen changes; itself among them.
    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily>;
}

/// Shorthands.
impl dyn Specimen + '_ {
    /// See [`SpecimenLayout::facts`].
    pub fn facts(&self) -> &SpecimenFacts {
        self.layout().facts()
    }
    /// See [`SpecimenLayout::boundaries`].
    pub fn boundaries(&self) -> Vec<Boundary> {
        self.layout().boundaries()
    }
    /// See [`SpecimenLayout::phase_at`].
    pub fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        self.layout().phase_at(position_nm)
    }
    /// See [`SpecimenLayout::library_cell`].
    pub fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        self.layout().library_cell(family)
    }
    /// See [`SpecimenLayout::particles_reaching`].
    pub fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        self.layout().particles_reaching(region)
    }
    /// All particles. How deep each lies is found out, which may take long.
    pub fn particles(&self) -> Vec<ParticleTruth> {
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        self.particles_reaching(&Region { x: all, y: all })
    }
    /// The sites of the columns whose position lies in a region.
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
