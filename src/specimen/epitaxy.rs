//! An alloy grown along +x, coherent with a substrate of its pure host crystal: a composition gradient, or quantum wells. `alloy_spacing`
//! computes the spacing of its planes.

use std::cell::LazyCell;
use std::collections::HashMap;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::lengths;
use crate::plane;
use crate::recipe::CheckedRecipe;
use crate::recipe::region::Region;
use crate::recipe::tables::{Alloy, CompositionProfile, Wells};
use crate::rng::{self, Purpose};
use crate::specimen::alloy_spacing::{Spacing, TabulatedComposition, TabulatedStretch};
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::coherent::{Coherent, Stretch};
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::composition::{Composition, InterfacesAlongBeam};
use crate::specimen::defects::rules::Defects;
use crate::specimen::sites::{SiteKind, SpecimenSite};
use crate::specimen::specimen_trait::{
    Boundary, BoundaryKind, ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout,
};
use crate::specimen::units::known_tags::KnownTags;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::occupation::UnitOccupation;
use crate::specimen::units::patterns;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::specimen::units::unit_tag::UnitTag;
use crate::structure::elements;

/// Draw of [`Purpose::Defect`] that decides about guests (see [`super::defects`]).
const GUEST_DRAW: u32 = 2;
/// Largest number of rounds in which the wells are filled; two or three suffice.
const FILLINGS: usize = 12;

/// An alloy grown along +x, coherent with its substrate.
pub(crate) struct Epitaxy {
    lattice: Coherent<TabulatedStretch>,
    composition: Composition,
    host: u8,
    guest: u8,
    defects: Defects,
    seed: u64,
    spacing: Spacing,
    /// The contents of units; with `None` each site is drawn separately.
    contents: Option<UnitOccupation>,
    facts: SpecimenFacts,
}

impl Epitaxy {
    /// Lays out composition and lattice.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an end member of another structure, or wells that cannot hold the rate.
    pub(crate) fn new(recipe: &CheckedRecipe) -> Result<Self> {
        let Some(alloy) = &recipe.alloy else {
            return Err(Error::invalid(
                crate::Setting::Alloy,
                "(missing)",
                "this structure needs the table",
            ));
        };
        let crystal = recipe.columns()?.clone();
        let spacing = Spacing::new(recipe, alloy, &crystal)?;
        let field = recipe.field.full_region();
        let thickness = lengths::nm(
            crystal.cells_along_beam(recipe.field.thickness_nm) as f64 * crystal.cell[2],
        );
        let wells = recipe.wells.as_ref();
        let composition = Composition::new(alloy, wells, &field, thickness, recipe.seed);
        let table = TabulatedComposition::new(&composition, &field);
        let stretch = spacing.stretch(&table, composition.fraction());
        let number = elements::atomic_number;
        let mut specimen = Epitaxy {
            lattice: Coherent::new(crystal, &recipe.field, stretch),
            composition,
            host: number(&alloy.host)?,
            guest: number(&alloy.guest)?,
            defects: Defects::default(),
            seed: recipe.seed,
            spacing,
            contents: None,
            facts: SpecimenFacts::default(),
        };
        specimen.contents = UnitOccupation::new(recipe, &specimen.lattice.crystal)?;
        if let (CompositionProfile::Wells, Some(wells)) = (alloy.profile, wells) {
            specimen.fill_wells(alloy, wells, &table)?;
        }
        specimen.defects = Defects::fit(recipe, |element, histogram| {
            let sites = specimen.lattice.crystal.chains().filter(|c| c.number == element).count();
            histogram.add(f64::INFINITY, sites as u64);
        })?;
        specimen.facts = SpecimenFacts {
            thickness_nm: specimen.lattice.thickness_nm(),
            phases: specimen.composition.phases(),
            ..SpecimenFacts::default()
        };
        Ok(specimen)
    }

