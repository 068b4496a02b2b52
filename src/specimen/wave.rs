//! Wavy lines: phase boundaries that run along y.

use crate::rng::{Purpose, uniform};

use crate::recipe::region::Region;
use crate::simd::{greater, lesser, vectorised};

/// Number of waves on one boundary; the field holds 1, 2 ... whole periods of them.
const HARMONICS: u32 = 3;
/// Distance between the corners of the polyline in nm.
const STEP_NM: f64 = 0.5;
/// Number of steps in a block; a block that is too far away is skipped as a whole.
const BLOCK: usize = 8;
/// Bounds of distances are widened by this much against rounding.
const ROUNDING_NM: f64 = 1e-6;
const TURN: f64 = 2.0 * std::f64::consts::PI;

/// The line x = `mean_x` + excursion(y), in nm.
#[derive(Debug, Clone)]
pub struct WavyLine {
    mean_x: f64,
    /// Upper bound of all excursions.
    amplitude: f64,
    /// Lower bound of the cosine of the angle between y and any part of the line.
    least_cosine: f64,
    /// Largest distance along x of the polyline from the line.
    sag: f64,
    y0: f64,
    height: f64,
    /// Amplitude and phase of each harmonic.
    harmonics: Vec<[f64; 2]>,
    /// The line as corners STEP_NM apart in y, as far as the specimen reaches.
    corners: Vec<[f64; 2]>,
    blocks: Vec<SegmentBlock>,
}

/// Several segments between neighbouring corners.
#[derive(Debug, Clone)]
struct SegmentBlock {
    /// Least and greatest x of the segments.
    range: [f64; 2],
    /// First corners of the segments: x of all, then y.
    from: [[f64; BLOCK]; 2],
    /// Vectors from the first corners to the second corners.
    along: [[f64; BLOCK]; 2],
}

impl SegmentBlock {
    /// Makes a block of at least two and at most [`BLOCK`] + 1 corners; the last segment is repeated to fill the block.
    fn new(corners: &[[f64; 2]]) -> Self {
        let segment = |n: usize| {
            let n = n.min(corners.len() - 2);
            (corners[n], corners[n + 1])
        };
        let from = [0, 1].map(|k| std::array::from_fn(|n| segment(n).0[k]));
        let along = [0, 1].map(|k| {
            std::array::from_fn(|n| {
                let (a, b) = segment(n);
                b[k] - a[k]
            })
        });
        let x = corners.iter().map(|c| c[0]);
        let range = x.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], x| [l.min(x), h.max(x)]);
        SegmentBlock { range, from, along }
    }

    /// Returns the square of the distance of a point from the nearest segment.
    #[inline(always)]
    fn square(&self, [x, y]: [f64; 2]) -> f64 {
        let mut squares = [0.0; BLOCK];
        for (n, square) in squares.iter_mut().enumerate() {
            let d = [self.along[0][n], self.along[1][n]];
            let q = [x - self.from[0][n], y - self.from[1][n]];
            let t = (d[0] * q[0] + d[1] * q[1]) / (d[0] * d[0] + d[1] * d[1]);
            let t = lesser(greater(t, 0.0), 1.0);
            let (x, y) = (q[0] - t * d[0], q[1] - t * d[1]);
            *square = x * x + y * y;
        }
        // The least square is found by halving, as vector units do it.
        let mut half = BLOCK / 2;
        while half > 0 {
            let (low, high) = squares.split_at_mut(half);
            low.iter_mut().zip(high).for_each(|(a, b)| *a = lesser(*a, *b));
            half /= 2;
        }
        squares[0]
    }
}

impl WavyLine {
    /// Draws line `number` about `mean_x`, whose greatest excursion in the field is `amplitude`.
    pub fn new(
        mean_x: f64,
        amplitude: f64,
        field: &Region,
        beyond: f64,
        seed: u64,
        number: u32,
    ) -> Self {
        let height = field.y[1] - field.y[0];
        let harmonic = |n: u32| {
            let weight = 0.5 + uniform(seed, Purpose::Interface, number, 2 * u64::from(n));
            let phase = TURN * uniform(seed, Purpose::Interface, number, 2 * u64::from(n) + 1);
            // With amplitudes of 1/n^2 all harmonics bend the line equally.
            [weight / f64::from(n * n), phase]
        };
        let harmonics = (1..=HARMONICS).map(harmonic).collect();
        let mut line = WavyLine {
            mean_x,
            amplitude,
            least_cosine: 0.0,
            sag: 0.0,
            y0: field.y[0],
            height,
            harmonics,
            corners: Vec::new(),
            blocks: Vec::new(),
        };
        let samples = 4096;
        let at = |k: u32| line.excursion(line.y0 + height * f64::from(k) / f64::from(samples));
        let greatest = (0..samples).map(at).fold(0.0, |g: f64, e| g.max(e.abs()));
        line.harmonics.iter_mut().for_each(|h| h[0] *= amplitude / greatest);
        let count = ((height + 2.0 * beyond) / STEP_NM).ceil() as usize;
        // Bounds of the excursion and of its first two derivatives.
        let greatest =
            |order| line.waves(0.0).map(|[a, k, _]| a.abs() * k.powi(order)).sum::<f64>();
        let [excursion, slope, bend] = [0, 1, 2].map(greatest);
        line.amplitude = excursion;
        line.least_cosine = 1.0 / (1.0 + slope * slope).sqrt();
        line.sag = 0.125 * bend * STEP_NM * STEP_NM;
        line.corners = (0..=count)
            .map(|k| field.y[0] - beyond + STEP_NM * k as f64)
            .map(|y| [line.x(y), y])
            .collect();
        let block = |start: usize| {
            let end = (start + BLOCK + 1).min(line.corners.len());
            SegmentBlock::new(&line.corners[start..end])
        };
        line.blocks = (0..count).step_by(BLOCK).map(block).collect();
        line
    }

