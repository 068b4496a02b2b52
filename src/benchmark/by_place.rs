//! Items with places, looked up by region.

use std::collections::HashMap;

use crate::recipe::Region;

/// Edge of the cells in which items are looked up, in nm.
const CELL_NM: f64 = 2.5;

/// Items with places, looked up by region.
#[derive(Debug, Clone)]
pub struct ByPlace<T> {
    cells: HashMap<[i64; 2], Vec<([f64; 2], T)>>,
}

impl<T: Clone> ByPlace<T> {
    /// Sorts items by their places (x, y) in nm.
    pub fn new(things: impl Iterator<Item = ([f64; 2], T)>) -> Self {
        let mut cells: HashMap<[i64; 2], Vec<([f64; 2], T)>> = HashMap::new();
        for (place, thing) in things {
            cells.entry(place.map(cell)).or_default().push((place, thing));
        }
        ByPlace { cells }
    }

    /// Returns the items in a region, cell by cell, within a cell in their original order.
    pub fn within(&self, region: &Region) -> Vec<([f64; 2], T)> {
        let range = |[low, high]: [f64; 2]| cell(low)..=cell(high);
        let cells = range(region.y).flat_map(|y| range(region.x).map(move |x| [x, y]));
        let all = cells.filter_map(|at| self.cells.get(&at)).flatten();
        all.filter(|(place, _)| region.contains(*place)).cloned().collect()
    }
}

fn cell(nm: f64) -> i64 {
    (nm / CELL_NM).floor() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_found_in_their_regions() {
        let places: Vec<[f64; 2]> = (0..900)
            .map(|n| [(n % 30) as f64 * 0.37 - 2.0, (n / 30) as f64 * 0.41 - 3.0])
            .collect();
        let by_place = ByPlace::new(places.iter().map(|p| (*p, ())));
        for region in [
            Region { x: [-2.0, 0.5], y: [-3.0, 7.0] },
            Region { x: [1.11, 1.12], y: [-0.1, 0.4] },
            Region { x: [-9.0, 99.0], y: [-9.0, 99.0] },
        ] {
            let expected = places.iter().filter(|p| region.contains(**p)).count();
            assert_eq!(by_place.within(&region).len(), expected);
        }
    }
}