    /// Sets the fraction of guests in the wells so that the mean over the field's host sites is the rate. The lattice depends on the
    /// fraction, and the number of planes in the wells on the lattice, so the fraction is iterated.
    fn fill_wells(
        &mut self,
        alloy: &Alloy,
        wells: &Wells,
        table: &TabulatedComposition,
    ) -> Result<()> {
        let lines = self.host_lines();
        let mut last = f64::NAN;
        for _ in 0..FILLINGS {
            let share = self.share_of_wells(&lines);
            let fraction = alloy.rate / share;
            if !(0.0..=1.0).contains(&fraction) {
                let expected = format!(
                    "at most {share:.4}: {} wells of {} nm hold no more of the field's {} sites",
                    wells.count, wells.width_nm, alloy.host
                );
                return Err(Error::invalid(crate::Setting::AlloyRate, alloy.rate, expected));
            }
            self.composition.set_fraction(fraction);
            if (fraction - last).abs() < 1e-9 {
                break;
            }
            last = fraction;
            self.lattice.stretch = self.spacing.stretch(table, fraction);
        }
        // If the last lattice moved a plane across an interface, the share is taken from that lattice.
        self.composition.set_fraction((alloy.rate / self.share_of_wells(&lines)).min(1.0));
        Ok(())
    }

    /// Returns the columns of the field with host sites as lines along y, one for each kind.
    fn host_lines(&self) -> Vec<HostLine> {
        let lattice = &self.lattice;
        let line = |kind: usize| {
            let chains = lattice.crystal.columns[kind].chains.iter();
            let hosts = chains.filter(|chain| chain.number == self.host);
            let heights: Vec<f64> = hosts
                .flat_map(|c| (0..lattice.cells_along_beam).map(|n| lattice.height(n, c)))
                .collect();
            let y = |j: i64| lattice.reference(ColumnIndex { grain: 0, kind, cell: [0, j] })[1];
            let inside = |y: &f64| lattice.field.contains([lattice.field.x[0], *y]);
            let rows: Vec<f64> = lattice.cells(&lattice.field, 1).map(y).filter(inside).collect();
            let interfaces = |y: &f64| self.composition.interfaces_at(*y, &heights);
            HostLine { kind, sites: heights.len(), rows: rows.par_iter().map(interfaces).collect() }
        };
        let lines = (0..lattice.crystal.columns.len()).map(line);
        lines.filter(|line| line.sites > 0).collect()
    }

    /// Returns the share of the field's host sites that lie in wells.
    fn share_of_wells(&self, lines: &[HostLine]) -> f64 {
        let (lattice, wells) = (&self.lattice, &self.composition);
        // All columns of one kind and one index along x have the same x.
        let count = |(i, line): (i64, &HostLine)| {
            let index = ColumnIndex { grain: 0, kind: line.kind, cell: [i, 0] };
            let x = lattice.stretch.to_field(lattice.reference(index)[0], &());
            if !lattice.field.contains([x, lattice.field.y[0]]) {
                return [0; 2];
            }
            let all = line.rows.len() * line.sites;
            match wells.wells_near(x) {
                (true, _) => [all; 2],
                (false, near) => [line.rows.iter().map(|row| row.count_in(&near, x)).sum(), all],
            }
        };
        let cells = lattice.cells(&lattice.field, 0).into_par_iter();
        let columns = cells.flat_map_iter(|i| lines.iter().map(move |line| (i, line)));
        let sum = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        let [inside, all] = columns.map(count).reduce(Default::default, sum);
        inside as f64 / all.max(1) as f64
    }

    /// Returns the place in the library of a unit of a kind, by its first column; `mean` is [`Composition::mean`].
    fn tag(
        &self,
        kind: usize,
        first: ColumnIndex,
        mean: impl FnOnce(f64) -> f64,
    ) -> Option<UnitTag> {
        let contents = self.contents.as_ref()?;
        let members = &contents.units.kinds[kind];
        let position = |column: ColumnIndex| {
            let at = self.lattice.reference(column);
            [self.lattice.stretch.to_field(at[0], &()), at[1]]
        };
        let centre = self.lattice.centre(members, first, position);
        let entry = match contents.process.filter(|p| p.element == self.host && p.by.is_some()) {
            None => contents.draw(
                kind,
                first,
                self.defects.at(f64::INFINITY).rate(contents.process.map_or(0, |p| p.element)),
            )?,
            Some(_) => {
                let around = mean(centre[0]);
                let open = self.open_sites(contents, (kind, first), position);
                let rates = (open.rate, around);
                let drawn = contents.draw_among(kind, first, open.rate, around, &open.allowed);
                // Where few sites are open the pool may lack the drawn number, but it usually has the most frequent draw: no guest.
                // Otherwise the number of guests is right, and some of them lie above or below the well.
                let guests = LazyCell::new(|| self.guests(contents, (kind, first), position));
                let found = || contents.find(kind, first, open.rate, around, &guests);
                let nearest = || contents.nearest(kind, first, rates, (&guests, &open.allowed));
                drawn.or_else(found).or_else(nearest)?
            }
        };
        Some(UnitTag::unrotated((first, 0), centre, 0, entry))
    }

