//! Divides the overview of a recipe's world into blocks that are made on demand.

use std::ops::Range;

use super::benchmark_world::window;
use super::episode_settings::OVERVIEW_PX;

/// Edge of a block in pixels of the overview. Larger blocks query fewer columns beyond their edges; smaller blocks make fewer pixels that
/// are not shown.
const BLOCK_PX: usize = OVERVIEW_PX / 2;

/// Blocks that cover an overview. The window at the beginning of an episode consists of whole blocks.
#[derive(Debug, Clone, Copy)]
pub struct OverviewBlocks {
    shape: [usize; 2],
    /// Pixels of the first block along each axis; the first block may be smaller than the others, or empty.
    first_px: [usize; 2],
}

impl OverviewBlocks {
    /// Divides an overview of `shape` pixels, [rows, columns]. `start` is the position (x, y), in fractions of the field, that is shown
    /// first.
    pub fn new(shape: [usize; 2], start: [f64; 2]) -> Self {
        let first_px = window(start, shape, OVERVIEW_PX).map(|n| n % BLOCK_PX);
        OverviewBlocks { shape, first_px }
    }

    /// Returns the blocks, [row, column], that cover a rectangle of pixels, [rows, columns].
    pub fn covering(&self, [rows, columns]: [Range<usize>; 2]) -> Vec<[usize; 2]> {
        let along = |k: usize, px: Range<usize>| {
            let block = |n: usize| (n + BLOCK_PX - self.first_px[k]) / BLOCK_PX;
            if px.is_empty() { 0..0 } else { block(px.start)..block(px.end - 1) + 1 }
        };
        let columns = along(1, columns);
        along(0, rows).flat_map(|r| columns.clone().map(move |c| [r, c])).collect()
    }

    /// Returns the pixels of a block, [rows, columns].
    pub fn pixels(&self, block: [usize; 2]) -> [Range<usize>; 2] {
        [0, 1].map(|k| {
            let end = block[k] * BLOCK_PX + self.first_px[k];
            end.saturating_sub(BLOCK_PX)..end.min(self.shape[k])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_each_pixel_once_and_the_first_window_is_whole_ones() {
        for shape in [[620, 620], [130, 64], [65, 200], [20, 90]] {
            let blocks = OverviewBlocks::new(shape, [0.5; 2]);
            let mut seen = vec![0; shape[0] * shape[1]];
            for block in blocks.covering([0..shape[0], 0..shape[1]]) {
                let [rows, columns] = blocks.pixels(block);
                rows.for_each(|r| columns.clone().for_each(|c| seen[r * shape[1] + c] += 1));
            }
            assert!(seen.iter().all(|n| *n == 1), "{shape:?}");

            let first = window([0.5; 2], shape, OVERVIEW_PX);
            let shown = [0, 1].map(|k| first[k]..(first[k] + OVERVIEW_PX).min(shape[k]));
            let area = |[rows, columns]: &[Range<usize>; 2]| rows.len() * columns.len();
            let made: usize =
                blocks.covering(shown.clone()).iter().map(|b| area(&blocks.pixels(*b))).sum();
            assert_eq!(made, area(&shown), "{shape:?}");
            // Any other window is covered, too.
            for block in blocks.covering([3..5, shape[1] - 1..shape[1]]) {
                let [rows, columns] = blocks.pixels(block);
                assert!(rows.start < 5 && rows.end > 3 && columns.end == shape[1], "{shape:?}");
            }
        }
    }
}
