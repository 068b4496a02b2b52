//! Metal particles on a film of amorphous carbon.
//!
//! The particles lie on the film's side towards the gun. A column of the ground truth is a row of atoms of a particle that runs along the
//! beam to within [`ROW_TILT_DEG`], with steps of at most [`ROW_STEP`] cell edges, and of which no atom lies farther than [`DISPLACED_NM`]
//! from the mean in projection along the beam. Each atom in no such row, and each atom of the carbon, is a column of one atom.

use std::ops::Range;
use std::sync::OnceLock;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lengths;
use crate::models::carbon::block::atoms_per_nm2;
use crate::models::carbon::carbon_film::{Film, FilmAtom};
use crate::models::carbon::network::CARBON;
use crate::models::particles::rotation::Rotation;
use crate::models::particles::{Metal, Morphology, build};
use crate::recipe::CheckedRecipe;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::Particles;
use crate::rng::{Purpose, uniform};
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::defects::rules::{Defects, LocalDefects};
use crate::specimen::particle_orientation::near_zone_axis;
use crate::specimen::scattered_circles::{NoPlace, scattered};
use crate::specimen::sites::{DISPLACED_NM, SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{
    Boundary, ExpectedSites, ParticleOutline, ParticleTruth, Specimen, SpecimenFacts,
    SpecimenLayout, ThinFilm,
};
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::unit_tag::UnitFamily;

/// Largest angle in degrees between the beam and a row of atoms that is a column: more than the tilt of the particles on the easy tier.
pub const ROW_TILT_DEG: f64 = 3.0;
/// Longest step in a row, in cell edges: the step along \[111\].
pub const ROW_STEP: f64 = 1.75;
/// Deviation of an atom from a straight row by strain, in Angstrom.
const ROW_STRAIN: f64 = 0.1;

/// Vacuum above the highest particle and below the film, in Angstrom.
const VACUUM: f64 = 1.0;
/// Bit that is set in the keys of particles' atoms.
const PARTICLE_KEY: u64 = 1 << 60;

/// A specimen of metal particles on a film of amorphous carbon.
pub struct ParticlesOnCarbon {
    particles: Vec<PlacedParticle>,
    film: Film,
    /// Depth of the film's upper face in Angstrom.
    face: f64,
    contact: f64,
    number: u8,
    defects: LocalDefects,
    extent: Region,
    facts: SpecimenFacts,
}

/// A particle; lengths in Angstrom.
struct PlacedParticle {
    morphology: Morphology,
    diameter_nm: f64,
    rotation: Rotation,
    /// Centre (x, y) in the specimen.
    centre: [f64; 2],
    /// Atoms relative to the centre, rotated.
    atoms: Vec<[f64; 3]>,
    /// Radius of the circle around the particle.
    radius: f64,
    /// Height of the centre, and columns as ranges of `atoms` (sorted accordingly); known once it lies on the film.
    height: OnceLock<f64>,
    rows: Vec<Range<usize>>,
}

/// Numbers of the random draws for particles.
mod draw {
    pub const DIAMETER: u32 = 0;
}

impl ParticlesOnCarbon {
    /// Builds the particles and places them at random in the field.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the particles do not fit into the field, or no particle has the requested diameter.
    pub fn new(recipe: &CheckedRecipe) -> Result<Self> {
        let Some(table) = &recipe.particles else {
            return Err(Error::invalid(
                crate::Setting::Particles,
                "(missing)",
                "this structure needs the table",
            ));
        };
        let (number, metal) = recipe.metal()?;
        let made = (0..table.count)
            .into_par_iter()
            .map(|k| PlacedParticle::new(k, table, metal, recipe.seed));
        let mut particles = made.collect::<Result<Vec<_>>>()?;
        let field = recipe.field.full_region();
        place(&mut particles, &field, table, recipe.seed)?;
        let tallest = particles.iter().map(PlacedParticle::tall).fold(0.0, f64::max);
        let face = VACUUM + tallest + table.contact_angstrom;
        let thickness = lengths::angstrom_by_division(recipe.field.thickness_nm);
        Ok(ParticlesOnCarbon {
            facts: facts(&particles, face, thickness),
            particles,
            film: Film::new(recipe.seed, thickness),
            face,
            contact: table.contact_angstrom,
            number,
            defects: Defects::fit(recipe, |_, _| {})?.at(f64::INFINITY),
            extent: field.grown(BEYOND_FIELD_NM),
        })
    }

    fn film_atoms(&self, area: [[f64; 2]; 2]) -> Vec<FilmAtom> {
        let mut atoms = self.film.atoms(&area);
        atoms.iter_mut().for_each(|a| a.position[2] += self.face);
        atoms
    }

    /// Returns the depth of a particle's centre in Angstrom: the greatest depth at which it rests on the film.
    fn height(&self, particle: &PlacedParticle) -> f64 {
        *particle.height.get_or_init(|| {
            let reach = particle.radius + self.contact;
            let area = particle.centre.map(|c| [c - reach, c + reach]);
            // The film reaches deeper than any particle can sink.
            let top = self.face + 3.0 * self.contact;
            let mut carbon = self.film_atoms(area);
            carbon.retain(|a| a.position[2] < top);
            particle.resting_height(&carbon, self.contact, self.face)
        })
    }

    fn truth(&self, particle: &PlacedParticle) -> ParticleTruth {
        let ParticleOutline { centre_nm: [x, y], diameter_nm, morphology } = particle.outline();
        let centre_nm = [x, y, lengths::nm(self.height(particle))];
        ParticleTruth { centre_nm, diameter_nm, morphology, orientation: particle.rotation.0 }
    }

    /// Adds the columns of a particle in a region; `height` computes the depth of its centre in Angstrom if there are any.
    fn push_particle(
        &self,
        index: usize,
        region: &Region,
        height: impl FnOnce(&PlacedParticle) -> f64,
        out: &mut Sites,
    ) {
        let particle = &self.particles[index];
        let [x, y] = particle.centre;
        let box_nm = |c: f64| lengths::nm([c - particle.radius, c + particle.radius]);
        let all = Region { x: box_nm(x), y: box_nm(y) }.intersection(region);
        if all.x[0] > all.x[1] || all.y[0] > all.y[1] {
            return;
        }
        let height = height(particle);
        for row in &particle.rows {
            let n = row.len() as f64;
            let mean = |k: usize| particle.atoms[row.clone()].iter().map(|p| p[k]).sum::<f64>() / n;
            let at = lengths::nm([x + mean(0), y + mean(1)]);
            if !region.contains(at) {
                continue;
            }
            let key = |n: usize| PARTICLE_KEY | (index as u64) << 32 | n as u64;
            let first = out.sites.len();
            for n in row.clone() {
                let p = particle.atoms[n];
                let (kind, number) = self.defects.of(key(n), self.number);
                let position_nm = lengths::nm([x + p[0], y + p[1], height + p[2]]);
                out.sites.push(SpecimenSite { key: key(n), position_nm, number, kind });
            }
            let sites = first..out.sites.len();
            out.columns.push(AtomColumn { id: key(row.start), position_nm: at, sites, unit: None });
        }
    }
}

impl SpecimenLayout for ParticlesOnCarbon {
    fn facts(&self) -> &SpecimenFacts {
        &self.facts
    }

    fn boundaries(&self) -> Vec<Boundary> {
        Vec::new()
    }

    fn phase_at(&self, _: [f64; 2]) -> usize {
        0
    }

    fn library_cell(&self, _: UnitFamily) -> Option<LibraryCell> {
        None
    }

    fn particles_reaching(&self, region: &Region) -> Vec<ParticleTruth> {
        let reaching = self.particles.iter().filter(|p| p.outline().reaches(region));
        reaching.map(|p| self.truth(p)).collect()
    }
}

impl Specimen for ParticlesOnCarbon {
    fn layout(&self) -> &dyn SpecimenLayout {
        self
    }

    fn query(&self, region: &Region) -> Sites {
        let region = region.intersection(&self.extent);
        let mut out = Sites::default();
        if region.x[0] >= region.x[1] || region.y[0] >= region.y[1] {
            return out;
        }
        for index in 0..self.particles.len() {
            self.push_particle(index, &region, |p| self.height(p), &mut out);
        }
        // The area is slightly larger than the region: the comparison in nm decides whether an atom lies inside.
        let area = lengths::angstrom_by_division([region.x, region.y])
            .map(|[low, high]| [low - 1e-6, high + 1e-6]);
        for FilmAtom { key, position } in self.film_atoms(area) {
            let position_nm = lengths::nm(position);
            let at = [position_nm[0], position_nm[1]];
            if region.contains(at) {
                let first = out.sites.len();
                out.sites.push(SpecimenSite {
                    key,
                    position_nm,
                    number: CARBON,
                    kind: SiteKind::Pristine,
                });
                out.columns.push(AtomColumn {
                    id: key,
                    position_nm: at,
                    sites: first..first + 1,
                    unit: None,
                });
            }
        }
        out
    }

    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.query(region).into_columns()
    }

    fn particles_on_a_plane(&self, region: &Region) -> Sites {
        let mut out = Sites::default();
        for index in 0..self.particles.len() {
            let height = |p: &PlacedParticle| self.face - self.contact - p.lowest();
            self.push_particle(index, region, height, &mut out);
        }
        out
    }

    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        vec![family]
    }
}

