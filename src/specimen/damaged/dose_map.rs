//! A map of the dose at every place of a field.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::recipe::region::Region;

/// Edge of the cells in which electrons are counted, in nm: a quarter of the distance of columns, or less.
const CELL_NM: f64 = 0.05;
/// Cells along an edge of a block; blocks without electrons take no memory.
const BLOCK_CELLS: i64 = 64;

/// The dose in cells of 0.05 nm.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DoseMap {
    /// Doses in electrons per square Angstrom by block (x, y): the cells of a block, row by row.
    #[serde(with = "as_list")]
    blocks: BTreeMap<[i64; 2], Vec<f64>>,
}

impl DoseMap {
    /// Spreads `electrons` evenly over a region. Cells at its edges get the share that lies inside.
    pub fn add(&mut self, region: &Region, electrons: f64) {
        let size = [region.x[1] - region.x[0], region.y[1] - region.y[0]];
        if !(electrons > 0.0 && size[0] > 0.0 && size[1] > 0.0) {
            return;
        }
        // Dose of a cell that lies in the region completely, in electrons per square Angstrom.
        let dose = electrons / (100.0 * size[0] * size[1]);
        let shares = [region.x, region.y].map(shares);
        for &(row, down) in &shares[1] {
            for &(column, across) in &shares[0] {
                let (block, cell) = place([column, row]);
                let cells = self.blocks.entry(block);
                let cells =
                    cells.or_insert_with(|| vec![0.0; (BLOCK_CELLS * BLOCK_CELLS) as usize]);
                cells[cell] += dose * down * across;
            }
        }
    }

    /// Adds the doses of another map.
    pub(crate) fn add_all(&mut self, other: &DoseMap) {
        for (block, more) in &other.blocks {
            let cells = self.blocks.entry(*block).or_insert_with(|| vec![0.0; more.len()]);
            cells.iter_mut().zip(more).for_each(|(dose, more)| *dose += more);
        }
    }

    /// Returns the greatest sum of both doses at the places where the other map has electrons.
    pub(crate) fn greatest_with(&self, other: &DoseMap) -> f64 {
        let sum = |(block, more): (&[i64; 2], &Vec<f64>)| {
            let before = self.blocks.get(block);
            let dose = |(cell, more): (usize, &f64)| before.map_or(0.0, |cells| cells[cell]) + more;
            let exposed = more.iter().enumerate().filter(|(_, more)| **more > 0.0);
            exposed.map(dose).fold(0.0, f64::max)
        };
        other.blocks.iter().map(sum).fold(0.0, f64::max)
    }

    /// Returns the dose at (x, y) in nm, in electrons per square Angstrom.
    pub fn at(&self, position_nm: [f64; 2]) -> f64 {
        let (block, cell) = place(position_nm.map(|v| (v / CELL_NM).floor() as i64));
        self.blocks.get(&block).map_or(0.0, |cells| cells[cell])
    }

    /// Returns the mean dose of a region, in electrons per square Angstrom.
    pub(crate) fn mean(&self, region: &Region) -> f64 {
        let [across, down] = [region.x, region.y].map(shares);
        let (mut sum, mut area) = (0.0, 0.0);
        for (row, height) in &down {
            for (column, width) in &across {
                let (block, cell) = place([*column, *row]);
                let dose = self.blocks.get(&block).map_or(0.0, |cells| cells[cell]);
                sum += dose * height * width;
                area += height * width;
            }
        }
        if area > 0.0 { sum / area } else { 0.0 }
    }

    /// Returns the mean dose without the outermost cells of the region, some of which reach beyond the exposed area. For a region that is
    /// too small for that, returns [`DoseMap::mean`].
    pub(crate) fn mean_within(&self, region: &Region) -> f64 {
        let inner = region.grown(-CELL_NM);
        let large = [inner.x, inner.y].iter().all(|[low, high]| high - low > CELL_NM);
        self.mean(if large { &inner } else { region })
    }

    /// Returns the greatest dose, in electrons per square Angstrom.
    pub fn greatest(&self) -> f64 {
        self.blocks.values().flatten().copied().fold(0.0, f64::max)
    }

