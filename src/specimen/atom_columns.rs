//! Atomic columns: what one sees of a specimen along the beam.

use super::sites::SpecimenSite;
use super::units::unit_tag::UnitTag;

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

/// The columns of a region, complete, and their sites.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sites {
    /// Columns whose position lies in the region.
    pub columns: Vec<AtomColumn>,
    /// Sites of all of them.
    pub sites: Vec<SpecimenSite>,
}

impl Sites {
    /// The columns, none with its sites.
    pub(super) fn into_columns(self) -> Vec<AtomColumn> {
        let mut columns = self.columns;
        columns.iter_mut().for_each(|column| column.sites = 0..0);
        columns
    }

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
