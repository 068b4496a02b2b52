//! A crystal in domains of two phases, such as cubic and tetragonal barium titanate.
//!
//! Both phases have the same sites. In the second phase they are moved a little within the cell, and the cell has another length along x.
//! An order parameter from 0 to 1, the cumulative normal distribution of the distance from a boundary, interpolates both changes: the
//! lattice stays coherent, without a step. Along y and the beam the second phase is strained to the period of the first.

use std::cell::LazyCell;
use std::collections::{BTreeSet, HashMap};

use crate::error::{Error, Result};
use crate::lengths;
use crate::plane;
use crate::recipe::CheckedRecipe;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::coherent::{Coherent, Stretch};
use crate::specimen::column_index::ColumnIndex;
use crate::specimen::defects::clusters::Clusters;
use crate::specimen::defects::rules::Defects;
use crate::specimen::defects::vacancies::DistanceHistogram;
use crate::specimen::sites::SpecimenSite;
use crate::specimen::specimen_trait::{
    Boundary, BoundaryKind, ParticleTruth, Specimen, SpecimenFacts, SpecimenLayout,
};
use crate::specimen::units::known_tags::KnownTags;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::occupation::UnitOccupation;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::specimen::units::unit_tag::UnitTag;
use crate::specimen::wave::{WavyLine, normal_cdf_and_integral, normal_cdf_or_zero};
use crate::structure::Structure;

/// Largest difference between sites of the two phases, as a fraction of the cell along each edge.
const LARGEST_SHIFT: f64 = 0.1;
/// Largest relative difference between the edges of the two cells.
const LARGEST_STRETCH: f64 = 0.1;

/// Rounding moves a position across an edge by less than this.
const EDGE_NM: f64 = 1e-6;

/// Steps of the order parameter for which there are library cells: between the steps atoms are less than 0.02 A off.
const ORDER_STEPS: f64 = 4.0;

/// A crystal in domains of two phases.
pub(crate) struct Domains {
    lattice: Coherent<OrderParameter>,
    /// Displacement of each site in the second phase, in nm.
    shifts: Vec<[f64; 3]>,
    /// Mean displacement of the sites of each kind of column.
    column_shifts: Vec<[f64; 2]>,
    clusters: Clusters,
    defects: Defects,
    /// The contents of units; with `None` each site is drawn separately.
    contents: Option<UnitOccupation>,
    facts: SpecimenFacts,
}

impl Domains {
    /// Matches the phases, draws the boundaries and fits the defects of the full field.
    ///
    /// # Errors
    /// [`Error::Invalid`] for phases that do not match, or a vacancy rate without room.
    pub(crate) fn new(recipe: &CheckedRecipe) -> Result<Self> {
        let Some(domains) = &recipe.domains else {
            return Err(Error::invalid(
                crate::Setting::Domains,
                "(missing)",
                "this structure needs the table",
            ));
        };
        let (first, second) = (recipe.structure()?, recipe.second_crystal()?);
        let shifts = shifts(first, second)?;
        let ratio = second.orthogonal_box()?[0] / first.orthogonal_box()?[0];
        let crystal = recipe.columns()?.clone();
        let mean = |k: usize, column: &crate::structure::columns::ColumnKind| {
            let sum: f64 = column.chains.iter().map(|c| shifts[c.site][k]).sum();
            sum / column.chains.len() as f64
        };
        let column_shifts: Vec<[f64; 2]> =
            crystal.columns.iter().map(|c| [mean(0, c), mean(1, c)]).collect();
        let largest = column_shifts.iter().flatten().fold(0.0, |l: f64, s| l.max(s.abs()));
        let order = OrderParameter::new(recipe, domains, ratio, largest);
        let mut specimen = Domains {
            lattice: Coherent::new(crystal, &recipe.field, order),
            shifts,
            column_shifts,
            clusters: Clusters::draw(recipe),
            defects: Defects::default(),
            contents: None,
            facts: SpecimenFacts::default(),
        };
        specimen.contents = UnitOccupation::new(recipe, &specimen.lattice.crystal)?;
        specimen.defects = Defects::fit(recipe, |element, histogram| {
            let lattice = &specimen.lattice;
            let holding = |kind: usize| {
                let chains = &lattice.crystal.columns[kind].chains;
                chains.iter().filter(|c| c.number == element).count() as u64
            };
            let add =
                |counts: &mut DistanceHistogram, index: ColumnIndex, ideal: [f64; 2], row: &Row| {
                    counts.add(specimen.distance(ideal, row), holding(index.kind));
                };
            let kinds = |kind: usize| holding(kind) > 0;
            // Near the edges of the field displacements decide whether a column lies in it.
            let surely = lattice.field.grown(-largest - EDGE_NM);
            let place = |index: ColumnIndex, at: [f64; 2], row: &Row| {
                let ideal = [lattice.stretch.to_field(at[0], row), at[1]];
                let inside = surely.contains(ideal);
                (if inside { ideal } else { specimen.place(index, at, row).0 }, ideal)
            };
            *histogram =
                lattice.tally(&lattice.field, kinds, place, add, DistanceHistogram::merged);
        })?;
        specimen.facts = SpecimenFacts {
            thickness_nm: specimen.lattice.thickness_nm(),
            phases: domains.phases.to_vec(),
            clusters_nm: specimen.clusters.centres_nm().to_vec(),
            ..SpecimenFacts::default()
        };
        Ok(specimen)
    }