    /// Returns the waves at y: amplitude, wave number and phase of each.
    fn waves(&self, y: f64) -> impl Iterator<Item = [f64; 3]> + '_ {
        (1..).zip(&self.harmonics).map(move |(n, [amplitude, phase])| {
            let k = TURN * f64::from(n) / self.height;
            [*amplitude, k, k * (y - self.y0) + phase]
        })
    }

    fn excursion(&self, y: f64) -> f64 {
        self.waves(y).fold(0.0, |sum, [amplitude, _, angle]| sum + amplitude * libm::cos(angle))
    }

    /// Returns the derivative of the excursion.
    fn slope(&self, y: f64) -> f64 {
        let add = |sum, [amplitude, k, angle]: [f64; 3]| sum - amplitude * k * libm::sin(angle);
        self.waves(y).fold(0.0, add)
    }

    /// Returns x of the line.
    pub fn x(&self, y: f64) -> f64 {
        self.mean_x + self.excursion(y)
    }

    /// Whether the line lies at or left of a point.
    pub fn is_left_of(&self, [x, y]: [f64; 2]) -> bool {
        match (x - self.mean_x).abs() > self.amplitude {
            true => x > self.mean_x,
            false => self.x(y) <= x,
        }
    }

    /// Returns x of the line, and the cosine of the angle between its normal and x.
    pub fn x_and_cosine(&self, y: f64) -> [f64; 2] {
        let slope = self.slope(y);
        [self.x(y), 1.0 / (1.0 + slope * slope).sqrt()]
    }

    /// Returns the corners of the line between `y[0]` and `y[1]`, both ends included.
    pub fn polyline(&self, y: [f64; 2]) -> Vec<[f64; 2]> {
        let apart = 0.01 * STEP_NM;
        let inside = self.corners.iter().filter(|c| y[0] + apart < c[1] && c[1] < y[1] - apart);
        let mut line = vec![[self.x(y[0]), y[0]]];
        line.extend(inside);
        line.push([self.x(y[1]), y[1]]);
        line
    }

    /// Returns the distance of a point from the line, which crosses the point's y at `crossing`; returns `known` if the line is not nearer.
    pub fn nearer(&self, [x, y]: [f64; 2], crossing: f64, known: f64) -> f64 {
        // Lower bounds of the distance: along x, and at right angles to the line's steepest part. Rounding is less than a femtometre.
        let along_x = ((x - self.mean_x).abs() - self.amplitude - ROUNDING_NM).max(0.0);
        let steepest = self.least_cosine * ((x - crossing).abs() - self.sag) - ROUNDING_NM;
        if along_x.max(steepest) >= known {
            return known;
        }
        let nearest = (x - crossing).abs().min(known);
        let first = self.corners.first().map_or(0.0, |c| c[1]);
        let last = self.blocks.len().saturating_sub(1) as f64;
        let edge = STEP_NM * BLOCK as f64;
        let block = |y: f64| ((y - first) / edge).clamp(0.0, last) as usize;
        let beside = block(y);
        let square = vectorised(
            #[inline(always)]
            || {
                // The block beside the point is probably the nearest, so others can be skipped.
                let mut square = lesser(nearest * nearest, self.blocks[beside].square([x, y]));
                // Nothing farther away along y than this can be nearer.
                let along = greater(square - along_x * along_x, 0.0).sqrt() + ROUNDING_NM;
                let [lowest, highest] = [y - along, y + along].map(block);
                for n in (lowest..beside).chain(beside + 1..highest + 1) {
                    let block = &self.blocks[n];
                    let [low, high] = block.range;
                    let dx = greater(greater(low - x, x - high), 0.0);
                    let start = first + edge * n as f64;
                    let dy = greater(greater(start - y, y - start - edge), 0.0);
                    if dx * dx + dy * dy <= square + ROUNDING_NM * (1.0 + square) {
                        square = lesser(square, block.square([x, y]));
                    }
                }
                square
            },
        );
        nearest.min(square.sqrt())
    }
}

