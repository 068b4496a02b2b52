//! The repeating pattern of a coincidence boundary, for the mosaic's library.
//!
//! Along a coincidence boundary the columns repeat with the coincidence period. The columns near the plane over one period are the slots of
//! the motif; columns farther away belong to the crystal. A boundary whose pattern equals the pattern of an earlier one, perhaps mirrored,
//! shares its motif.

use std::collections::HashMap;

use crate::specimen::units::library_cell::{LibraryCell, LibrarySite, LibraryUnit};
use crate::specimen::units::occupation::{DefectKind, LIBRARY_CELL_ANGSTROM, library_cells};
use crate::specimen::units::patterns;
use crate::specimen::units::patterns::{DefectPatterns, UnitSeed, bin_of};
use crate::specimen::units::unit_tag::PatternIndex;
use crate::structure::columns::{Chain, ColumnCrystal};

/// Columns nearer to the plane than this are slots, in Angstrom. For columns beyond it, the other grain is farther away than a probe in a
/// crystal reaches.
pub(crate) const SLOT_REACH_ANGSTROM: f64 = 5.0;
/// Width in Angstrom that is scanned beyond the slots, for the ramps to the crystal's units and for interpolation between samples
/// ([`crate::resample::MARGIN`]).
const SCAN_BEYOND_ANGSTROM: f64 = 2.5;
/// Width in Angstrom of the specimen beyond the scan: half a window, and the reach of potentials.
const SPECIMEN_BEYOND_ANGSTROM: f64 = 7.5;
/// Least number of different contents of a slot.
const LEAST_CONTENTS: usize = 4;
/// Positions closer than this count as equal, in Angstrom.
const SAME: f64 = 0.01;

/// A column of a boundary, relative to a lattice point on its plane.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BoundaryColumn {
    /// Position (x, y) in Angstrom; the plane is x = 0.
    pub position: [f64; 2],
    /// The chains of the column that are kept: number in the kind of column, and the chain.
    pub chains: Vec<(usize, Chain)>,
}

/// The repeating pattern of a coincidence boundary.
#[derive(Debug)]
pub(crate) struct BoundaryMotif {
    /// Period along y in Angstrom.
    pub period: f64,
    slots: Vec<BoundaryColumn>,
    lookup: HashMap<[i64; 2], usize>,
    others: Vec<BoundaryColumn>,
    /// Patterns of defects of the slots.
    pub pool: DefectPatterns,
    periods: usize,
    process: Option<DefectKind>,
    seed: u64,
}

/// Distance in Angstrom to which a motif needs the columns around a boundary.
pub(crate) fn reach_angstrom() -> f64 {
    SLOT_REACH_ANGSTROM + SCAN_BEYOND_ANGSTROM + SPECIMEN_BEYOND_ANGSTROM
}

impl BoundaryMotif {
    /// Makes the motif of a boundary from its `columns` over one period, out to [`reach_angstrom`].
    pub(crate) fn new(
        columns: Vec<BoundaryColumn>,
        period: f64,
        depth: usize,
        process: Option<DefectKind>,
        [patches, configurations]: [usize; 2],
        (seed, library_seed, stream): (u64, u64, u64),
    ) -> Self {
        let near = |c: &BoundaryColumn| c.position[0].abs() <= SLOT_REACH_ANGSTROM;
        let (slots, others): (Vec<_>, Vec<_>) = columns.into_iter().partition(near);
        let periods = (LIBRARY_CELL_ANGSTROM / period).ceil().max(1.0) as usize;
        let defects = |c: &BoundaryColumn| {
            c.chains.iter().filter(|(_, n)| process.is_some_and(|p| p.element == n.number)).count()
        };
        let sites = slots.iter().map(|s| depth * defects(s)).collect();
        // Each slot has several contents, even where the period is long.
        let least = LEAST_CONTENTS.div_ceil(periods);
        let count = library_cells(patches, slots.len() * periods, configurations).max(least);
        let lookup = slots.iter().enumerate().map(|(n, s)| (rounded(s.position), n)).collect();
        let pool = DefectPatterns::new(sites, [count, periods], (library_seed, 1 + stream));
        BoundaryMotif { period, slots, lookup, others, pool, periods, process, seed }
    }

