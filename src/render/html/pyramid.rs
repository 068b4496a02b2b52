//! Images as pyramids of tiles.
//!
//! Level 0 is the image, and a pixel of each further level averages 2 x 2 of the one before, until the
//! whole is one tile. A tile holds codes of 8 or 16 bits, and a table gives the value of each code, in
//! rising order:
//! - where an image has few values (counted electrons), they are the table, and nothing is lost;
//! - others are rounded to [`FINE`] steps (level 0) or [`COARSE`] (further levels), even in the square
//!   root of the distance from the least value, in which the noise of counted electrons is even too.
//!
//! A byte before the codes says whether they stand as they are, or as differences (modulo 2^16) from
//! left + above - above left; codes of 16 bits stand as all low, then all high bytes.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use serde::Serialize;

use super::blobs::{Blobs, pack};
use crate::error::Result;
use crate::render::enlarge::shrink;

/// Edge of a tile in pixels.
pub(super) const TILE: usize = 512;
/// Images of at most so many values keep them.
const EXACT: usize = 1 << 16;
/// Steps of level 0: errors are below 0.025 % of the range, and of 0.25 % of the value at 1 % of it.
const FINE: usize = 4096;
/// Steps of further levels, which are looked at only.
const COARSE: usize = 256;

/// One level in the header; its tiles are the blobs from `tiles`, row by row.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Level {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Bits of a code: 8 or 16.
    pub bits: u8,
    /// Blob of the values of the codes, float32.
    pub table: usize,
    /// Blob of the number of pixels of each code, uint32.
    pub histogram: usize,
    pub tiles: usize,
}

/// A level that has no place in a page yet.
struct Packed {
    size: [usize; 2],
    table: CodeTable,
    histogram: Vec<u32>,
    tiles: Vec<String>,
}

/// A pyramid that has no place in a page yet.
pub(super) struct Pyramid {
    levels: Vec<Packed>,
    pub exact: bool,
}

/// The values of codes.
enum CodeTable {
    /// All values of the image, and the code of each (by its bits).
    Values(Vec<f32>, Codes),
    /// Number of steps from the least to the greatest value, even in the square root; and these two values.
    Roots(usize, [f32; 2]),
}

impl CodeTable {
    fn len(&self) -> usize {
        match self {
            CodeTable::Values(values, _) => values.len(),
            CodeTable::Roots(n, _) => *n,
        }
    }

    fn bits(&self) -> u8 {
        if self.len() <= 256 { 8 } else { 16 }
    }

    fn values(&self) -> Vec<f32> {
        match self {
            CodeTable::Values(values, _) => values.clone(),
            CodeTable::Roots(n, [low, high]) => {
                let [low, high] = [f64::from(*low), f64::from(*high)];
                let step = |k: usize| low + (high - low) * (k as f64 / (n - 1) as f64).powi(2);
                (0..*n).map(|k| step(k) as f32).collect()
            }
        }
    }

    fn code(&self, value: f32) -> u16 {
        match self {
            // Every value of the image is there.
            CodeTable::Values(_, codes) => codes.get(&key(value)).copied().unwrap_or(0),
            CodeTable::Roots(n, [low, high]) => {
                let range = f64::from(*high) - f64::from(*low);
                if range <= 0.0 {
                    return 0;
                }
                let last = (n - 1) as f64;
                // Round to the nearer value, not to the nearer root.
                let position = ((f64::from(value) - f64::from(*low)) / range).clamp(0.0, 1.0);
                let below = (position.sqrt() * last).floor();
                let middle = ((below / last).powi(2) + ((below + 1.0) / last).powi(2)) / 2.0;
                (below + f64::from(u8::from(position > middle))).min(last) as u16
            }
        }
    }
}

/// The bits of a value; zero has one sign.
fn key(value: f32) -> u32 {
    (value + 0.0).to_bits()
}

impl Pyramid {
    /// Encodes an image of `size` (rows, columns), of which `read` gives rows. `read` is called twice
    /// for each, and fails on values that are not finite.
    pub fn new(
        size: [usize; 2],
        read: &dyn Fn(Range<usize>) -> Result<Array2<f32>>,
    ) -> Result<Self> {
        let strips = || (0..size[0]).step_by(TILE).map(|row| row..size[0].min(row + TILE));
        let mut survey = ValueSurvey::default();
        for rows in strips() {
            survey.add(read(rows)?.view());
        }
        let table = survey.table(EXACT, FINE);
        let exact = matches!(table, CodeTable::Values(..));
        let mut histogram = vec![0; table.len()];
        let mut tiles = Vec::new();
        let mut half = Array2::zeros(size.map(|n| n.div_ceil(2)));
        for rows in strips() {
            let strip = read(rows.clone())?;
            tiles.extend(pack_row(strip.view(), &table, &mut histogram));
            let small = averaged(strip.view());
            let first = rows.start / 2;
            half.slice_mut(s![first..first + small.nrows(), ..]).assign(&small);
        }
        let mut levels = vec![Packed { size: [size[1], size[0]], table, histogram, tiles }];
        let mut whole = size[0].max(size[1]) <= TILE;
        while !whole {
            levels.push(coarse(half.view(), false));
            whole = half.nrows().max(half.ncols()) <= TILE;
            half = averaged(half.view());
        }
        Ok(Pyramid { levels, exact })
    }

