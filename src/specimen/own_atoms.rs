//! Specimens from a file of atoms that the user supplies, and stacks: specimens whose atoms are all held in memory.
//!
//! All atoms are held in memory, in the columns that `beam_rows` finds. Columns that repeat share library cells. Without labels in the file
//! no atom is a defect: an arrangement of atoms alone does not show which atoms are out of place.

use rayon::prelude::*;

use super::held_columns::{HeldColumns, PlacedSite};
use super::repeating_units::{MOST_SHOWN_ANGSTROM, RepeatingUnits};
use crate::error::{Error, Result};
use crate::lengths;
use crate::recipe::CheckedRecipe;
use crate::recipe::atoms_table::AtomsTable;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::setting::Setting;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::sites::{DISPLACED_NM, SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{
    Boundary, ExpectedSites, ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout,
};
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::structure::{LabelledAtom, LabelledAtoms, SiteLabel};

/// Columns up to this distance outside the field are looked at in search of columns that repeat, in nm; the images of the field show them.
const LIBRARY_BEYOND_NM: f64 = 1.0;
/// Largest number of atoms of a specimen that is held in memory.
const MOST_ATOMS: usize = 10_000_000;

/// A specimen made of the atoms of the user's file, or of the layers of a stack.
pub struct OwnAtoms {
    columns: HeldColumns,
    /// The phase of each column.
    phases: Vec<u16>,
    repeating: RepeatingUnits,
    /// Displacement (x, y) of a tilted beam at half thickness, in Angstrom.
    way_angstrom: [f64; 2],
    library_seed: u64,
    facts: SpecimenFacts,
    boundaries: Vec<Boundary>,
    particles: Vec<HeldParticle>,
}

/// A particle of a specimen that is held in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldParticle {
    /// What the ground truth lists.
    pub truth: ParticleTruth,
    /// Index of its phase.
    pub phase: usize,
    /// Corners (x, y) in nm of its projection along the beam, which is convex, from +x to +y about it.
    pub shadow_nm: Vec<[f64; 2]>,
}

impl HeldParticle {
    /// Whether a point (x, y) in nm lies in the projection of the particle.
    fn covers(&self, [x, y]: [f64; 2]) -> bool {
        let corners = &self.shadow_nm;
        corners.len() > 2
            && (0..corners.len()).all(|k| {
                let [a, b] = [corners[k], corners[(k + 1) % corners.len()]];
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
            })
    }
}

impl OwnAtoms {
    /// Lays the atoms of the recipe's file into the field.
    ///
    /// # Errors
    /// [`Error::Invalid`] if no atom lies in the field, or too many do.
    pub fn new(recipe: &CheckedRecipe) -> Result<Self> {
        let atoms = recipe.atoms()?;
        let Some(table) = &recipe.atoms else {
            return Err(Error::invalid(
                Setting::Recipe,
                "atoms",
                "(missing): this structure needs the table",
            ));
        };
        let sites = with_keys(placed(atoms, table, recipe)?);
        let built = recipe.field.full_region();
        if !sites.iter().any(|(site, _)| built.contains([site.position_nm[0], site.position_nm[1]]))
        {
            let expected = "no atom of it lies in the field; correct atoms.origin_angstrom, or leave it out to have the atoms in the middle";
            return Err(Error::invalid(Setting::StructureFile, &table.file, expected));
        }
        let thickness_nm = recipe.field.thickness_nm;
        let phases = if atoms.groups.len() > 1 { atoms.groups.clone() } else { Vec::new() };
        let facts = SpecimenFacts { thickness_nm, phases, ..SpecimenFacts::default() };
        Ok(Self::in_columns(&sites, recipe, facts, Vec::new()))
    }

    /// Holds the sites of a stack, in any order, with its boundaries. `defects` returns the kind of a site and the element that it holds.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there are too many sites.
    pub(super) fn of_sites(
        sites: Vec<PlacedSite>,
        recipe: &CheckedRecipe,
        facts: SpecimenFacts,
        boundaries: Vec<Boundary>,
        defects: impl Fn(&SpecimenSite) -> (SiteKind, u8) + Sync,
    ) -> Result<Self> {
        check_count(sites.len() as f64)?;
        let mut sites = with_keys(sites);
        sites.par_iter_mut().for_each(|(site, _)| (site.kind, site.number) = defects(site));
        Ok(Self::in_columns(&sites, recipe, facts, boundaries))
    }

    /// Adds the particles whose atoms are among the sites.
    pub(super) fn with_particles(mut self, particles: Vec<HeldParticle>) -> Self {
        self.facts.particle_outlines = particles.iter().map(|p| p.truth.outline()).collect();
        self.particles = particles;
        self
    }

    /// Finds the columns of sites that are sorted by depth, and which of them repeat in the field.
    fn in_columns(
        sites: &[PlacedSite],
        recipe: &CheckedRecipe,
        facts: SpecimenFacts,
        boundaries: Vec<Boundary>,
    ) -> Self {
        let field = recipe.field.full_region();
        let half = 0.5 * facts.thickness_angstrom();
        let way_angstrom = recipe.optics.optics().slope().map(|slope| slope * half);
        let (columns, phases) = HeldColumns::new(sites, field.grown(BEYOND_FIELD_NM));
        let repeating = RepeatingUnits::find(&columns, &field.grown(LIBRARY_BEYOND_NM));
        let particles = columns.site_counts();
        let expected_sites = Some(ExpectedSites { per_nm2: 0.0, particles });
        let shown_within_angstrom = Some(MOST_SHOWN_ANGSTROM);
        let facts = SpecimenFacts { expected_sites, shown_within_angstrom, ..facts };
        let particles = Vec::new();
        let library_seed = recipe.phonons.library_seed;
        OwnAtoms {
            columns,
            phases,
            repeating,
            way_angstrom,
            library_seed,
            facts,
            boundaries,
            particles,
        }
    }