    /// Finds the slot at `position` (relative to a lattice point on the plane), if the column there has these chains.
    pub(crate) fn slot(
        &self,
        [x, y]: [f64; 2],
        chains: impl Iterator<Item = usize>,
    ) -> Option<usize> {
        let y = y.rem_euclid(self.period);
        // Rounding may lead to the next bin, and across the end of the period.
        let near = (0..27).map(|n| (n % 3 - 1, n / 3 % 3 - 1, f64::from(n as i32 / 9 - 1)));
        let found = near.into_iter().find_map(|(i, j, turn)| {
            let [a, b] = rounded([x, y + turn * self.period]);
            self.lookup.get(&[a + i, b + j]).copied()
        })?;
        let slot = &self.slots[found];
        let dy = (slot.position[1] - y).rem_euclid(self.period);
        let same = (slot.position[0] - x).abs() < SAME && dy.min(self.period - dy) < SAME;
        (same && chains.eq(slot.chains.iter().map(|(n, _)| *n))).then_some(found)
    }

    /// Number of slots.
    pub(crate) fn slot_count(&self) -> usize {
        self.slots.len()
    }

    /// Draws the contents of the column `id` in `slot`; `around` is the rate at the plane.
    pub(crate) fn draw(
        &self,
        slot: usize,
        id: u64,
        rate: f64,
        around: f64,
    ) -> Option<PatternIndex> {
        let bin = bin_of(around);
        let allowed = vec![true; self.pool.sites(slot)];
        let unit = UnitSeed { seed: self.seed, id };
        let cell = self.pool.draw(slot, bin, rate, &allowed, 0.0, unit)?;
        Some(PatternIndex { bin, kind: slot, cell })
    }

    /// Returns the number of an atom among the slot's sites, if it may be a defect. The atom belongs to chain `chain`, counted among the
    /// chains that are kept.
    pub(crate) fn site(&self, slot: usize, chain: usize, depth: usize) -> Option<usize> {
        site(&self.slots[slot], self.process, chain, depth)
    }

    /// Builds the library cells of the motif.
    pub(crate) fn library_cell(
        &self,
        crystal: &ColumnCrystal,
        depth: usize,
        bin: usize,
    ) -> LibraryCell {
        let count = self.pool.cells() / self.periods;
        let centre_x = reach_angstrom();
        let column = |c: &BoundaryColumn, period: usize| -> Vec<LibrarySite> {
            let [x, y] = c.position;
            let at = [centre_x + x, y + period as f64 * self.period];
            let chains = c.chains.iter().enumerate();
            let sites = (0..depth).flat_map(|d| chains.clone().map(move |(n, (_, c))| (d, n, c)));
            let place = |(d, n, chain): (usize, usize, &Chain)| LibrarySite {
                position: [at[0], at[1], (d as f64 + chain.z) * crystal.cell[2]],
                number: chain.number,
                defect: site(c, self.process, n, d),
            };
            sites.map(place).collect()
        };
        let unit = |period: usize, kind: usize| LibraryUnit {
            kind,
            cell: period,
            centre: [
                centre_x + self.slots[kind].position[0],
                self.slots[kind].position[1] + period as f64 * self.period,
            ],
            members: vec![column(&self.slots[kind], period)],
            patterns: (0..count)
                .map(|n| self.pool.patterns(kind, bin).cells[n * self.periods + period].clone())
                .collect(),
        };
        let all = |period: usize| (0..self.slots.len()).map(move |kind| (period, kind));
        let half = SLOT_REACH_ANGSTROM + SCAN_BEYOND_ANGSTROM;
        let length = self.periods as f64 * self.period;
        LibraryCell {
            box_angstrom: [2.0 * centre_x, length, depth as f64 * crystal.cell[2]],
            scanned: [2.0 * half, length],
            scan_origin: [centre_x - half, 0.0],
            cell: [half, self.period],
            periodic: [false, true],
            cells: self.periods,
            count,
            process: self.process,
            rate: patterns::rate_of(bin),
            seed: self.pool.seed(),
            units: (0..self.periods).flat_map(all).map(|(p, k)| unit(p, k)).collect(),
            surroundings: (0..self.periods)
                .flat_map(|p| self.others.iter().map(move |c| (c, p)))
                .map(|(c, p)| column(c, p))
                .collect(),
        }
    }
}

fn site(
    column: &BoundaryColumn,
    process: Option<DefectKind>,
    chain: usize,
    depth: usize,
) -> Option<usize> {
    let concerned = |c: &(usize, Chain)| process.is_some_and(|p| p.element == c.1.number);
    let before = column.chains[..chain].iter().filter(|c| concerned(c)).count();
    let all = column.chains.iter().filter(|c| concerned(c)).count();
    concerned(&column.chains[chain]).then_some(depth * all + before)
}

fn rounded(position: [f64; 2]) -> [i64; 2] {
    position.map(|v| (v / SAME).round() as i64)
}