    /// Returns the distance of a point of a row from the nearest place about which vacancies gather, in nm.
    fn distance(&self, position: [f64; 2], row: &Row) -> f64 {
        let boundary = || self.lattice.stretch.distance(position, row);
        self.clusters.distance_nm(position).unwrap_or_else(boundary)
    }

    /// Calls `f(column, position, (position before displacement, order parameter there), row)`.
    fn for_each_column(
        &self,
        region: &Region,
        f: impl FnMut(ColumnIndex, [f64; 2], ([f64; 2], f64), &Row),
    ) {
        let place = |index: ColumnIndex, at: [f64; 2], row: &Row| self.place(index, at, row);
        self.lattice.for_each_column(region, place, f);
    }

    /// Computes the position of a column from its place in the reference lattice and its row, with the position before displacement and the
    /// order parameter there.
    fn place(
        &self,
        index: ColumnIndex,
        reference: [f64; 2],
        row: &Row,
    ) -> ([f64; 2], ([f64; 2], f64)) {
        let ideal = [self.lattice.stretch.to_field(reference[0], row), reference[1]];
        let order = order(row, ideal[0]);
        let shift = self.column_shifts[index.kind];
        (plane::add(ideal, [shift[0], shift[1]].map(|s| order * s)), (ideal, order))
    }

    /// Returns the place in the library of a unit of a kind, by its first column.
    fn tag(&self, kind: usize, first: ColumnIndex, rows: &mut KnownRows) -> Option<UnitTag> {
        let contents = self.contents.as_ref()?;
        let members = &contents.units.kinds[kind];
        let place = |column: ColumnIndex| {
            let at = self.lattice.reference(column);
            self.place(column, at, rows.at(at[1])).0
        };
        let centre = self.lattice.centre(members, first, place);
        let element = contents.process.map_or(0, |p| p.element);
        let row = rows.at(centre[1]);
        let rate = self.defects.at(self.distance(centre, row)).rate(element);
        let entry = contents.draw(kind, first, rate)?;
        let structure = (order(row, centre[0]) * ORDER_STEPS).round() as usize;
        Some(UnitTag::unrotated((first, 0), centre, structure, entry))
    }

    /// Lists the columns of a region; without sites if `with_sites` is false.
    fn listed(&self, region: &Region, with_sites: bool) -> Sites {
        let mut out = Sites::default();
        let mut tags = KnownTags::default();
        let mut rows = KnownRows { stretch: &self.lattice.stretch, rows: HashMap::new() };
        self.for_each_column(region, |index, column, ([x, y], order), row| {
            let tag = self.contents.as_ref().and_then(|contents| {
                let (kind, member, first) = contents.unit_of(index);
                tags.get((first, member), || self.tag(kind, first, &mut rows))
            });
            // The rules are not needed where the units decide the contents.
            let defects = LazyCell::new(|| self.defects.at(self.distance([x, y], row)));
            let contents = self.contents.as_ref().zip(tag);
            let chains = &self.lattice.crystal.columns[index.kind].chains;
            let cells = 0..if with_sites { self.lattice.cells_along_beam } else { 0 };
            let sites =
                cells.flat_map(|cell| chains.iter().enumerate().map(move |(n, c)| (cell, n, c)));
            let sites = sites.map(|(cell, n, chain)| {
                let key = index.key(chain, cell);
                let (kind, number) = match &contents {
                    Some((c, tag)) => c.holds(tag.entry, [index.kind, n, cell], chain.number),
                    None => defects.of(key, chain.number),
                };
                let ideal = [x, y, self.lattice.height(cell, chain)];
                let shift = self.shifts[chain.site];
                let position_nm = [0, 1, 2].map(|k| ideal[k] + order * shift[k]);
                SpecimenSite { key, position_nm, number, kind }
            });
            out.push_column(index.id(), column, tag, sites);
        });
        out
    }
}

