//! Specimens: all lattice sites of a full field, asked for region by region.

use super::contents::Entry;
use super::crystal::ColumnIndex;
use super::domains::Domains;
use super::epitaxy::Epitaxy;
use super::film::ThinFilm;
use super::grains::Grains;
use super::particles::ParticlesOnCarbon;
use super::recipe::{Phonons, Recipe, StructureKind};
use super::relax::Relaxed;
use super::sheet::{Family, Sheet};
use crate::engine::Site;
use crate::error::Result;

/// Sites are never further than this from the position of their column, in nm.
pub const DISPLACED_NM: f64 = 0.1;
/// How far the specimen goes on beyond the field on every side, in nm.
pub const BEYOND_FIELD_NM: f64 = 12.0;

/// A rectangle `x[0] <= x < x[1]`, `y[0] <= y < y[1]` in nm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Horizontal range in nm.
    pub x: [f64; 2],
    /// Vertical range in nm.
    pub y: [f64; 2],
}

impl Region {
    /// Whether a point (x, y) in nm lies inside.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        self.x[0] <= x && x < self.x[1] && self.y[0] <= y && y < self.y[1]
    }
    /// The region with `nm` more on every side.
    pub fn grown(&self, nm: f64) -> Region {
        Region { x: [self.x[0] - nm, self.x[1] + nm], y: [self.y[0] - nm, self.y[1] + nm] }
    }
    /// The part that also lies in `other`; may be empty.
    pub fn intersection(&self, other: &Region) -> Region {
        let cut = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        Region { x: cut(self.x, other.x), y: cut(self.y, other.y) }
    }
    /// The area that the pixels `rows` x `columns` from pixel (row, column) `first` cover.
    pub fn of_pixels(first: [usize; 2], shape: [usize; 2], pixel_nm: f64) -> Region {
        let edge = |p: usize| (p as f64 - 0.5) * pixel_nm;
        let range = |i: usize| [edge(first[i]), edge(first[i] + shape[i])];
        Region { x: range(1), y: range(0) }
    }
}

/// What a lattice site holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SiteKind {
    /// The atom that belongs there.
    Pristine,
    /// Nothing.
    Vacancy,
    /// Another element.
    Substitution,
}

/// A lattice site of the specimen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpecimenSite {
    /// Unique in the specimen, whichever region is asked for.
    pub key: u64,
    /// Mean position in nm: x and y from the centre of pixel (0, 0) of the full field, z from the
    /// entrance surface.
    pub position_nm: [f64; 3],
    /// Atomic number; of a vacancy, that of the missing atom.
    pub number: u8,
    /// What the site holds.
    pub kind: SiteKind,
}

impl SpecimenSite {
    /// The atom here, in Angstrom from `corner_nm` (x, y) of the entrance surface; `None` for a vacancy.
    pub fn atom(&self, corner_nm: [f64; 2], phonons: &Phonons) -> Option<Site> {
        let [x, y, z] = self.position_nm;
        (self.kind != SiteKind::Vacancy).then(|| Site {
            position: [10.0 * (x - corner_nm[0]), 10.0 * (y - corner_nm[1]), 10.0 * z],
            number: self.number,
            sigma_angstrom: phonons.sigma_angstrom(self.number),
            key: self.key,
        })
    }
}

/// A projected atomic column and its sites.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomColumn {
    /// Unique in the specimen.
    pub id: u64,
    /// Position (x, y) in nm: the mean of its sites, before relaxation.
    pub position_nm: [f64; 2],
    /// Its sites in [`Sites::sites`], by ascending z.
    pub sites: std::ops::Range<usize>,
    /// Its place in the library of the mosaic; `None` where nothing repeats.
    pub unit: Option<UnitTag>,
}

/// Which unit (columns too close to be told apart) a column belongs to, and where its like is in the library.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitTag {
    /// Unique in the specimen: the same for all columns of the unit.
    pub id: u64,
    /// Which column of the unit this is.
    pub member: usize,
    /// Centre (x, y) of the unit in nm.
    pub centre_nm: [f64; 2],
    /// Sheets that show units with such surroundings.
    pub family: Family,
    /// Its contents, and where they are in the sheets.
    pub entry: Entry,
    /// Carries directions in the sheet over to the field: rows of an orthogonal matrix.
    pub frame: [[f64; 2]; 2],
}

impl UnitTag {
    /// For a unit of an unrotated lattice; `first` is its first column.
    pub fn unrotated(
        (first, member): (ColumnIndex, usize),
        centre_nm: [f64; 2],
        structure: usize,
        entry: Entry,
    ) -> Self {
        UnitTag {
            id: first.id(),
            member,
            centre_nm,
            family: Family { motif: 0, structure, bin: entry.bin },
            entry,
            frame: [[1.0, 0.0], [0.0, 1.0]],
        }
    }
}

/// The columns of a region, complete, and their sites.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sites {
    /// Columns whose position lies in the region.
    pub columns: Vec<AtomColumn>,
    /// Sites of all of them.
    pub sites: Vec<SpecimenSite>,
}

impl Sites {
    /// Adds a column and its sites.
    pub fn push_column(
        &mut self,
        id: u64,
        position_nm: [f64; 2],
        unit: Option<UnitTag>,
        sites: impl Iterator<Item = SpecimenSite>,
    ) {
        let first = self.sites.len();
        self.sites.extend(sites);
        self.columns.push(AtomColumn { id, position_nm, sites: first..self.sites.len(), unit });
    }
}

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
        /// Standard deviation of the transition in nm (see [`super::recipe::Domains`]): 0 if abrupt.
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

/// The particles of a specimen with their centre in a region.
pub fn particles_in(specimen: &dyn Specimen, region: &Region) -> Vec<ParticleTruth> {
    let mut particles = specimen.particles();
    particles.retain(|p| region.contains([p.centre_nm[0], p.centre_nm[1]]));
    particles
}

/// A specimen of the full field.
pub trait Specimen: Send + Sync {
    /// The columns whose position lies in a region. The specimen ends [`BEYOND_FIELD_NM`] outside
    /// the field; a region has the same sites whichever way it is asked for.
    fn query(&self, region: &Region) -> Sites;
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
    fn sheet(&self, _family: Family) -> Option<Sheet> {
        None
    }
    /// The film behind everything else, for specimens that have one.
    fn film(&self) -> Option<ThinFilm> {
        None
    }
    /// Particles whose centre lies in the specimen.
    fn particles(&self) -> Vec<ParticleTruth> {
        Vec::new()
    }
}

/// The specimen that a recipe describes.
///
/// # Errors
/// [`crate::Error::Invalid`] when a value of the recipe is outside its limits.
pub fn specimen(recipe: &Recipe) -> Result<Box<dyn Specimen>> {
    recipe.check()?;
    let rigid: Box<dyn Specimen> = match recipe.structure {
        StructureKind::Grains => Box::new(Grains::new(recipe)?),
        StructureKind::Domains => Box::new(Domains::new(recipe)?),
        StructureKind::Epitaxy => Box::new(Epitaxy::new(recipe)?),
        StructureKind::Particles => Box::new(ParticlesOnCarbon::new(recipe)?),
    };
    Relaxed::of(rigid, recipe)
}