    /// Encodes a map of whole numbers; further levels take one pixel of four.
    pub fn of_codes(map: ArrayView2<i32>) -> Self {
        let mut levels = Vec::new();
        let mut step = 1;
        loop {
            let part = map.slice(s![..;step, ..;step]).mapv(|v| v as f32);
            levels.push(coarse(part.view(), true));
            if part.nrows().max(part.ncols()) <= TILE {
                return Pyramid { levels, exact: true };
            }
            step *= 2;
        }
    }

    /// Number of levels.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// Gives a level a place among the blobs.
    pub fn place(&mut self, level: usize, blobs: &mut Blobs) -> Level {
        let packed = &mut self.levels[level];
        let floats: Vec<u8> = packed.table.values().iter().flat_map(|v| v.to_le_bytes()).collect();
        let counts: Vec<u8> = packed.histogram.iter().flat_map(|n| n.to_le_bytes()).collect();
        Level {
            size: packed.size,
            bits: packed.table.bits(),
            table: blobs.add(&floats),
            histogram: blobs.add(&counts),
            tiles: blobs.add_packed(std::mem::take(&mut packed.tiles)),
        }
    }
}

/// A level after the first (of which few values are kept only if `exact`).
fn coarse(image: ArrayView2<f32>, exact: bool) -> Packed {
    let mut survey = ValueSurvey::default();
    survey.add(image);
    let table = survey.table(if exact { EXACT } else { 0 }, COARSE);
    let mut histogram = vec![0; table.len()];
    let mut tiles = Vec::new();
    for row in (0..image.nrows()).step_by(TILE) {
        let rows = image.slice(s![row..image.nrows().min(row + TILE), ..]);
        tiles.extend(pack_row(rows, &table, &mut histogram));
    }
    Packed { size: [image.ncols(), image.nrows()], table, histogram, tiles }
}

/// Hashes the bits of a number by a multiplication (Knuth, vol. 3, 6.4): many times as fast as the
/// default, which guards against chosen keys.
#[derive(Default)]
struct BitHasher(u64);

