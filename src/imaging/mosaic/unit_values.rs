//! The image of a unit at any places, from the samples of its library cell.

use ndarray::Array2;
use pulp::{Arch, Simd, WithSimd};

use crate::imaging::mosaic::cell_images::{CellImages, Realisation};
use crate::plane;
use crate::resample::{Kernel, TAPS};
use crate::simd::vectorised;

/// The mean image of some configurations of a unit on a detector, at `offsets` from its centre in samples (x, y).
pub(super) fn unit_values(
    (cell, detector): (&CellImages, usize),
    realisations: &[Realisation],
    offsets: &[[f64; 2]],
    kernel: &Kernel,
) -> Vec<f64> {
    let centres: Vec<[f64; 2]> = realisations.iter().map(|s| cell.position(s.unit)).collect();
    let Some(&centre) = centres.first() else { return vec![0.0; offsets.len()] };
    let [along_x, along_y] = cell.library_cell.periodic;
    let axes = [(cell.shape[1], along_x), (cell.shape[0], along_y)];
    let range = |k: usize| {
        let low = offsets.iter().map(|o| o[k]).fold(f64::INFINITY, f64::min) + centre[k];
        let high = offsets.iter().map(|o| o[k]).fold(f64::NEG_INFINITY, f64::max) + centre[k];
        let first = |at: f64| kernel.weights_on(axes[k], at).first;
        [first(low), first(high) + TAPS as i64 - 1]
    };
    let (x, y) = (range(0), range(1));
    let size = |r: [i64; 2]| (r[1] - r[0] + 1) as usize;
    // Samples of all configurations lie at the same places about the centre, so they are summed first.
    let mut patch = vec![0.0f64; size(x) * size(y)];
    let whole = realisations.len() == shelf_configurations(cell, realisations);
    if whole {
        let mean = cell.mean(detector, realisations[0].library_cell);
        add_samples(&mut patch, mean, ([x[0], y[0]], size(x)), 1.0);
    } else {
        let weight = 1.0 / realisations.len() as f64;
        for (realisation, at) in realisations.iter().zip(&centres) {
            let shift = plane::sub(*at, centre).map(|d| d.round() as i64);
            let image = cell.image(detector, realisation.library_cell, realisation.configuration);
            add_samples(&mut patch, image, (plane::add([x[0], y[0]], shift), size(x)), weight);
        }
    }
    // The lines are summed column by column, so that the 16 lines of a value are summed at once.
    let lines = size(y);
    let mut samples = vec![0.0; patch.len()];
    for (line, row) in patch.chunks_exact(size(x)).enumerate() {
        samples[line..].iter_mut().step_by(lines).zip(row).for_each(|(to, value)| *to = *value);
    }
    let interpolation =
        Interpolation { samples, lines, first: [x[0], y[0]], axes, kernel, centre, offsets };
    Arch::new().dispatch(interpolation)
}

/// The number of configurations if `realisations` are all of one unit, else 0.
fn shelf_configurations(cell: &CellImages, realisations: &[Realisation]) -> usize {
    let first = realisations[0];
    let same = realisations
        .iter()
        .enumerate()
        .all(|(n, s)| *s == Realisation { configuration: n, ..first });
    if same { cell.configurations(first.library_cell) } else { 0 }
}

/// Adds samples of a periodic image, from the sample `first` (x, y) on, times a weight to rows of `width` samples.
fn add_samples(
    to: &mut [f64],
    image: &Array2<f32>,
    (first, width): ([i64; 2], usize),
    weight: f64,
) {
    let (rows, columns) = image.dim();
    // Along axes that are not periodic, all units of a kind have equal positions.
    let wrapped = |i: i64, n: usize| i.rem_euclid(n as i64) as usize;
    let column = wrapped(first[0], columns);
    let standard = image.as_standard_layout();
    let samples = standard.as_slice().unwrap_or_default();
    let mut row = wrapped(first[1], rows);
    vectorised(
        #[inline(always)]
        || {
            for line in to.chunks_exact_mut(width) {
                add_wrapped(line, &samples[row * columns..][..columns], column, weight);
                row = if row + 1 == rows { 0 } else { row + 1 };
            }
        },
    );
}

/// Adds the samples of a periodic row, from number `first` on, times a weight.
#[inline(always)]
fn add_wrapped(to: &mut [f64], row: &[f32], first: usize, weight: f64) {
    let (mut to, mut first) = (to, first);
    while !to.is_empty() {
        let (part, rest) = to.split_at_mut(to.len().min(row.len() - first));
        let samples = &row[first..first + part.len()];
        for (to, sample) in part.iter_mut().zip(samples) {
            *to += weight * f64::from(*sample);
        }
        (to, first) = (rest, 0);
    }
}

/// Values between samples that lie column by column, `lines` in each; the first is number `first` (x, y) of the library cell.
struct Interpolation<'a> {
    samples: Vec<f64>,
    lines: usize,
    first: [i64; 2],
    /// Number of samples along x and y, and whether the axis is periodic.
    axes: [(usize, bool); 2],
    kernel: &'a Kernel,
    centre: [f64; 2],
    offsets: &'a [[f64; 2]],
}