/// Collects the facts of particles on a film, whose upper face and thickness are in Angstrom.
fn facts(particles: &[PlacedParticle], face: f64, thickness: f64) -> SpecimenFacts {
    let per_nm2 = atoms_per_nm2(lengths::nm(thickness));
    let outlines: Vec<ParticleOutline> = particles.iter().map(PlacedParticle::outline).collect();
    let sites = particles.iter().map(|p| p.atoms.len() as u64);
    let particles = outlines.iter().map(|p| p.centre_nm).zip(sites).collect();
    SpecimenFacts {
        thickness_nm: lengths::nm(face + thickness + VACUUM),
        film: Some(ThinFilm {
            number: CARBON,
            depth_nm: lengths::nm([face, face + thickness]),
            atoms_per_nm2: per_nm2,
            other_keys: PARTICLE_KEY,
        }),
        particle_outlines: outlines,
        expected_sites: Some(ExpectedSites { per_nm2, particles }),
        ..SpecimenFacts::default()
    }
}

impl PlacedParticle {
    fn new(index: usize, table: &Particles, metal: &Metal, seed: u64) -> Result<Self> {
        let morphology = table.morphologies[index % table.morphologies.len()];
        let drawn = |what: u32| uniform(seed, Purpose::Particle, what, index as u64);
        let [low, high] = table.diameter_nm;
        let wanted = low + (high - low) * drawn(draw::DIAMETER);
        let cluster = build(morphology, metal, wanted, table.diameter_nm).map_err(|_| {
            let expected = format!(
                "no {} particle has a diameter in this range; widen the range",
                morphology.name()
            );
            Error::invalid(crate::Setting::ParticleDiameterNm, format!("[{low}, {high}]"), expected)
        })?;
        let rotation = near_zone_axis(morphology, table.max_tilt_deg, seed, index as u64);
        let mut atoms: Vec<[f64; 3]> =
            cluster.positions.iter().map(|&p| rotation.apply(p)).collect();
        let rows = rows(&mut atoms, metal.a);
        let lateral = |p: &[f64; 3]| (p[0] * p[0] + p[1] * p[1]).sqrt();
        Ok(PlacedParticle {
            morphology,
            diameter_nm: metal.diameter_nm(atoms.len()),
            rotation,
            centre: [0.0; 2],
            radius: atoms.iter().map(lateral).fold(0.0, f64::max) + 1e-3,
            atoms,
            height: OnceLock::new(),
            rows,
        })
    }

