//! Atomic columns: the specimen in projection along the beam.

use super::sites::SpecimenSite;
use super::units::unit_tag::UnitTag;

/// A projected atomic column and its sites.
#[derive(Debug, Clone, PartialEq)]
pub struct AtomColumn {
    /// Number that is unique in the specimen.
    pub id: u64,
    /// Position (x, y) in nm: the mean of its sites, before relaxation.
    pub position_nm: [f64; 2],
    /// Its sites in [`Sites::sites`], by ascending z.
    pub sites: std::ops::Range<usize>,
    /// The column's place in the library of the mosaic; `None` for a column that does not repeat.
    pub unit: Option<UnitTag>,
}

/// All columns of a region, and their sites.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sites {
    /// Columns whose position lies in the region.
    pub columns: Vec<AtomColumn>,
    /// Sites of all columns.
    pub sites: Vec<SpecimenSite>,
}

impl Sites {
    /// Returns the columns without their sites.
    pub(super) fn into_columns(self) -> Vec<AtomColumn> {
        let mut columns = self.columns;
        columns.iter_mut().for_each(|column| column.sites = 0..0);
        columns
    }

    /// Adds a column and its sites.
    pub(crate) fn push_column(
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
