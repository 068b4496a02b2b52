//! Rough interfaces: Gaussian random surfaces.

use rayon::prelude::*;

use crate::rng::{Purpose, normal3, uniform};
use crate::simd::vectorised;

/// Number of waves in the sum; their wave vectors are normally distributed.
const WAVES: u64 = 64;
/// First item of the random phases, beyond the items of the wave vectors.
const PHASES: u64 = 1 << 32;
/// Grid steps per correlation length.
const STEPS: f64 = 6.0;

/// Deviation of an interface from its mean plane as a function of y and z, all in nm.
#[derive(Debug)]
pub struct Roughness {
    start: f64,
    step: [f64; 2],
    /// Number of points along z.
    depth: usize,
    /// Heights row by row: y, then z.
    heights: Vec<f64>,
    means: Vec<f64>,
    /// Least and greatest height of each row.
    ranges: Vec<[f64; 2]>,
    greatest: f64,
}

impl Roughness {
    /// Makes interface `number` for `y` within `range` and `z` within `0..thickness`: its correlation is exp(-r^2 / 2 length^2), and within
    /// `field` and the thickness its mean is 0 and its standard deviation `rms`.
    pub fn new(
        range: [f64; 2],
        field: [f64; 2],
        thickness: f64,
        rms: f64,
        length: f64,
        seed: u64,
        number: u32,
    ) -> Self {
        let steps = |span: f64| (span * STEPS / length).ceil().max(1.0);
        let [across, along] = [steps(range[1] - range[0]), steps(thickness)];
        let step = [(range[1] - range[0]) / across, thickness / along];
        let waves: Vec<[f64; 3]> = (0..WAVES)
            .map(|n| {
                let [ky, kz, _] = normal3(seed, Purpose::Interface, number, n);
                let phase = uniform(seed, Purpose::Interface, number, PHASES + n);
                [ky / length, kz / length, 2.0 * std::f64::consts::PI * phase]
            })
            .collect();
        let rows = across as usize + 1;
        let depth = along as usize + 1;
        // cos(a + b) = cos a cos b - sin a sin b: a depends on y alone and b on z alone, so few cosines have to be computed.
        let turn = |angle: f64| {
            let (sin, cos) = libm::sincos(angle);
            [cos, sin]
        };
        let of_z: Vec<[Vec<f64>; 2]> = waves
            .par_iter()
            .map(|[_, kz, _]| {
                let turned = (0..depth).map(|k| turn(kz * (k as f64 * step[1]))).map(Into::into);
                let (cosines, sines) = turned.unzip::<f64, f64, Vec<_>, Vec<_>>();
                [cosines, sines]
            })
            .collect();
        let row = |i: usize| {
            let y = range[0] + i as f64 * step[0];
            let mut heights = vec![0.0; depth];
            for ([ky, _, phase], [cosines, sines]) in waves.iter().zip(&of_z) {
                let [cos, sin] = turn(ky * y + phase);
                vectorised(
                    #[inline(always)]
                    || {
                        let of_z = cosines.iter().zip(sines);
                        for (height, (cos_z, sin_z)) in heights.iter_mut().zip(of_z) {
                            *height += cos * cos_z - sin * sin_z;
                        }
                    },
                );
            }
            heights
        };
        let mut heights: Vec<f64> = (0..rows).into_par_iter().flat_map_iter(row).collect();
        let inside = |i: usize| {
            let y = range[0] + i as f64 * step[0];
            field[0] <= y && y < field[1]
        };
        let of_field = || (0..rows).filter(|&i| inside(i)).flat_map(|i| i * depth..(i + 1) * depth);
        let count = of_field().count().max(1) as f64;
        let mean = of_field().map(|n| heights[n]).sum::<f64>() / count;
        let variance = of_field().map(|n| (heights[n] - mean).powi(2)).sum::<f64>() / count;
        let scale = if variance > 0.0 { rms / variance.sqrt() } else { 0.0 };
        heights.iter_mut().for_each(|h| *h = (*h - mean) * scale);
        let means =
            heights.chunks(depth).map(|row| row.iter().sum::<f64>() / depth as f64).collect();
        let greatest = heights.iter().fold(0.0, |g: f64, h| g.max(h.abs()));
        let extremes = |row: &[f64]| {
            let start = [f64::INFINITY, f64::NEG_INFINITY];
            row.iter().fold(start, |[l, h], v| [l.min(*v), h.max(*v)])
        };
        let ranges = heights.chunks(depth).map(extremes).collect();
        Roughness { start: range[0], step, depth, heights, means, ranges, greatest }
    }