    fn outline(&self) -> ParticleOutline {
        ParticleOutline {
            centre_nm: lengths::nm(self.centre),
            diameter_nm: self.diameter_nm,
            morphology: self.morphology.name().to_owned(),
        }
    }

    /// Returns the extent along the beam.
    fn tall(&self) -> f64 {
        let ends = self
            .atoms
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |e, p| [e[0].min(p[2]), e[1].max(p[2])]);
        ends[1] - ends[0]
    }

    /// Returns the depth of the lowest atom below the centre.
    fn lowest(&self) -> f64 {
        self.atoms.iter().map(|p| p[2]).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the greatest depth of the centre at which no atom is nearer than `contact` to an atom of the carbon.
    fn resting_height(&self, carbon: &[FilmAtom], contact: f64, face: f64) -> f64 {
        let lowest = self.lowest();
        let mut height = face + 2.0 * contact - lowest;
        for p in self.atoms.iter().filter(|p| p[2] > lowest - 6.0 * contact) {
            let [x, y] = [0, 1].map(|k| self.centre[k] + p[k]);
            for c in carbon {
                let (dx, dy) = (c.position[0] - x, c.position[1] - y);
                let square = contact * contact - dx * dx - dy * dy;
                if square > 0.0 {
                    height = height.min(c.position[2] - square.sqrt() - p[2]);
                }
            }
        }
        height
    }
}

