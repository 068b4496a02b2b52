//! The columns of a specimen whose sites are all held in memory.

use rayon::prelude::*;

use super::beam_rows::beam_rows;
use super::column_grid::ColumnGrid;
use super::sites::SpecimenSite;
use crate::plane;
use crate::recipe::region::Region;

/// A site in the field, and its phase.
pub type PlacedSite = (SpecimenSite, u16);

/// Sites in columns, which are found by place.
pub(super) struct HeldColumns {
    /// All sites, column after column, each column by ascending z.
    sites: Vec<SpecimenSite>,
    /// Mean (x, y) of each column in nm, in the order of the grid.
    positions_nm: Vec<[f64; 2]>,
    /// Index of the first site of each column, and the number of sites.
    starts: Vec<u32>,
    grid: ColumnGrid,
    extent: Region,
}

impl HeldColumns {
    /// Finds the columns of sites that are sorted by depth, and keeps the columns within `extent`; also returns the phase of each column.
    pub(super) fn new(sites: &[PlacedSite], extent: Region) -> (Self, Vec<u16>) {
        let places: Vec<[f64; 3]> = sites.iter().map(|(site, _)| site.position_nm).collect();
        let rows = beam_rows(&places);
        let count = rows.iter().max().map_or(0, |last| *last as usize + 1);
        let (members, starts) = by_row(&rows, count);
        let of_row = |row: usize| &members[starts[row] as usize..starts[row + 1] as usize];
        let xy = |n: u32| {
            let [x, y, _] = places[n as usize];
            [x, y]
        };
        let mean = |row: usize| {
            let sum = of_row(row).iter().fold([0.0; 2], |sum, n| plane::add(sum, xy(*n)));
            sum.map(|s| s / of_row(row).len() as f64)
        };
        let means: Vec<[f64; 2]> = (0..count).into_par_iter().map(mean).collect();
        let kept: Vec<usize> = (0..count).filter(|row| extent.contains(means[*row])).collect();
        let positions: Vec<[f64; 2]> = kept.iter().map(|row| means[*row]).collect();
        let (grid, order) = ColumnGrid::new(&extent, &positions);
        let mut held = HeldColumns {
            sites: Vec::with_capacity(sites.len()),
            positions_nm: order.iter().map(|n| positions[*n as usize]).collect(),
            starts: vec![0],
            grid,
            extent,
        };
        let mut phases = Vec::with_capacity(order.len());
        for column in order {
            let row = of_row(kept[column as usize]);
            held.sites.extend(row.iter().map(|n| sites[*n as usize].0));
            held.starts.push(held.sites.len() as u32);
            phases.push(most_frequent(row.iter().map(|n| sites[*n as usize].1)));
        }
        (held, phases)
    }

    /// Number of columns.
    pub(super) fn len(&self) -> usize {
        self.positions_nm.len()
    }

    /// The columns (x, y in nm) whose position lies in a region.
    pub(super) fn inside<'a>(&'a self, region: &'a Region) -> impl Iterator<Item = usize> + 'a {
        let part = region.intersection(&self.extent);
        let some = part.x[0] < part.x[1] && part.y[0] < part.y[1];
        let ranges = some.then(|| self.grid.about(part)).into_iter().flatten();
        ranges.flatten().filter(|column| region.contains(self.positions_nm[*column]))
    }

    /// The column nearest to a place in nm.
    pub(super) fn nearest(&self, position_nm: [f64; 2]) -> Option<usize> {
        self.grid.nearest(&self.positions_nm, position_nm)
    }

    /// Position (x, y) of a column in nm: the mean of its sites.
    pub(super) fn position_nm(&self, column: usize) -> [f64; 2] {
        self.positions_nm[column]
    }

    /// The sites of a column, by ascending z.
    pub(super) fn sites(&self, column: usize) -> &[SpecimenSite] {
        &self.sites[self.starts[column] as usize..self.starts[column + 1] as usize]
    }

    /// A number of a column that is unique in the specimen.
    pub(super) fn id(&self, column: usize) -> u64 {
        self.sites[self.starts[column] as usize].key
    }

    /// For each cell of a grid over the specimen that holds columns: its centre (x, y) in nm, and its number of sites.
    pub(super) fn site_counts(&self) -> Vec<([f64; 2], u64)> {
        let sites = |columns: std::ops::Range<usize>| {
            u64::from(self.starts[columns.end] - self.starts[columns.start])
        };
        self.grid.filled().map(|(columns, centre)| (centre, sites(columns))).collect()
    }
}

/// Returns the atoms of each row, one row after the other, and the index of the first atom of each row.
fn by_row(rows: &[u32], count: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; count + 1];
    rows.iter().for_each(|row| starts[*row as usize + 1] += 1);
    for n in 1..=count {
        starts[n] += starts[n - 1];
    }
    let mut next = starts.clone();
    let mut members = vec![0u32; rows.len()];
    for (atom, row) in rows.iter().enumerate() {
        let place = &mut next[*row as usize];
        members[*place as usize] = atom as u32;
        *place += 1;
    }
    (members, starts)
}

/// Returns the most frequent number; among equally frequent ones the least.
fn most_frequent(numbers: impl Iterator<Item = u16>) -> u16 {
    let mut sorted: Vec<u16> = numbers.collect();
    sorted.sort_unstable();
    let runs = sorted.chunk_by(|a, b| a == b);
    runs.max_by_key(|run| (run.len(), std::cmp::Reverse(run[0]))).map_or(0, |run| run[0])
}
