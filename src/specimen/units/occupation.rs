//! The contents of the units of a lattice, drawn from a pool, and the layout of the pool in library cells.

use crate::error::Result;
use crate::plane;
use crate::recipe::resolved_recipe::Recipe;
use crate::recipe::tables::PointDefect;
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::sites::SiteKind;
use crate::specimen::units::patterns;
use crate::specimen::units::patterns::{DefectPatterns, UnitSeed};
use crate::specimen::units::unit_kinds::{UnitKinds, UnitMember};
use crate::specimen::units::unit_tag::PatternIndex;
use crate::structure::columns::ColumnCrystal;
use crate::structure::elements;

/// Least width of the periodic part of a library cell in Angstrom: more than twice the reach of a probe.
pub(crate) const LIBRARY_CELL_ANGSTROM: f64 = 19.0;
/// Number of patches in the library cells of a bin, all kinds of units and phonon configurations together. The mean square of the phonon
/// spread of one kind of four is then known to 7 % in each bin.
const PATCHES_PER_BIN: usize = 1800;
/// Number of patches for layers with `[[defects]]`, whose columns of at most [`THIN_SITES`] atoms have few contents, and for all kinds of
/// defects but the first.
const FEW_PATCHES_PER_BIN: usize = 450;
/// Largest number of sites of a column in a layer.
const THIN_SITES: usize = 2;

/// A kind of point defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DefectKind {
    /// Atomic number of the element concerned.
    pub element: u8,
    /// Atomic number of the element that replaces it; `None` for vacancies.
    pub by: Option<u8>,
}

impl DefectKind {
    /// Reads the kind from a table of a recipe.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`].
    pub(crate) fn of(defect: &PointDefect) -> Result<Self> {
        let by = defect.by.as_ref().map(|by| elements::atomic_number(by)).transpose()?;
        Ok(DefectKind { element: elements::atomic_number(&defect.element)?, by })
    }

    /// Returns the contents of a defective site (of a vacancy, the missing element).
    pub(crate) fn defect(self) -> (SiteKind, u8) {
        match self.by {
            Some(by) => (SiteKind::Substitution, by),
            None => (SiteKind::Vacancy, self.element),
        }
    }
}

/// Makes the seeds of different kinds of defects different.
const KIND_SEED: u64 = 0x9E37_79B9_7F4A_7C15;

/// The contents of the units of a crystal.
#[derive(Debug)]
pub(crate) struct UnitOccupation {
    /// The units of the crystal's cell.
    pub units: UnitKinds,
    /// The kind of defect, if any.
    pub process: Option<DefectKind>,
    /// Patterns of defects, by kind of unit and bin of rates.
    pub pool: DefectPatterns,
    /// Lattice cells of a library cell along x and y.
    pub lattice_cells: [usize; 2],
    /// Number of patches in the library cells of a bin.
    pub patches: usize,
    /// For each kind of column and each of its chains: the place among the chains of the unit that may be defects.
    places: Vec<Vec<Option<usize>>>,
    /// Number of chains of each kind of unit that may be defects.
    per_cell: Vec<usize>,
    seed: u64,
}

impl UnitOccupation {
    /// Prepares the units of a recipe with at most one kind of defect; `None` for others, whose sites are drawn one by one.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`].
    pub(crate) fn new(recipe: &Recipe, crystal: &ColumnCrystal) -> Result<Option<Self>> {
        match &kinds(recipe)?[..] {
            [] => Ok(None),
            [kind] => UnitOccupation::of_kind(recipe, crystal, *kind, PATCHES_PER_BIN).map(Some),
            [_, _, ..] => Ok(None),
        }
    }

    /// Prepares the units of a recipe for each of its kinds of defects; empty for recipes whose sites are drawn one by one.
    ///
    /// # Errors
    /// As [`UnitOccupation::new`].
    pub(crate) fn each(recipe: &Recipe, crystal: &ColumnCrystal) -> Result<Vec<Self>> {
        let mut all = Vec::new();
        for (number, kind) in (0u64..).zip(kinds(recipe)?) {
            let patches = patches_per_bin(recipe, crystal, number > 0);
            let mut contents = UnitOccupation::of_kind(recipe, crystal, kind, patches)?;
            // Kinds are drawn independently of each other.
            contents.seed ^= number.wrapping_mul(KIND_SEED);
            all.push(contents);
        }
        Ok(all)
    }