/// Sorts the atoms by rows along the beam, each by ascending z, and returns the rows.
fn rows(atoms: &mut Vec<[f64; 3]>, a: f64) -> Vec<Range<usize>> {
    atoms.sort_by(|p, q| {
        p[2].total_cmp(&q[2]).then(p[0].total_cmp(&q[0])).then(p[1].total_cmp(&q[1]))
    });
    let slope = libm::tan(ROW_TILT_DEG.to_radians());
    let near = AtomCells::new(atoms, slope * ROW_STEP * a + ROW_STRAIN);
    let mut before = vec![None; atoms.len()];
    let mut after = vec![None; atoms.len()];
    for i in 0..atoms.len() {
        let p = atoms[i];
        let in_row = |&j: &usize| {
            let d: [f64; 3] = std::array::from_fn(|k| atoms[j][k] - p[k]);
            let off = (d[0] * d[0] + d[1] * d[1]).sqrt();
            d[2] > 1.0
                && atoms[j][2] <= p[2] + ROW_STEP * a
                && off < slope * d[2] + ROW_STRAIN
                && before[j].is_none()
        };
        if let Some(next) =
            near.about(&p).filter_map(|cell| cell.iter().copied().find(in_row)).min()
        {
            after[i] = Some(next);
            before[next] = Some(i);
        }
    }
    let mut sorted = Vec::with_capacity(atoms.len());
    let mut rows = Vec::new();
    for first in (0..atoms.len()).filter(|&i| before[i].is_none()) {
        let start = sorted.len();
        let mut next = Some(first);
        while let Some(i) = next {
            sorted.push(atoms[i]);
            next = after[i];
        }
        push_row(start..sorted.len(), &sorted, &mut rows);
    }
    *atoms = sorted;
    rows
}

/// Atoms in square cells of (x, y), to look up the atoms near a place.
struct AtomCells {
    edge: f64,
    first: [f64; 2],
    shape: [usize; 2],
    /// Atom numbers of each cell, ascending.
    cells: Vec<Vec<usize>>,
}

impl AtomCells {
    fn new(atoms: &[[f64; 3]], edge: f64) -> Self {
        let ends = |k: usize| {
            let all = atoms.iter().map(|p| p[k]);
            all.fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(v), e[1].max(v)])
        };
        let ends = [ends(0), ends(1)];
        let shape = ends.map(|[low, high]| ((high - low).max(0.0) / edge) as usize + 1);
        let cells = vec![Vec::new(); shape[0] * shape[1]];
        let mut out = AtomCells { edge, first: ends.map(|e| e[0]), shape, cells };
        for (n, p) in atoms.iter().enumerate() {
            let [x, y] = out.cell(p);
            out.cells[y * shape[0] + x].push(n);
        }
        out
    }

    fn cell(&self, p: &[f64; 3]) -> [usize; 2] {
        [0, 1].map(|k| ((p[k] - self.first[k]) / self.edge) as usize)
    }

    /// Returns the cells about a place; they contain all atoms within one cell edge of it.
    fn about(&self, p: &[f64; 3]) -> impl Iterator<Item = &[usize]> {
        let [x, y] = self.cell(p);
        let near = |k: usize, at: usize| at.saturating_sub(1)..(at + 2).min(self.shape[k]);
        let columns = near(0, x);
        near(1, y).flat_map(move |y| {
            columns.clone().map(move |x| self.cells[y * self.shape[0] + x].as_slice())
        })
    }
}

/// Adds a row; a row that runs too far to the side for one column is split into halves.
fn push_row(row: Range<usize>, atoms: &[[f64; 3]], rows: &mut Vec<Range<usize>>) {
    let members = &atoms[row.clone()];
    let mean = |k: usize| members.iter().map(|p| p[k]).sum::<f64>() / members.len() as f64;
    let centre = [mean(0), mean(1)];
    let most = lengths::angstrom_by_division(0.99 * DISPLACED_NM);
    let square =
        |p: &[f64; 3]| (0..2).map(|k| (p[k] - centre[k]) * (p[k] - centre[k])).sum::<f64>();
    if members.iter().all(|p| square(p) < most * most) {
        return rows.push(row);
    }
    let middle = (row.start + row.end) / 2;
    push_row(row.start..middle, atoms, rows);
    push_row(middle..row.end, atoms, rows);
}

/// Places the particles at random in the field.
fn place(
    particles: &mut [PlacedParticle],
    field: &Region,
    table: &Particles,
    seed: u64,
) -> Result<()> {
    let radii: Vec<f64> = particles.iter().map(|p| p.radius).collect();
    let centres =
        scattered(&radii, &[], field, lengths::angstrom_by_division(table.gap_nm), (seed, 0));
    let centres = centres.map_err(|NoPlace { index, placed }| {
        let expected = format!(
            "after {placed} particles no place was found for another with a diameter of {:.2} nm, {} nm from the others; lower the number, \
             particles.diameter_nm or particles.gap_nm, or raise field.fov_nm",
            particles[index].diameter_nm, table.gap_nm
        );
        Error::invalid(crate::Setting::ParticleCount, table.count, expected)
    })?;
    particles.iter_mut().zip(centres).for_each(|(particle, centre)| particle.centre = centre);
    Ok(())
}