    /// Returns the sites of a unit that guests may take; `position` computes the position of a column.
    fn open_sites(
        &self,
        contents: &UnitOccupation,
        unit: (usize, ColumnIndex),
        position: impl Fn(ColumnIndex) -> [f64; 2],
    ) -> OpenSites {
        let allowed = vec![false; contents.pool.sites(unit.0)];
        let mut open = OpenSites { rate: 0.0, allowed };
        self.for_each_host(contents, unit, position, |site, fraction, _| {
            open.allowed[site] = fraction > 0.0;
            open.rate = open.rate.max(fraction);
        });
        open
    }

    /// Draws each site of a unit separately, and returns the sites that hold a guest, ascending.
    fn guests(
        &self,
        contents: &UnitOccupation,
        unit: (usize, ColumnIndex),
        position: impl Fn(ColumnIndex) -> [f64; 2],
    ) -> Vec<u16> {
        let mut guests = Vec::new();
        self.for_each_host(contents, unit, position, |site, fraction, key| {
            if self.draws_guest(fraction, key) {
                guests.push(site as u16);
            }
        });
        guests.sort_unstable();
        guests
    }

    /// Calls `f(site, fraction of guests there, key)` for the sites of a unit that guests may take.
    fn for_each_host(
        &self,
        contents: &UnitOccupation,
        (kind, first): (usize, ColumnIndex),
        position: impl Fn(ColumnIndex) -> [f64; 2],
        mut f: impl FnMut(usize, f64, u64),
    ) {
        for member in &contents.units.kinds[kind] {
            let cell = plane::add(first.cell, member.cell);
            let index = ColumnIndex { kind: member.kind, cell, ..first };
            let [x, y] = position(index);
            let along_beam = self.composition.along_beam([x, y]);
            let chains = &self.lattice.crystal.columns[member.kind].chains;
            for (n, chain) in chains.iter().enumerate() {
                for cell in 0..self.lattice.cells_along_beam {
                    let Some(site) = contents.site(member.kind, n, cell) else { continue };
                    let there = || self.composition.at([x, y, self.lattice.height(cell, chain)]);
                    f(site, along_beam.unwrap_or_else(there), index.key(chain, cell));
                }
            }
        }
    }

    /// Whether a site that is drawn separately holds a guest.
    fn draws_guest(&self, fraction: f64, key: u64) -> bool {
        fraction > 0.0 && rng::uniform(self.seed, Purpose::Defect, GUEST_DRAW, key) < fraction
    }

    /// Lists the columns of a region; without sites if `with_sites` is false.
    fn listed(&self, region: &Region, with_sites: bool) -> Sites {
        let mut out = Sites::default();
        let defects = self.defects.at(f64::INFINITY);
        let mut tags = KnownTags::default();
        // Many units have the same x.
        let mut means: HashMap<u64, f64> = HashMap::new();
        let mut mean =
            |x: f64| *means.entry(x.to_bits()).or_insert_with(|| self.composition.mean(x));
        self.for_each_column(region, |index, [x, y]| {
            let chains = &self.lattice.crystal.columns[index.kind].chains;
            let cells = 0..if with_sites { self.lattice.cells_along_beam } else { 0 };
            let tag = self.contents.as_ref().and_then(|contents| {
                let (kind, member, first) = contents.unit_of(index);
                tags.get((first, member), || self.tag(kind, first, &mut mean))
            });
            let contents = self.contents.as_ref().zip(tag);
            let sites =
                cells.flat_map(|cell| chains.iter().enumerate().map(move |(n, c)| (cell, n, c)));
            let sites = sites.map(|(cell, n, chain)| {
                let key = index.key(chain, cell);
                let z = self.lattice.height(cell, chain);
                if let Some((contents, tag)) = &contents {
                    let place = [index.kind, n, cell];
                    let (kind, number) = contents.holds(tag.entry, place, chain.number);
                    return SpecimenSite { key, position_nm: [x, y, z], number, kind };
                }
                let (mut kind, mut number) = defects.of(key, chain.number);
                let host = kind == SiteKind::Pristine && number == self.host;
                if host && self.draws_guest(self.composition.at([x, y, z]), key) {
                    (kind, number) = (SiteKind::Substitution, self.guest);
                }
                SpecimenSite { key, position_nm: [x, y, z], number, kind }
            });
            out.push_column(index.id(), [x, y], tag, sites);
        });
        out
    }