    /// A column without its sites.
    fn column(&self, n: usize) -> AtomColumn {
        AtomColumn {
            id: self.columns.id(n),
            position_nm: self.columns.position_nm(n),
            sites: 0..0,
            unit: self.repeating.tag(&self.columns, n),
        }
    }
}

/// Sorts sites by depth, and gives them unique keys.
fn with_keys(mut sites: Vec<PlacedSite>) -> Vec<PlacedSite> {
    sites.par_sort_by(|(a, _), (b, _)| {
        let along = |k: usize| a.position_nm[k].total_cmp(&b.position_nm[k]);
        along(2).then(along(1)).then(along(0)).then(a.number.cmp(&b.number))
    });
    sites.iter_mut().enumerate().for_each(|(key, (site, _))| site.key = key as u64);
    sites
}

/// Returns the sites in and about the field.
fn placed(
    atoms: &LabelledAtoms,
    table: &AtomsTable,
    recipe: &CheckedRecipe,
) -> Result<Vec<PlacedSite>> {
    let field = recipe.field.full_region();
    // A column may have its position inside the field and atoms outside.
    let around = field.grown(BEYOND_FIELD_NM + 2.0 * DISPLACED_NM);
    let [x, y, [first, _]] = atoms.extent();
    let middle = [(x, field.x), (y, field.y)].map(|(ends, field)| {
        0.5 * (ends[0] + ends[1]) - lengths::angstrom_by_division(0.5 * (field[0] + field[1]))
    });
    let origin = table.origin_angstrom.unwrap_or(middle);
    let edges = [atoms.cell[0][0], atoms.cell[1][1]];
    let ranges = [around.x, around.y];
    // Shifts, in cells, that move a coordinate of an atom into or near the field.
    let shifts = |k: usize, coordinate: f64| {
        if !table.repeat {
            return 0..=0;
        }
        let cells =
            |nm: f64| (lengths::angstrom_by_division(nm) + origin[k] - coordinate) / edges[k];
        cells(ranges[k][0]).ceil() as i64..=cells(ranges[k][1]).floor() as i64
    };
    if table.repeat {
        let cells = [0, 1]
            .map(|k| lengths::angstrom_by_division(ranges[k][1] - ranges[k][0]) / edges[k] + 1.0);
        check_count(cells[0] * cells[1] * atoms.atoms.len() as f64)?;
    }
    let site = |atom: &LabelledAtom, shift: [i64; 2]| {
        let [x, y, z] = atom.position;
        let across = |k: usize, v: f64| v + shift[k] as f64 * edges[k] - origin[k];
        let position_nm = lengths::nm([across(0, x), across(1, y), z - first]);
        let kind = match atom.label {
            SiteLabel::Pristine => SiteKind::Pristine,
            SiteLabel::Vacancy => SiteKind::Vacancy,
            SiteLabel::Substitution => SiteKind::Substitution,
        };
        (SpecimenSite { key: 0, position_nm, number: atom.number, kind }, atom.group)
    };
    let images = |atom: &LabelledAtom| {
        let mut found = Vec::new();
        for j in shifts(1, atom.position[1]) {
            found.extend(shifts(0, atom.position[0]).map(|i| site(atom, [i, j])));
        }
        found.retain(|(site, _)| around.contains([site.position_nm[0], site.position_nm[1]]));
        found
    };
    let sites: Vec<PlacedSite> = atoms.atoms.par_iter().flat_map_iter(images).collect();
    check_count(sites.len() as f64)?;
    Ok(sites)
}

fn check_count(atoms: f64) -> Result<()> {
    if atoms <= MOST_ATOMS as f64 {
        return Ok(());
    }
    let expected = format!(
        "about {atoms:.0} atoms lie in the field and {BEYOND_FIELD_NM} nm around it, and at most {MOST_ATOMS} are held in memory; \
         take a smaller field (field.fov_nm)"
    );
    Err(Error::invalid(Setting::Recipe, "atoms", expected))
}

impl SpecimenLayout for OwnAtoms {
    fn facts(&self) -> &SpecimenFacts {
        &self.facts
    }

    fn boundaries(&self) -> Vec<Boundary> {
        self.boundaries.clone()
    }

    /// Returns the phase of the particle that covers the point, or else of the nearest column.
    fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        if self.facts.phases.is_empty() {
            return 0;
        }
        if let Some(particle) = self.particles.iter().find(|p| p.covers(position_nm)) {
            return particle.phase;
        }
        let column = self.columns.nearest(position_nm);
        column.map_or(0, |column| usize::from(self.phases[column]))
    }

    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        let beam = (self.facts.thickness_angstrom(), self.way_angstrom);
        self.repeating.library_cell(&self.columns, family, beam, self.library_seed)
    }

    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        let reaching = |p: &&HeldParticle| p.truth.outline().reaches(region);
        self.particles.iter().filter(reaching).map(|p| p.truth.clone()).collect()
    }
}

impl Specimen for OwnAtoms {
    fn layout(&self) -> &dyn SpecimenLayout {
        self
    }

    fn query(&self, region: &Region) -> Sites {
        let mut out = Sites::default();
        for n in self.columns.inside(region) {
            let AtomColumn { id, position_nm, unit, .. } = self.column(n);
            out.push_column(id, position_nm, unit, self.columns.sites(n).iter().copied());
        }
        out
    }

    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.columns.inside(region).map(|n| self.column(n)).collect()
    }

    fn particles_on_a_plane(&self, _: &Region) -> Sites {
        Sites::default()
    }

    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        vec![family]
    }
}