impl Hasher for BitHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u32(u32::from(*b)));
    }
    fn write_u32(&mut self, bits: u32) {
        let mixed = (self.0 ^ u64::from(bits)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

type Codes = HashMap<u32, u16, BuildHasherDefault<BitHasher>>;

/// Which values an image has.
#[derive(Default)]
struct ValueSurvey {
    /// Their bits, as long as there are few.
    values: Codes,
    range: Option<[f32; 2]>,
}

impl ValueSurvey {
    fn add(&mut self, image: ArrayView2<f32>) {
        let [mut low, mut high] = self.range.unwrap_or([f32::INFINITY, f32::NEG_INFINITY]);
        let mut last = None;
        for value in image {
            (low, high) = (low.min(*value), high.max(*value));
            let bits = key(*value);
            if last != Some(bits) && self.values.len() <= EXACT {
                self.values.insert(bits, 0);
                last = Some(bits);
            }
        }
        self.range = Some([low, high]);
    }

    /// All values if there are at most `most`, and `steps` of them otherwise.
    fn table(mut self, most: usize, steps: usize) -> CodeTable {
        if self.values.len() > most {
            return CodeTable::Roots(steps, self.range.unwrap_or([0.0, 1.0]));
        }
        let mut values: Vec<f32> = self.values.keys().map(|bits| f32::from_bits(*bits)).collect();
        values.sort_by(f32::total_cmp);
        for (code, value) in values.iter().enumerate() {
            self.values.insert(key(*value), code as u16);
        }
        CodeTable::Values(values, self.values)
    }
}

/// The tiles of up to [`TILE`] rows, and their codes counted.
fn pack_row(rows: ArrayView2<f32>, table: &CodeTable, histogram: &mut [u32]) -> Vec<String> {
    let width = rows.ncols();
    let starts: Vec<usize> = (0..width).step_by(TILE).collect();
    let tiles: Vec<(String, Vec<u32>)> = starts
        .into_par_iter()
        .map(|start| {
            let tile = rows.slice(s![.., start..width.min(start + TILE)]);
            let codes = tile.mapv(|value| table.code(value));
            let mut counts = vec![0; table.len()];
            codes.iter().for_each(|code| counts[usize::from(*code)] += 1);
            (pack_tile(codes.view(), table.bits()), counts)
        })
        .collect();
    let mut texts = Vec::with_capacity(tiles.len());
    for (text, counts) in tiles {
        histogram.iter_mut().zip(counts).for_each(|(sum, n)| *sum += n);
        texts.push(text);
    }
    texts
}

/// A tile's blob, in the form whose bytes vary less.
fn pack_tile(codes: ArrayView2<u16>, bits: u8) -> String {
    let bytes = |form: u8, codes: &Array2<u16>| {
        let mut out = vec![form];
        out.extend(codes.iter().map(|c| *c as u8));
        if bits == 16 {
            out.extend(codes.iter().map(|c| (*c >> 8) as u8));
        }
        out
    };
    let plain = bytes(0, &codes.to_owned());
    let differences = bytes(1, &differences(codes));
    pack(if information(&differences) < information(&plain) { &differences } else { &plain })
}

/// Bits that bytes hold if each stands for itself: their number times the entropy of Shannon.
fn information(bytes: &[u8]) -> f64 {
    let mut counts = [0u32; 256];
    bytes.iter().for_each(|b| counts[usize::from(*b)] += 1);
    let all = bytes.len() as f64;
    let part = |n: u32| if n > 0 { f64::from(n) * (all / f64::from(n)).log2() } else { 0.0 };
    counts.into_iter().map(part).sum()
}

fn differences(codes: ArrayView2<u16>) -> Array2<u16> {
    Array2::from_shape_fn(codes.dim(), |(i, j)| {
        let at = |up: usize, left: usize| match (i.checked_sub(up), j.checked_sub(left)) {
            (Some(i), Some(j)) => codes[(i, j)],
            _ => 0,
        };
        let expected = at(0, 1).wrapping_add(at(1, 0)).wrapping_sub(at(1, 1));
        codes[(i, j)].wrapping_sub(expected)
    })
}

/// Means of 2 x 2 pixels, of fewer at the lower and right edge.
fn averaged(image: ArrayView2<f32>) -> Array2<f32> {
    let pixels = image.as_standard_layout();
    let small = shrink(pixels.as_slice().unwrap_or_default(), image.dim().into(), 2);
    Array2::from_shape_fn(small.shape, |(i, j)| small.values[i * small.shape[1] + j])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pyramid(image: &Array2<f32>) -> Pyramid {
        Pyramid::new(image.dim().into(), &|rows| Ok(image.slice(s![rows, ..]).to_owned())).unwrap()
    }

    #[test]
    fn few_values_are_kept_and_many_rounded_finely() {
        let counts = Array2::from_shape_fn((40, 30), |(i, j)| ((i * j) % 37) as f32 / 406.0);
        let exact = pyramid(&counts);
        assert!(exact.exact && exact.len() == 1);
        let CodeTable::Values(values, codes) = &exact.levels[0].table else { panic!() };
        assert!(counts.iter().all(|v| values[usize::from(codes[&key(*v)])] == *v));
        assert_eq!(exact.levels[0].histogram.iter().sum::<u32>(), 1200);
        let many = Array2::from_shape_fn((300, 300), |(i, j)| (300 * i + j) as f32 / 90_000.0);
        let rounded = pyramid(&many);
        assert!(!rounded.exact && rounded.levels[0].table.bits() == 16);
        let values = rounded.levels[0].table.values();
        for value in &many {
            let read = values[usize::from(rounded.levels[0].table.code(*value))];
            assert!((read - value).abs() <= 2.5e-4 * value.max(0.01).sqrt(), "{value} {read}");
        }
    }

    #[test]
    fn levels_average_until_one_tile_is_left() {
        let image = Array2::from_shape_fn((1030, 700), |(i, j)| (i + j) as f32);
        let pyramid = pyramid(&image);
        let sizes: Vec<[usize; 2]> = pyramid.levels.iter().map(|l| l.size).collect();
        assert_eq!(sizes, [[700, 1030], [350, 515], [175, 258]]);
        let tiles: Vec<usize> = pyramid.levels.iter().map(|l| l.tiles.len()).collect();
        assert_eq!(tiles, [6, 2, 1]);
        let small = averaged(ndarray::arr2(&[[1.0, 3.0, 5.0], [3.0, 5.0, 7.0]]).view());
        assert_eq!(small, ndarray::arr2(&[[3.0, 6.0]]));
    }

    #[test]
    fn differences_of_a_plane_vanish() {
        let plane = Array2::from_shape_fn((9, 7), |(i, j)| (100 + 3 * i + 5 * j) as u16);
        let rest = differences(plane.view());
        assert!(rest.slice(s![1.., 1..]).iter().all(|d| *d == 0));
        assert_eq!((rest[(0, 0)], rest[(0, 3)], rest[(4, 0)]), (100, 5, 3));
    }

    #[test]
    fn an_image_of_one_value_is_fine() {
        let flat = pyramid(&Array2::from_elem((600, 5), 0.25));
        assert_eq!(flat.levels[0].table.values(), [0.25]);
        assert_eq!(flat.levels[1].table.code(0.25), 0);
        assert_eq!(flat.levels[1].table.values()[0], 0.25);
    }
}