impl WithSimd for Interpolation<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let mut values = vec![0.0; self.offsets.len()];
        // Loops: what an iterator collects would be compiled without these vectors.
        let Some((places, place_of)) = shared_places(self.offsets) else {
            for (value, offset) in values.iter_mut().zip(self.offsets) {
                let (column, across) = self.weights(0, offset[0]);
                let (row, down) = self.weights(1, offset[1]);
                let lines = line_sums(
                    simd,
                    &self.samples[column * self.lines + row..],
                    self.lines,
                    &across,
                );
                *value = weighted_sum(simd, &lines[..TAPS / S::F64_LANES], &down);
            }
            return values;
        };
        let mut sums = vec![0.0; places.len() * self.lines];
        for (sums, place) in sums.chunks_exact_mut(self.lines).zip(&places) {
            let (column, across) = self.weights(0, *place);
            let samples = &self.samples[column * self.lines..];
            let mut row = 0;
            while row < self.lines {
                // The last lines are summed once more with some of the lines before, so that there are 16.
                row = row.min(self.lines - TAPS);
                let lines = line_sums(simd, &samples[row..], self.lines, &across);
                let (to, _) = S::as_mut_simd_f64s(&mut sums[row..][..TAPS]);
                to.copy_from_slice(&lines[..TAPS / S::F64_LANES]);
                row += TAPS;
            }
        }
        for ((value, offset), place) in values.iter_mut().zip(self.offsets).zip(place_of) {
            let (row, down) = self.weights(1, offset[1]);
            let (lines, _) = S::as_simd_f64s(&sums[place * self.lines + row..][..TAPS]);
            *value = weighted_sum(simd, lines, &down);
        }
        values
    }
}

impl Interpolation<'_> {
    /// The first sample of a place along an axis, and the weights of the samples.
    #[inline(always)]
    fn weights(&self, axis: usize, offset: f64) -> (usize, [f64; TAPS]) {
        let found = self.kernel.weights_on(self.axes[axis], offset + self.centre[axis]);
        ((found.first - self.first[axis]) as usize, found.values)
    }
}

/// The places along x that pixels below each other share, and the number of each pixel's place; `None` where the raster is turned, so that
/// most pixels have a place of their own.
fn shared_places(offsets: &[[f64; 2]]) -> Option<(Vec<f64>, Vec<usize>)> {
    // About twice the width of a unit.
    let most = 8 + 2 * offsets.len().isqrt();
    let (mut places, mut place_of) = (Vec::with_capacity(most), Vec::with_capacity(offsets.len()));
    for [x, _] in offsets {
        let place = match places.iter().position(|place| place == x) {
            Some(place) => place,
            None if places.len() == most => return None,
            None => {
                places.push(*x);
                places.len() - 1
            }
        };
        place_of.push(place);
    }
    Some((places, place_of))
}

/// The sums of 16 samples with weights along each of 16 lines, one sample after the other. Samples of a line lie `stride` apart, and lines
/// beside each other. Only as many vectors as 16 lines fill are sums.
#[inline(always)]
fn line_sums<S: Simd>(
    simd: S,
    samples: &[f64],
    stride: usize,
    across: &[f64; TAPS],
) -> [S::f64s; TAPS] {
    let mut lines = [simd.splat_f64s(0.0); TAPS];
    for (k, weight) in across.iter().enumerate() {
        let (column, _) = S::as_simd_f64s(&samples[k * stride..][..TAPS]);
        let weight = simd.splat_f64s(*weight);
        for (sum, samples) in lines[..TAPS / S::F64_LANES].iter_mut().zip(column) {
            *sum = simd.add_f64s(*sum, simd.mul_f64s(*samples, weight));
        }
    }
    lines
}

/// The sum of 16 lines with weights, one after the other. Vectors of any width give the same sum.
#[inline(always)]
fn weighted_sum<S: Simd>(simd: S, lines: &[S::f64s], down: &[f64; TAPS]) -> f64 {
    let mut products = [0.0; TAPS];
    let (to, _) = S::as_mut_simd_f64s(&mut products);
    let (down, _) = S::as_simd_f64s(down);
    for ((to, weight), line) in to.iter_mut().zip(down).zip(lines) {
        *to = simd.mul_f64s(*weight, *line);
    }
    let mut sum = 0.0;
    for product in &products {
        sum += product;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values at `offsets` of samples of some pattern.
    fn values(offsets: &[[f64; 2]]) -> Vec<f64> {
        let lines = 40;
        let samples = (0..lines * 40).map(|n| f64::from(n * n % 101)).collect();
        let kernel = Kernel::new(0.25, 1.8).unwrap();
        let axes = [(40, false); 2];
        let (first, centre) = ([0; 2], [20.0; 2]);
        let interpolation = Interpolation {
            samples,
            lines: lines as usize,
            first,
            axes,
            kernel: &kernel,
            centre,
            offsets,
        };
        Arch::new().dispatch(interpolation)
    }

    #[test]
    fn sums_that_pixels_share_give_the_same_values() {
        let raster: Vec<[f64; 2]> =
            (0..90).map(|n| [f64::from(n % 9) * 0.7 - 3.1, f64::from(n / 9) * 0.7 - 2.9]).collect();
        assert_eq!(shared_places(&raster).unwrap().0.len(), 9);
        let alone: Vec<f64> = raster
            .iter()
            .flat_map(|offset| {
                // Beside pixels that share no place, each value is summed alone.
                let others = (0..400).map(|n| [f64::from(n) * 1e-3, 0.0]);
                let turned: Vec<[f64; 2]> = std::iter::once(*offset).chain(others).collect();
                assert!(shared_places(&turned).is_none());
                values(&turned)[0..1].to_vec()
            })
            .collect();
        assert_eq!(values(&raster), alone);
    }
}