impl SpecimenLayout for Domains {
    fn facts(&self) -> &SpecimenFacts {
        &self.facts
    }

    fn boundaries(&self) -> Vec<Boundary> {
        let order = &self.lattice.stretch;
        let boundary = |(k, line): (usize, &WavyLine)| Boundary {
            line_nm: line.polyline(self.lattice.field.y),
            kind: BoundaryKind::Phase {
                sides: [k % 2, (k + 1) % 2],
                sharpness_sigma_nm: order.sigma,
            },
        };
        order.lines.iter().enumerate().map(boundary).collect()
    }

    fn phase_at(&self, position_nm: [f64; 2]) -> usize {
        let lines = &self.lattice.stretch.lines;
        lines.iter().filter(|line| line.is_left_of(position_nm)).count() % 2
    }

    fn library_cell(&self, family: UnitFamily) -> Option<LibraryCell> {
        let contents = self.contents.as_ref()?;
        let crystal = &self.lattice.crystal;
        let order = family.structure as f64 / ORDER_STEPS;
        let along = crystal.cell[0] / (1.0 - self.lattice.stretch.strain * order);
        let cell = [along, crystal.cell[1]];
        let place = |depth: usize, kind: usize, number: usize| {
            let chain = &crystal.columns[kind].chains[number];
            let xy = crystal.columns[kind].xy;
            let ideal = [
                xy[0] * cell[0],
                xy[1] * cell[1],
                lengths::angstrom_by_division(self.lattice.height(depth, chain)),
            ];
            let shift = self.shifts[chain.site];
            [0, 1, 2].map(|k| ideal[k] + lengths::angstrom_by_division(order * shift[k]))
        };
        let depth = self.lattice.cells_along_beam;
        Some(LibraryCell::lattice(contents, crystal, (cell, family.bin), depth, place))
    }

    fn particles_reaching(&self, _: &Region) -> Vec<ParticleTruth> {
        Vec::new()
    }
}

impl Specimen for Domains {
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

/// For each boundary, its x where it crosses a row, and the width of the transition along x, in nm.
type Row = Vec<[f64; 2]>;

/// Rows that were computed before: many units have the same y.
struct KnownRows<'a> {
    stretch: &'a OrderParameter,
    rows: HashMap<u64, Row>,
}

impl KnownRows<'_> {
    fn at(&mut self, y: f64) -> &Row {
        self.rows.entry(y.to_bits()).or_insert_with(|| self.stretch.row(y))
    }
}

/// The share of the second phase at a point, from 0 to 1.
struct OrderParameter {
    lines: Vec<WavyLine>,
    sigma: f64,
    /// 1 - (edge of the first cell) / (edge of the second cell), along x.
    strain: f64,
    spread: f64,
}

impl OrderParameter {
    fn new(
        recipe: &CheckedRecipe,
        domains: &crate::recipe::tables::DomainTable,
        ratio: f64,
        displacement: f64,
    ) -> Self {
        let field = recipe.field.full_region();
        let width = field.x[1] - field.x[0];
        let count = domains.boundaries;
        let amplitude = domains.waviness * width;
        let line = |k: usize| {
            let mean = field.x[0] + width * (k + 1) as f64 / (count + 1) as f64;
            WavyLine::new(mean, amplitude, &field, BEYOND_FIELD_NM, recipe.seed, k as u32)
        };
        let strain = 1.0 - 1.0 / ratio;
        OrderParameter {
            lines: (0..count).map(line).collect(),
            sigma: domains.sharpness_sigma_px * recipe.field.pixel_nm(),
            strain,
            spread: 2.0 * displacement + 2.0 * strain.abs() * amplitude * count as f64 + 0.1,
        }
    }

    /// Returns the distance of a point of a row from the nearest boundary in nm.
    fn distance(&self, position: [f64; 2], row: &Row) -> f64 {
        let across = |n: &usize| (position[0] - row[*n][0]).abs();
        let lines = 0..self.lines.len();
        // If the line that is probably nearest is measured first, the others can mostly be skipped.
        let Some(likely) = lines.clone().min_by(|a, b| across(a).total_cmp(&across(b))) else {
            return f64::INFINITY;
        };
        let nearer = |known, n: usize| self.lines[n].nearer(position, row[n][0], known);
        let known = nearer(f64::INFINITY, likely);
        lines.filter(|n| *n != likely).fold(known, nearer)
    }
}

/// Returns the order parameter at `x` of a row.
fn order(row: &Row, x: f64) -> f64 {
    let mut sum = 0.0;
    for (k, [middle, sigma]) in row.iter().enumerate() {
        sum += sign(k) * normal_cdf_or_zero((x - middle) / sigma);
    }
    sum.clamp(0.0, 1.0)
}