    fn of_kind(
        recipe: &Recipe,
        crystal: &ColumnCrystal,
        process: Option<DefectKind>,
        patches: usize,
    ) -> Result<Self> {
        let depth = crystal.cells_along_beam(recipe.field.thickness_nm);
        let units = UnitKinds::new(crystal);
        let mut per_cell = vec![0; units.kinds.len()];
        let mut places = vec![Vec::new(); crystal.columns.len()];
        for (kind, members) in units.kinds.iter().enumerate() {
            for UnitMember { kind: column, .. } in members {
                for chain in &crystal.columns[*column].chains {
                    let concerned = process.is_some_and(|p| p.element == chain.number);
                    places[*column].push(concerned.then_some(per_cell[kind]));
                    per_cell[kind] += usize::from(concerned);
                }
            }
        }
        let lattice_cells =
            [0, 1].map(|k| (LIBRARY_CELL_ANGSTROM / crystal.cell[k]).ceil().max(1.0) as usize);
        let per_library_cell = lattice_cells[0] * lattice_cells[1];
        let configurations = recipe.phonons.configurations.max(1);
        let units_per_cell = per_library_cell * units.kinds.len();
        let library_cells = library_cells(patches, units_per_cell, configurations);
        let sites = per_cell.iter().map(|n| n * depth).collect();
        let layout = [library_cells, per_library_cell];
        let pool = DefectPatterns::new(sites, layout, (recipe.phonons.library_seed, 0));
        let seed = recipe.seed;
        Ok(UnitOccupation { units, process, pool, lattice_cells, patches, places, per_cell, seed })
    }

    /// Seed of the draws for this kind of defect.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }

    /// Returns the unit of a column: the kind of unit, the number of the column among its members, and the index of the first member, which
    /// names the unit.
    pub(crate) fn unit_of(&self, index: ColumnIndex) -> (usize, usize, ColumnIndex) {
        let (unit, number) = self.units.of_column[index.kind];
        let member = self.units.kinds[unit][number];
        let cell = plane::sub(index.cell, member.cell);
        (unit, number, ColumnIndex { kind: self.units.kinds[unit][0].kind, cell, ..index })
    }

    /// Returns the number among the unit's sites of the atom of chain `chain` of a column in cell `depth`, if it may be a defect.
    pub(crate) fn site(&self, column: usize, chain: usize, depth: usize) -> Option<usize> {
        let place = self.places[column][chain]?;
        let (unit, _) = self.units.of_column[column];
        Some(depth * self.per_cell[unit] + place)
    }

    /// Draws the contents of the unit named by `index`, from the bin nearest to its rate.
    pub(crate) fn draw(&self, kind: usize, index: ColumnIndex, rate: f64) -> Option<PatternIndex> {
        let allowed = vec![true; self.pool.sites(kind)];
        self.draw_among(kind, index, rate, rate, &allowed)
    }

    /// Draws the contents where only some sites may be defects; `around` is the rate in the surroundings.
    pub(crate) fn draw_among(
        &self,
        kind: usize,
        index: ColumnIndex,
        rate: f64,
        around: f64,
        allowed: &[bool],
    ) -> Option<PatternIndex> {
        let unit = UnitSeed { seed: self.seed, id: index.id() };
        let bins = bins(rate, around);
        // A bin whose numbers of defects reach as far as the unit needs is preferred to a bin with the right surroundings.
        let found = [2.0, 0.0].into_iter().find_map(|spread| {
            bins.iter().find_map(|&bin| {
                Some((bin, self.pool.draw(kind, bin, rate, allowed, spread, unit)?))
            })
        });
        found.map(|(bin, cell)| PatternIndex { bin, kind, cell })
    }

    /// Finds the place in the library of a unit that holds exactly these defects (ascending), if the pool has them.
    pub(crate) fn find(
        &self,
        kind: usize,
        index: ColumnIndex,
        rate: f64,
        around: f64,
        defects: &[u16],
    ) -> Option<PatternIndex> {
        let unit = UnitSeed { seed: self.seed, id: index.id() };
        bins(rate, around).into_iter().find_map(|bin| {
            Some(PatternIndex { bin, kind, cell: self.pool.find(kind, bin, defects, unit)? })
        })
    }

    /// Finds the place in the library of a unit with as many defects as `wanted`, most of them on `allowed` sites, if the pool has that
    /// number.
    pub(crate) fn nearest(
        &self,
        kind: usize,
        index: ColumnIndex,
        (rate, around): (f64, f64),
        (wanted, allowed): (&[u16], &[bool]),
    ) -> Option<PatternIndex> {
        let unit = UnitSeed { seed: self.seed, id: index.id() };
        bins(rate, around).into_iter().find_map(|bin| {
            let cell = self.pool.nearest(kind, bin, (wanted, allowed), unit)?;
            Some(PatternIndex { bin, kind, cell })
        })
    }

