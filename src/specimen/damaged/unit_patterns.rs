//! The patterns of a family's units, sorted by their number of defects.

use std::collections::BTreeMap;

use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::occupation::DefectKind;

/// A site of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnitSite {
    /// Atomic number of the atom that belongs there.
    pub number: u8,
    /// Number of the site among the sites that may be defects.
    pub defect: Option<u16>,
}

/// A kind of unit in the library cells of one family.
#[derive(Debug, Default)]
pub struct KindPatterns {
    /// Sites of all members, one member after the other, as the specimen lists them.
    pub sites: Vec<UnitSite>,
    /// Index of the first site of each member.
    pub members: Vec<usize>,
    /// Defective sites (ascending) of each lattice cell, by the number of the cell among the cells of all library cells.
    pub cells: BTreeMap<usize, Vec<u16>>,
    /// Cells by their number of defects.
    pub by_count: BTreeMap<usize, Vec<usize>>,
}

/// The patterns that the units of a family may hold.
#[derive(Debug)]
pub struct UnitPatterns {
    /// The kind of defect.
    pub process: Option<DefectKind>,
    kinds: BTreeMap<usize, KindPatterns>,
}

impl UnitPatterns {
    /// Collects the patterns in the library cells of a family.
    pub fn of(library_cell: &LibraryCell) -> Self {
        let mut kinds = BTreeMap::<usize, KindPatterns>::new();
        for unit in &library_cell.units {
            let kind = kinds.entry(unit.kind).or_default();
            if kind.sites.is_empty() {
                for member in &unit.members {
                    kind.members.push(kind.sites.len());
                    let site = |s: &crate::specimen::units::library_cell::LibrarySite| UnitSite {
                        number: s.number,
                        defect: s.defect.map(|d| d as u16),
                    };
                    kind.sites.extend(member.iter().map(site));
                }
            }
            for (number, pattern) in unit.patterns.iter().enumerate() {
                let cell = number * library_cell.cells + unit.cell;
                kind.by_count.entry(pattern.len()).or_default().push(cell);
                kind.cells.insert(cell, pattern.clone());
            }
        }
        UnitPatterns { process: library_cell.process, kinds }
    }

    /// Returns the patterns of a kind of unit.
    pub fn kind(&self, kind: usize) -> Option<&KindPatterns> {
        self.kinds.get(&kind)
    }
}

impl KindPatterns {
    /// Finds, among the cells with as many defects as `wanted` (ascending), the cell that shares most defects with it; `pick` (0 to 1)
    /// chooses among equals. `None` where no cell has that number.
    pub fn nearest(&self, wanted: &[u16], pick: f64) -> Option<usize> {
        let cells = self.by_count.get(&wanted.len())?;
        let common = |cell: &usize| {
            self.cells[cell].iter().filter(|site| wanted.binary_search(site).is_ok()).count()
        };
        let most = cells.iter().map(common).max()?;
        let best: Vec<usize> = cells.iter().copied().filter(|cell| common(cell) == most).collect();
        best.get((pick * best.len() as f64) as usize).copied()
    }
}
