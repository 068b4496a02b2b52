//! Pixels that the library cannot show, gathered into blocks for direct simulation.

use std::collections::{BTreeMap, HashMap};

use crate::imaging::pixels::PixelRect;

/// Edge in pixels of the blocks in which pixels for direct simulation are gathered.
pub(crate) const BLOCK_PX: usize = 48;
/// Edge of these blocks in Angstrom where pixels are coarse: a probe takes equally long for coarse and fine pixels.
pub(crate) const BLOCK_ANGSTROM: f64 = 8.0;
/// Pixels (indices in the rectangle of `shape` at `first`), and the weight of the units missing there.
pub(crate) type Weighted = Vec<(usize, f64)>;

/// Gathers pixels into the smallest rectangles within blocks of `edge_px` pixels of the full field.
pub(crate) fn blocks(
    missing: &HashMap<usize, f64>,
    first: [usize; 2],
    shape: [usize; 2],
    edge_px: usize,
) -> Vec<(PixelRect, Weighted)> {
    let mut by_block: BTreeMap<[usize; 2], Weighted> = BTreeMap::new();
    for (&pixel, &weight) in missing {
        let at = [first[0] + pixel / shape[1], first[1] + pixel % shape[1]];
        by_block.entry(at.map(|v| v / edge_px)).or_default().push((pixel, weight));
    }
    let range = |places: &mut dyn Iterator<Item = usize>| {
        let (low, high) = places.fold((usize::MAX, 0), |(l, h), v| (l.min(v), h.max(v)));
        [low, high - low + 1]
    };
    let rectangle = |pixels: &Weighted| {
        let rows = range(&mut pixels.iter().map(|p| first[0] + p.0 / shape[1]));
        let columns = range(&mut pixels.iter().map(|p| first[1] + p.0 % shape[1]));
        PixelRect::new([rows[0], columns[0]], [rows[1], columns[1]])
    };
    by_block.into_values().map(|pixels| (rectangle(&pixels), pixels)).collect()
}