/// Above this, the normal distribution and its integral are 1 and z to the last bit; below its negative, both are less than 1e-16.
const ALL_Z: f64 = 8.5;
/// Below the negative of this, the normal distribution is less than 1e-23.
const NO_Z: f64 = 10.0;

/// Standard normal cumulative distribution.
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

/// Standard normal cumulative distribution, but 0 where it is less than 1e-23: further than [`NO_Z`] below the mean.
pub fn normal_cdf_or_zero(z: f64) -> f64 {
    if z < -NO_Z { 0.0 } else { normal_cdf(z) }
}

/// Standard normal cumulative distribution, and its integral from minus infinity.
pub fn normal_cdf_and_integral(z: f64) -> [f64; 2] {
    if z > ALL_Z {
        return [1.0, z];
    }
    if z < -ALL_Z {
        return [0.0; 2];
    }
    let density = libm::exp(-0.5 * z * z) / libm::sqrt(TURN);
    let cdf = normal_cdf(z);
    [cdf, z * cdf + density]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::words;

    fn distance(line: &WavyLine, point: [f64; 2]) -> f64 {
        line.nearer(point, line.x(point[1]), f64::INFINITY)
    }

    const FIELD: Region = Region { x: [0.0, 100.0], y: [0.0, 80.0] };

    fn square_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
        let [d, q] = [[b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]];
        let t = ((d[0] * q[0] + d[1] * q[1]) / (d[0] * d[0] + d[1] * d[1])).clamp(0.0, 1.0);
        let (x, y) = (q[0] - t * d[0], q[1] - t * d[1]);
        x * x + y * y
    }

    #[test]
    fn the_amplitude_is_the_greatest_excursion() {
        for number in 0..20 {
            let line = WavyLine::new(40.0, 7.0, &FIELD, 12.0, 3, number);
            let all = (0..8000).map(|k| line.x(0.01 * f64::from(k)) - 40.0);
            let greatest = all.fold(0.0, |g: f64, e| g.max(e.abs()));
            assert!((greatest - 7.0).abs() < 1e-3, "{greatest}");
        }
        let straight = WavyLine::new(40.0, 0.0, &FIELD, 12.0, 3, 0);
        assert_eq!(straight.x(12.3), 40.0);
        assert_eq!(distance(&straight, [43.5, 20.0]), 3.5);
    }

    #[test]
    fn distances_are_those_of_a_fine_search() {
        let line = |[amplitude, number]: [u32; 2]| {
            WavyLine::new(40.0, f64::from(amplitude), &FIELD, 12.0, 5, number)
        };
        let lines = [[9, 1], [1, 2], [14, 3]].map(line);
        for (line, k) in lines.iter().flat_map(|line| (0..200u32).map(move |k| (line, k))) {
            let w = words(9, Purpose::Interface, 77, u64::from(k))
                .map(|w| f64::from(w) / 2f64.powi(32));
            let p = [20.0 + 40.0 * w[0], 10.0 + 60.0 * w[1]];
            let far = |y: f64| ((line.x(y) - p[0]).powi(2) + (y - p[1]).powi(2)).sqrt();
            let fine =
                (-1000..9000).map(|n| far(0.01 * f64::from(n))).fold(f64::INFINITY, f64::min);
            assert!((distance(line, p) - fine).abs() < 0.01, "{} {fine}", distance(line, p));
            // The segments and blocks that are skipped for speed never change the nearest distance, to the last bit.
            let across = (p[0] - line.x(p[1])).abs();
            let all = line.corners.windows(2).map(|s| square_to_segment(p, s[0], s[1]).sqrt());
            let all = all.fold(across, f64::min);
            assert_eq!(distance(line, p).to_bits(), all.to_bits());
            for known in [0.3 * all, all, 1.5 * all] {
                let found = line.nearer(p, line.x(p[1]), known);
                assert_eq!(found.to_bits(), all.min(known).to_bits());
            }
        }
    }

    #[test]
    fn the_normal_distribution_and_its_integral() {
        // Abramowitz and Stegun, table 26.1.
        assert!((normal_cdf(1.0) - 0.841_344_746).abs() < 1e-9);
        assert!((normal_cdf(-2.0) - 0.022_750_132).abs() < 1e-9);
        let numeric = |z: f64| {
            (0..40_000).map(|k| normal_cdf(z - 5e-4 - 1e-3 * f64::from(k)) * 1e-3).sum::<f64>()
        };
        for z in [-3.0, -0.4, 0.0, 2.5] {
            assert!((normal_cdf_and_integral(z)[1] - numeric(z)).abs() < 1e-6);
        }
        for z in (0..4000).map(|n| ALL_Z + 0.01 * f64::from(n)) {
            let density = libm::exp(-0.5 * z * z) / libm::sqrt(TURN);
            assert_eq!([1.0, z], [normal_cdf(z), z * normal_cdf(z) + density], "{z}");
            assert!(z < NO_Z || normal_cdf(-z) < 1e-23, "{z}");
            assert!(normal_cdf(-z) < 1e-16 && density - z * normal_cdf(-z) < 1e-16, "{z}");
        }
    }
}
