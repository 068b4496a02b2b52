//! Identifiers of columns and atoms: numbers that are unique in a specimen.

use crate::recipe::limits::{MOST_CELLS_ACROSS, MOST_CELLS_ALONG_BEAM};
use crate::structure::columns::{Chain, MOST_SITES};

/// Bits for the cell along each axis across the beam, counted from -[`MOST_CELLS_ACROSS`].
const CELL_BITS: u32 = MOST_CELLS_ACROSS.ilog2() + 1;
/// Bits for the cell along the beam.
const DEPTH_BITS: u32 = MOST_CELLS_ALONG_BEAM.next_power_of_two().ilog2();
/// Bits for the site of a cell.
const SITE_BITS: u32 = MOST_SITES.ilog2();

/// Address of a column in a specimen: grain, kind of column, and unit cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnIndex {
    /// Number of the grain, from the left.
    pub grain: usize,
    /// Index into [`columns`](crate::structure::columns::ColumnCrystal::columns).
    pub kind: usize,
    /// Cell (i, j) of the grain's lattice.
    pub cell: [i64; 2],
}

impl ColumnIndex {
    /// Returns a number that is unique in the specimen.
    pub fn id(self) -> u64 {
        self.pack(self.kind)
    }

    /// Returns the key of the atom of `chain` in cell `depth` along the beam; it is unique in the specimen.
    pub fn key(self, chain: &Chain, depth: usize) -> u64 {
        self.pack(chain.site) << DEPTH_BITS | depth as u64
    }

    fn pack(self, number: usize) -> u64 {
        let cell = |n: i64| (n + MOST_CELLS_ACROSS) as u64 & ((1 << CELL_BITS) - 1);
        let [i, j] = self.cell;
        let front = (self.grain as u64) << SITE_BITS | number as u64;
        front << (2 * CELL_BITS) | cell(i) << CELL_BITS | cell(j)
    }
}