    /// Returns the deviation at a point, interpolated linearly between the points of the grid.
    pub fn at(&self, y: f64, z: f64) -> f64 {
        self.along_beam(y, &[z]).sum()
    }

    /// Returns the deviations at one y and some z.
    pub fn along_beam<'a>(&'a self, y: f64, z: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        let (i, s) = split((y - self.start) / self.step[0], self.means.len());
        let rows = self.heights[i * self.depth..(i + 2) * self.depth].split_at(self.depth);
        z.iter().map(move |z| {
            let (k, t) = split(z / self.step[1], self.depth);
            let of_row = |row: &[f64]| row[k] + t * (row[k + 1] - row[k]);
            let [low, high] = [rows.0, rows.1].map(of_row);
            low + s * (high - low)
        })
    }

    /// Returns the mean deviation along the beam.
    pub fn mean_along_beam(&self, y: f64) -> f64 {
        let (i, s) = split((y - self.start) / self.step[0], self.means.len());
        self.means[i] + s * (self.means[i + 1] - self.means[i])
    }

    /// Returns the least and the greatest deviation at this y, up to rounding.
    pub fn range(&self, y: f64) -> [f64; 2] {
        let (i, _) = split((y - self.start) / self.step[0], self.means.len());
        let [a, b] = [self.ranges[i], self.ranges[i + 1]];
        [a[0].min(b[0]), a[1].max(b[1])]
    }

    /// Returns the greatest deviation.
    pub fn greatest(&self) -> f64 {
        self.greatest
    }

    /// Returns the values of y in a range at which [`Roughness::mean_along_beam`] has its corners, and the ends of the range.
    pub fn corners(&self, [first, last]: [f64; 2]) -> Vec<f64> {
        let grid = (0..self.means.len()).map(|i| self.start + i as f64 * self.step[0]);
        let mut out = vec![first];
        out.extend(grid.filter(|y| first < *y && *y < last));
        out.push(last);
        out
    }
}

/// Returns the interval of `count` points that contains `at`, and the place in it.
fn split(at: f64, count: usize) -> (usize, f64) {
    let at = at.clamp(0.0, (count - 1) as f64);
    let n = (at as usize).min(count - 2);
    (n, at - n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_those_asked_for() {
        // The field spans many correlation lengths, so the realised correlation is near its mean.
        let (rms, length) = (0.5, 1.0);
        let (mut covariance, mut count) = ([0.0; 2], 0.0);
        for number in 0..40 {
            let r = Roughness::new([-5.0, 85.0], [0.0, 80.0], 10.0, rms, length, 4, number);
            let mut sums = [0.0; 2];
            for i in 0..480 {
                for k in 0..60 {
                    let (y, z) = ((f64::from(i) + 0.5) / 6.0, f64::from(k) / 6.0);
                    let h = r.at(y, z);
                    sums[0] += h;
                    sums[1] += h * h;
                    covariance[0] += h * r.at(y, z + length);
                    covariance[1] += h * r.at(y + length, z);
                    count += 1.0;
                }
            }
            assert!(
                (sums[0] / 28_800.0).abs() < 0.03 && (sums[1] / 28_800.0 / 0.25 - 1.0).abs() < 0.06
            );
        }
        for c in covariance {
            let found = c / count / 0.25;
            assert!((found - (-0.5f64).exp()).abs() < 0.05, "{found}");
        }
    }

    #[test]
    fn the_projection_is_the_mean() {
        let r = Roughness::new([0.0, 20.0], [0.0, 20.0], 10.0, 0.25, 3.0, 1, 0);
        let y = 7.3;
        let mean: f64 =
            (0..10_000).map(|k| r.at(y, (f64::from(k) + 0.5) * 1e-3)).sum::<f64>() / 1e4;
        assert!((mean - r.mean_along_beam(y)).abs() < 0.02);
        let all: Vec<f64> = (0..=1000).map(|k| r.at(y, f64::from(k) * 0.01)).collect();
        let [low, high] = r.range(y);
        assert!(all.iter().all(|h| (low - 1e-12..=high + 1e-12).contains(h)));
        assert!(high - low < 2.0 * r.greatest());
        assert!(r.greatest() < 1.5);
    }
}