    /// Returns the contents of a site of a unit: the atom of chain `chain` of a column of kind `column` in cell `depth` along the beam,
    /// where `number` belongs.
    pub(crate) fn holds(
        &self,
        entry: PatternIndex,
        [column, chain, depth]: [usize; 3],
        number: u8,
    ) -> (SiteKind, u8) {
        self.held(self.pattern(entry), self.site(column, chain, depth), number)
    }

    /// Returns the contents of a site by its number among the sites of a unit with the defects `pattern`.
    pub(crate) fn held(&self, pattern: &[u16], site: Option<usize>, number: u8) -> (SiteKind, u8) {
        match (site, self.process) {
            (Some(site), Some(process)) if pattern.contains(&(site as u16)) => process.defect(),
            _ => (SiteKind::Pristine, number),
        }
    }

    /// Returns the defective sites of an entry, ascending.
    pub(crate) fn pattern(&self, entry: PatternIndex) -> &[u16] {
        &self.pool.patterns(entry.kind, entry.bin).cells[entry.cell]
    }
}

/// Lists the bins that may serve a unit of rate `rate` in surroundings of rate `around`, the best first.
fn bins(rate: f64, around: f64) -> Vec<usize> {
    let mut bins = [around, 0.5 * (around + rate), rate].map(patterns::bin_of).to_vec();
    bins.dedup();
    bins
}

/// Returns the number of library cells of a bin that together hold `patches` patches; each cell holds `units` units.
pub(crate) fn library_cells(patches: usize, units: usize, configurations: usize) -> usize {
    patches.div_ceil(units.max(1) * configurations)
}

/// Returns the number of patches of a bin, for the first kind of defect or a `further` one.
fn patches_per_bin(recipe: &Recipe, crystal: &ColumnCrystal, further: bool) -> usize {
    let depth = crystal.cells_along_beam(recipe.field.thickness_nm);
    let thin = crystal.columns.iter().all(|c| c.chains.len() * depth <= THIN_SITES);
    // Worlds with one kind of defect keep their existing libraries.
    let layer = thin && !recipe.defects.is_empty();
    if layer || further { FEW_PATCHES_PER_BIN } else { PATCHES_PER_BIN }
}

/// For a specimen without defects, returns the defects that the beam makes: vacancies of the one element that it displaces.
fn displaced_element(recipe: &Recipe) -> Result<Option<DefectKind>> {
    let Some(damage) = &recipe.damage else { return Ok(None) };
    let mut displaced = Vec::new();
    for (_, symbol) in damage.elements() {
        let element = elements::atomic_number(symbol)?;
        if damage.cross_section_angstrom2(symbol, element, recipe.optics.energy_kv) > 0.0 {
            displaced.push(element);
        }
    }
    displaced.dedup();
    Ok(match displaced[..] {
        [element] => Some(DefectKind { element, by: None }),
        _ => None,
    })
}

/// Returns the kinds of defects of a recipe, vacancies first: `[None]` where there are none. Empty where atoms are not on their lattice
/// sites, so that units cannot be drawn.
fn kinds(recipe: &Recipe) -> Result<Vec<Option<DefectKind>>> {
    // Atoms that move away from vacancies are not on their lattice sites.
    if recipe.vacancies.as_ref().is_some_and(|v| v.relaxation_angstrom > 0.0) {
        return Ok(Vec::new());
    }
    let number = elements::atomic_number;
    let mut found = Vec::new();
    if let Some(v) = recipe.vacancies.as_ref().filter(|v| v.rate > 0.0) {
        found.push(DefectKind { element: number(&v.element)?, by: None });
    }
    if let Some(s) = recipe.substitutions.as_ref().filter(|s| s.rate > 0.0) {
        found.push(DefectKind { element: number(&s.element)?, by: Some(number(&s.by)?) });
    }
    if let Some(a) = recipe.alloy.as_ref().filter(|a| a.rate > 0.0) {
        found.push(DefectKind { element: number(&a.host)?, by: Some(number(&a.guest)?) });
    }
    for defect in recipe.defects.iter().filter(|d| d.rate > 0.0) {
        let kind = DefectKind::of(defect)?;
        if !found.contains(&kind) {
            found.push(kind);
        }
    }
    if found.is_empty() {
        found.extend(displaced_element(recipe)?);
    }
    let found: Vec<_> = found.into_iter().map(Some).collect();
    Ok(if found.is_empty() { vec![None] } else { found })
}