    /// Returns the number of electrons on the whole field.
    pub(crate) fn electrons(&self) -> f64 {
        self.blocks.values().flatten().sum::<f64>() * 100.0 * CELL_NM * CELL_NM
    }

    /// Whether the blocks have the right size and hold finite doses that are not negative: a map may come from a file.
    pub(crate) fn is_sound(&self) -> bool {
        let cells = (BLOCK_CELLS * BLOCK_CELLS) as usize;
        let sound = |block: &Vec<f64>| {
            block.len() == cells && block.iter().all(|dose| dose.is_finite() && *dose >= 0.0)
        };
        self.blocks.values().all(sound)
    }
}

/// Returns the cells that a range in nm covers, and the covered share of each.
fn shares([low, high]: [f64; 2]) -> Vec<(i64, f64)> {
    let [low, high] = [low, high].map(|v| v / CELL_NM);
    let cells = low.floor() as i64..high.ceil() as i64;
    let share = |n: i64| (n, (high.min(n as f64 + 1.0) - low.max(n as f64)).max(0.0));
    cells.map(share).filter(|(_, share)| *share > 0.0).collect()
}

/// Returns the block of a cell (x, y), and the place of the cell in it.
fn place(cell: [i64; 2]) -> ([i64; 2], usize) {
    let [x, y] = cell.map(|c| c.rem_euclid(BLOCK_CELLS));
    (cell.map(|c| c.div_euclid(BLOCK_CELLS)), (y * BLOCK_CELLS + x) as usize)
}

/// Serialises maps with keys that are not text as lists.
mod as_list {
    use super::BTreeMap;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(
        map: &BTreeMap<[i64; 2], Vec<f64>>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        map.iter().collect::<Vec<_>>().serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<BTreeMap<[i64; 2], Vec<f64>>, D::Error> {
        Ok(Vec::<([i64; 2], Vec<f64>)>::deserialize(from)?.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn electrons_are_kept_and_lie_where_they_fell() {
        let mut map = DoseMap::default();
        // 1 nm^2 with 1000 electrons per square Angstrom, off the raster and across the corner of four blocks.
        map.add(&Region { x: [-0.512, 0.488], y: [-0.333, 0.667] }, 1e5);
        map.add(&Region { x: [-0.512, 0.488], y: [-0.333, 0.667] }, 1e5);
        assert!((map.electrons() - 2e5).abs() < 1e-6);
        assert!(
            (map.at([0.1, 0.1]) - 2e3).abs() < 1e-9 && (map.at([-0.4, -0.2]) - 2e3).abs() < 1e-9
        );
        assert_eq!(map.at([0.6, 0.1]), 0.0);
        let mean = map.mean(&Region { x: [0.3, 0.5], y: [0.1, 0.2] });
        assert!((mean - 0.94 * 2e3).abs() < 1e-6, "{mean}");
        let mut other = DoseMap::default();
        other.add(&Region { x: [0.4, 9.0], y: [0.0, 0.1] }, 100.0 * 0.86 * 500.0);
        assert!((map.greatest_with(&other) - 2.5e3).abs() < 1e-9);
        other.add_all(&map);
        assert!((other.greatest() - 2.5e3).abs() < 1e-9);
        assert!((other.electrons() - 2.43e5).abs() < 1e-6);
        assert!((map.greatest() - 2e3).abs() < 1e-9);
        // The cell from -0.55 to -0.5 nm is exposed on 0.012 of its 0.05 nm.
        assert!((map.at([-0.52, 0.1]) - 2e3 * 0.24).abs() < 1e-6, "{}", map.at([-0.52, 0.1]));
    }

    #[test]
    fn maps_are_written_and_read() {
        let mut map = DoseMap::default();
        map.add(&Region { x: [3.0, 3.4], y: [-1.0, 2.0] }, 77.7);
        let text = serde_json::to_string(&map).unwrap();
        let read: DoseMap = serde_json::from_str(&text).unwrap();
        assert!(read == map && read.is_sound());
        let short: DoseMap = serde_json::from_str(r#"{"blocks": [[[0, 0], [1.0]]]}"#).unwrap();
        assert!(!short.is_sound());
    }
}