    /// Calls `f(column, position)` for the columns whose position lies in `region`.
    fn for_each_column(&self, region: &Region, mut f: impl FnMut(ColumnIndex, [f64; 2])) {
        let stretch = &self.lattice.stretch;
        let place = |_, at: [f64; 2], row: &()| ([stretch.to_field(at[0], row), at[1]], ());
        self.lattice.for_each_column(region, place, |index, position, (), ()| f(index, position));
    }
}

/// All columns of one kind with the same index along x, at any such index.
struct HostLine {
    /// Kind of the columns.
    kind: usize,
    /// Host sites of a column.
    sites: usize,
    /// Positions of the interfaces at the y of each column and the heights of its sites.
    rows: Vec<InterfacesAlongBeam>,
}

/// The sites of a unit that guests may take.
struct OpenSites {
    /// Rate of guests on the open sites.
    rate: f64,
    /// Whether each site is open.
    allowed: Vec<bool>,
}

impl SpecimenLayout for Epitaxy {
    fn facts(&self) -> &SpecimenFacts {
        &self.facts
    }

    fn boundaries(&self) -> Vec<Boundary> {
        let line = |(n, line_nm): (usize, Vec<[f64; 2]>)| Boundary {
            line_nm,
            kind: BoundaryKind::Phase { sides: [n % 2, (n + 1) % 2], sharpness_sigma_nm: 0.0 },
        };
        let y = self.lattice.field.y;
        self.composition.interfaces(y).into_iter().enumerate().map(line).collect()
    }

    fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        usize::from(self.composition.is_well(position_nm))
    }

    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        let contents = self.contents.as_ref()?;
        let crystal = &self.lattice.crystal;
        let alloy = contents.process.is_some_and(|p| p.element == self.host && p.by.is_some());
        let fraction = if alloy { patterns::rate_of(family.bin) } else { 0.0 };
        let cell = [crystal.cell[0] * self.spacing.relative(fraction), crystal.cell[1]];
        let place = |depth: usize, kind: usize, number: usize| {
            let column = &crystal.columns[kind];
            let z =
                lengths::angstrom_by_division(self.lattice.height(depth, &column.chains[number]));
            [column.xy[0] * cell[0], column.xy[1] * cell[1], z]
        };
        let depth = self.lattice.cells_along_beam;
        Some(LibraryCell::lattice(contents, crystal, (cell, family.bin), depth, place))
    }

    fn particles_reaching(&self, _: &Region) -> Vec<ParticleTruth> {
        Vec::new()
    }
}

impl Specimen for Epitaxy {
    fn layout(&self) -> &dyn SpecimenLayout {
        self
    }

    fn query(&self, region: &Region) -> Sites {
        self.listed(region, true)
    }

    fn columns(&self, region: &Region) -> Vec<AtomColumn> {
        self.listed(region, false).columns
    }

    fn particles_on_a_plane(&self, _: &Region) -> Sites {
        Sites::default()
    }

    fn reached_families(&self, family: UnitFamily) -> Vec<UnitFamily> {
        vec![family]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::Difficulty;

    /// At rough interfaces the pool gives the nearest pattern that it has: no column is simulated separately, and few guests leave the
    /// wells.
    #[test]
    fn all_columns_are_in_the_library_and_few_guests_beside_the_wells() {
        for difficulty in [Difficulty::Medium, Difficulty::Hard] {
            let recipe = CheckedRecipe::load("gan", difficulty).unwrap();
            let specimen = Epitaxy::new(&recipe).unwrap();
            let field = recipe.field.full_region();
            let [mut guests, mut beside, mut alone] = [0u32; 3];
            for k in 0..20 {
                let y = [0, 1].map(|n| field.y[0] + 4.0 * f64::from(k + n));
                let found = specimen.query(&Region { y, ..field });
                alone += found.columns.iter().filter(|c| c.unit.is_none()).count() as u32;
                for site in found.sites.iter().filter(|s| s.kind == SiteKind::Substitution) {
                    guests += 1;
                    beside += u32::from(specimen.composition.at(site.position_nm) == 0.0);
                }
            }
            println!(
                "{difficulty:?}: {guests} guests, {beside} beside the wells, {alone} columns alone"
            );
            assert_eq!(alone, 0, "{difficulty:?}");
            assert!(f64::from(beside) < 0.01 * f64::from(guests), "{difficulty:?}: {beside}");
        }
    }
}
