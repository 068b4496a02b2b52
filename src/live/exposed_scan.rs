//! What a scan does to a specimen: the dose that it leaves, and the atoms that are lost.

use std::collections::BTreeMap;

use crate::acquisition::{Exposure, ScanPath};
use crate::recipe::Region;
use crate::specimen::DoseMap;
use crate::structure::elements;
use crate::world::expose_frame;

/// Adds the electrons of a scan to a dose map, line by line. Returns the exposed area (nm of the full field).
pub(super) fn expose(dose: &mut DoseMap, path: &ScanPath, exposure: &Exposure) -> Region {
    let mut area = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for number in 0..path.frames() {
        let own = expose_frame(dose, path, exposure.electrons_per_pixel, number);
        for (all, own) in area.iter_mut().zip([own.x, own.y]) {
            *all = [all[0].min(own[0]), all[1].max(own[1])];
        }
    }
    Region { x: area[0], y: area[1] }
}

/// Number of lost atoms of each element.
pub(super) fn lost(before: &BTreeMap<u8, u64>, after: &BTreeMap<u8, u64>) -> BTreeMap<String, u64> {
    let gone = |(number, count): (&u8, &u64)| {
        let left = after.get(number).copied().unwrap_or_default();
        (*count > left).then(|| (elements::symbol(*number).to_owned(), count - left))
    };
    before.iter().filter_map(gone).collect()
}