/// Returns the order parameter at `x` of a row, and its integral over x.
fn order_and_integral(row: &Row, x: f64) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (k, [middle, sigma]) in row.iter().enumerate() {
        let [value, integral] = normal_cdf_and_integral((x - middle) / sigma);
        sums[0] += sign(k) * value;
        sums[1] += sign(k) * (sigma * integral);
    }
    [sums[0].clamp(0.0, 1.0), sums[1]]
}

/// Sign of a boundary's step: every second boundary leads back to the first phase.
fn sign(boundary: usize) -> f64 {
    if boundary.is_multiple_of(2) { 1.0 } else { -1.0 }
}

impl Stretch for OrderParameter {
    type Row = Row;

    fn row(&self, y: f64) -> Row {
        let crossing = |line: &WavyLine| {
            let [x, cosine] = line.x_and_cosine(y);
            [x, self.sigma / cosine]
        };
        self.lines.iter().map(crossing).collect()
    }

    fn to_reference(&self, x: f64, row: &Row) -> f64 {
        x - self.strain * order_and_integral(row, x)[1]
    }

    fn to_field(&self, reference: f64, row: &Row) -> f64 {
        // Newton's method on a function whose slope differs from 1 by a few per cent.
        let mut x = reference;
        for _ in 0..20 {
            let [order, integral] = order_and_integral(row, x);
            let step = (reference - x + self.strain * integral) / (1.0 - self.strain * order);
            x += step;
            if step.abs() < 1e-12 {
                break;
            }
        }
        x
    }

    fn spread(&self) -> f64 {
        self.spread
    }
}

/// The rule that is broken if the sites of the second phase do not match.
const SAME_SITES: &str = "both crystals of `domains` need the same elements at the same sites";

/// Computes the distance of each site of the first phase from its counterpart in the second, in nm; lengths along x belong to the second
/// cell, other lengths to the first.
fn shifts(first: &Structure, second: &Structure) -> Result<Vec<[f64; 3]>> {
    let (a, b) = (first.orthogonal_box()?, second.orthogonal_box()?);
    let fault = |value: String, expected: &str| {
        Err(Error::invalid(crate::Setting::DomainCrystal, value, expected))
    };
    if first.atoms.len() != second.atoms.len() {
        let value = format!("{} sites in the cell along its zone axis", second.atoms.len());
        let expected = format!(
            "{SAME_SITES}; the cell of the first has {} sites; choose zone_axis and y_axis of both so that the cells match",
            first.atoms.len()
        );
        return fault(value, &expected);
    }
    let elements = |structure: &Structure| {
        let numbers: BTreeSet<u8> = structure.atoms.iter().map(|atom| atom.number).collect();
        numbers.into_iter().map(crate::structure::elements::symbol).collect::<Vec<_>>().join(", ")
    };
    let (own, other) = (elements(first), elements(second));
    if own != other {
        return fault(other, &format!("{SAME_SITES}; the first holds {own}"));
    }
    if let Some(k) = (0..3).find(|&k| (b[k] / a[k] - 1.0).abs() > LARGEST_STRETCH) {
        let axis = ["x", "y", "the beam"][k];
        let value = format!("{:.4} A along {axis}", b[k]);
        let expected = format!(
            "both crystals of `domains` need cells of nearly the same edges, within 10 %: the first has {:.4} A",
            a[k]
        );
        return fault(value, &expected);
    }
    let mut taken = vec![false; second.atoms.len()];
    let mut out = Vec::with_capacity(first.atoms.len());
    for atom in &first.atoms {
        let shift = |other: &crate::structure::Atom| {
            [0, 1, 2].map(|k| {
                let d = other.position[k] / b[k] - atom.position[k] / a[k];
                d - d.round()
            })
        };
        let near = |s: &[f64; 3]| s.iter().all(|d| d.abs() < LARGEST_SHIFT);
        let found =
            second.atoms.iter().enumerate().find(|(n, other)| {
                other.number == atom.number && !taken[*n] && near(&shift(other))
            });
        let Some((n, other)) = found else {
            let symbol = crate::structure::elements::symbol(atom.number);
            let value = format!("no {symbol} near {:.3?} A", atom.position);
            let expected = format!(
                "{SAME_SITES}, each within a tenth of the cell of its counterpart; check zone_axis and y_axis of both, and the origins of \
                 the files"
            );
            return fault(value, &expected);
        };
        taken[n] = true;
        let s = shift(other);
        out.push(lengths::nm([s[0] * b[0], s[1] * a[1], s[2] * a[2]]));
    }
    Ok(out)
}
