//! Tests whether the means of two fields differ by more than chance, where neighbouring parts of a field are not independent: the mean
//! difference is compared with slow waves over the field.
//!
//! Random differences that vary over less than half a wave contribute as much to each of the slow waves as to the mean. So the power of the
//! waves is the variance of the mean (U. K. Muller, Econometrica 72 (2004) 3055; E. Lazarus, D. Lewis, J. Stock and M. Watson, J. Bus.
//! Econ. Stat. 36 (2018) 541), and the mean divided by the root of that power is distributed like Student's t. The scatter of single blocks
//! would give too small an error where their contents are correlated over several blocks. For the largest of several numbers, mean and
//! waves are rotated into each other at random (O. Langsrud, Stat. Comput. 15 (2005) 53); for a single number that is the test by Student's
//! t.

use super::statistics::{Ratio, share, student_two_sided};
use crate::rng::philox4x32_10;

/// Cosine waves over the places of a field: its rows and columns of blocks.
#[derive(Debug, Clone)]
pub(crate) struct FieldWaves {
    places: usize,
    /// Values of each wave at all places; their mean square is 1 and their mean 0.
    waves: Vec<Vec<f64>>,
}

/// A difference of two means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MeanDifference {
    /// The difference.
    pub value: f64,
    /// Standard error of the difference.
    pub error: f64,
    /// The difference in standard errors.
    pub t: f64,
    /// Probability of a difference at least as large between fields of one kind.
    pub p: f64,
}

impl FieldWaves {
    /// Makes the waves over `rows` x `columns` places: `down` waves along y times `across` along x, the constant one included.
    pub(crate) fn new([rows, columns]: [usize; 2], [down, across]: [usize; 2]) -> Self {
        let wave = |m: usize, i: usize, n: usize| match m {
            0 => 1.0,
            _ => {
                let turn = std::f64::consts::PI * m as f64 * (i as f64 + 0.5) / n as f64;
                std::f64::consts::SQRT_2 * libm::cos(turn)
            }
        };
        let (down, across) = (down.min(rows), across.min(columns));
        let all = (0..down).flat_map(|k| (0..across).map(move |l| (k, l))).skip(1);
        let places = || (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x)));
        let of = |(k, l): (usize, usize)| {
            places().map(|(y, x)| wave(k, y, rows) * wave(l, x, columns)).collect()
        };
        FieldWaves { places: rows * columns, waves: all.map(of).collect() }
    }

    /// Number of places.
    pub(crate) fn places(&self) -> usize {
        self.places
    }

    /// Number of waves.
    pub(crate) fn count(&self) -> usize {
        self.waves.len()
    }

    /// Returns the difference of two ratios of sums over the same places.
    pub(crate) fn difference(&self, a: &[(f64, f64)], b: &[(f64, f64)]) -> MeanDifference {
        let residuals = |blocks: &[(f64, f64)]| {
            let (top, bottom) = blocks.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
            let of = move |b: &(f64, f64)| (b.0 - top / bottom * b.1) / bottom;
            blocks.iter().map(of).collect::<Vec<f64>>()
        };
        let value = Ratio::of_blocks(a).value - Ratio::of_blocks(b).value;
        let differences: Vec<f64> =
            residuals(a).into_iter().zip(residuals(b)).map(|(a, b)| a - b).collect();
        let amplitude =
            |wave: &Vec<f64>| wave.iter().zip(&differences).map(|(w, d)| w * d).sum::<f64>();
        let power: f64 = self.waves.iter().map(|w| amplitude(w).powi(2)).sum();
        let error = (power / self.count() as f64).sqrt();
        let t = if value == 0.0 { 0.0 } else { value / error };
        MeanDifference { value, error, t, p: student_two_sided(t, self.count()) }
    }

    /// Returns the largest of several sums over all places, and the share of random rotations of sum and waves with a sum at least as
    /// large. `values` holds a row for each place.
    pub(crate) fn largest<R: AsRef<[f64]>>(&self, values: &[R]) -> (f64, f64) {
        let amplitudes = self.amplitudes(values);
        let largest = |sums: &[f64]| sums.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let found = largest(&amplitudes[0]);
        if found == 0.0 {
            return (0.0, 1.0);
        }
        let mut sums = vec![0.0; amplitudes[0].len()];
        let p = share(found, |n| {
            sums.fill(0.0);
            for (weight, row) in direction(amplitudes.len(), n).into_iter().zip(&amplitudes) {
                sums.iter_mut().zip(row).for_each(|(s, v)| *s += weight * v);
            }
            largest(&sums)
        });
        (found, p)
    }

    /// Returns the largest sum in units of its standard error, and its share of random rotations.
    pub(crate) fn largest_in_errors(&self, values: &[Vec<f64>]) -> (f64, f64) {
        let amplitudes = self.amplitudes(values);
        let columns = amplitudes[0].len();
        let power = |c: usize| amplitudes.iter().map(|a| a[c] * a[c]).sum::<f64>();
        let scale: Vec<f64> = (0..columns).map(|c| 1.0 / power(c).sqrt()).collect();
        let scaled = |row: &Vec<f64>| -> Vec<f64> {
            let usable = row.iter().zip(&scale).filter(|(_, s)| s.is_finite());
            usable.map(|(v, s)| v * s).collect()
        };
        let (share_of_power, p) = self.largest(&values.iter().map(scaled).collect::<Vec<_>>());
        // Converts a share of the power in sum and waves to standard errors, with the error from the waves.
        let left = 1.0 - share_of_power * share_of_power;
        (share_of_power * (self.count() as f64 / left.max(f64::MIN_POSITIVE)).sqrt(), p)
    }

    /// Returns the sums over all places, and the sums with the weights of each wave.
    fn amplitudes<R: AsRef<[f64]>>(&self, values: &[R]) -> Vec<Vec<f64>> {
        let columns = values.first().map_or(0, |v| v.as_ref().len());
        let mut amplitudes = vec![vec![0.0; columns]; 1 + self.count()];
        for (place, row) in values.iter().enumerate() {
            for (i, sums) in amplitudes.iter_mut().enumerate() {
                let weight = if i == 0 { 1.0 } else { self.waves[i - 1][place] };
                sums.iter_mut().zip(row.as_ref()).for_each(|(s, v)| *s += weight * v);
            }
        }
        amplitudes
    }
}

/// Returns a random direction in `dimensions` dimensions.
fn direction(dimensions: usize, number: u32) -> Vec<f64> {
    let unit = |word: u32| (f64::from(word) + 0.5) / 4_294_967_296.0;
    let pair = |i: u32| {
        let w = philox4x32_10([i, number, 2, 0], [0x5374_656d, 0x4b53]);
        let (radius, turn) = (libm::sqrt(-2.0 * libm::log(unit(w[0]))), unit(w[1]));
        let angle = 2.0 * std::f64::consts::PI * turn;
        [radius * libm::cos(angle), radius * libm::sin(angle)]
    };
    let mut normals: Vec<f64> = (0..dimensions.div_ceil(2) as u32).flat_map(pair).collect();
    normals.truncate(dimensions);
    let length = normals.iter().map(|v| v * v).sum::<f64>().sqrt();
    normals.iter_mut().for_each(|v| *v /= length);
    normals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::validate::statistics::{Places, kolmogorov_smirnov, paired_error};

    const SIDE: usize = 12;

    /// Uniform numbers in [0, 1).
    fn noise(n: usize, seed: u32) -> Vec<f64> {
        let word = |i: usize| philox4x32_10([i as u32, 0, 0, 0], [seed, 7])[0];
        (0..n).map(|i| f64::from(word(i)) / 4_294_967_296.0).collect()
    }

    /// Correlated contribution of places, a moving mean over `over` places along y, with a variance of 1/12.
    fn common(seed: u32, over: usize) -> Vec<f64> {
        let own = noise((SIDE + over) * SIDE, seed);
        let mean = |y: usize, x: usize| {
            (0..over).map(|k| own[(y + k) * SIDE + x] - 0.5).sum::<f64>() / (over as f64).sqrt()
        };
        (0..SIDE * SIDE).map(|i| mean(i / SIDE, i % SIDE)).collect()
    }

    /// 20 columns at each of 144 places. Every other place is brighter by `brighter` in all worlds, as at a boundary; the correlated
    /// contribution scatters from world to world.
    fn world(seed: u32, over: usize, brighter: f64) -> Vec<(u32, f32)> {
        let (common, own) = (common(seed, over), noise(SIDE * SIDE * 20, seed + 10_000));
        let value = |i: usize| {
            let place = i / 20;
            let boundary = if place.is_multiple_of(2) { 1.2 } else { 1.0 };
            let scatter = 0.1 * common[place] + 0.2 * own[i];
            (place as u32, (brighter * (boundary + scatter)) as f32)
        };
        (0..SIDE * SIDE * 20).map(value).collect()
    }

    fn sums(world: &[(u32, f32)]) -> Vec<(f64, f64)> {
        let mut sums = vec![(0.0, 0.0); SIDE * SIDE];
        for (place, v) in world {
            let sum = &mut sums[*place as usize];
            *sum = (sum.0 + f64::from(*v), sum.1 + 1.0);
        }
        sums
    }

    fn tests(waves: &FieldWaves, a: &[(u32, f32)], b: &[(u32, f32)]) -> [f64; 3] {
        let (of_a, of_b) = (sums(a), sums(b));
        let pairs = of_a.iter().zip(&of_b);
        let rows: Vec<Vec<f64>> =
            pairs.map(|(a, b)| vec![a.0 - b.0, a.0 * a.0 - b.0 * b.0]).collect();
        [
            waves.difference(&of_a, &of_b).p,
            kolmogorov_smirnov(a, b, Places::Same(waves)).p,
            waves.largest_in_errors(&rows).1,
        ]
    }

    /// Probabilities are uniform between worlds of one kind, also where neighbouring places are strongly correlated: 3 % are called
    /// different, and 6 % where fewer places are independent.
    #[test]
    fn worlds_of_one_kind_are_called_different_at_the_rate_asked_for() {
        for (over, waves, brighter) in [(1, [5, 5], 1.03), (4, [2, 5], 1.06)] {
            let waves = FieldWaves::new([SIDE, SIDE], waves);
            let pair = |n: u32| [world(2 * n + 1, over, 1.0), world(2 * n + 2, over, 1.0)];
            let all: Vec<[f64; 3]> =
                (0..120).map(pair).map(|[a, b]| tests(&waves, &a, &b)).collect();
            for test in 0..3 {
                let p = || all.iter().map(|p| p[test]);
                let mean = p().sum::<f64>() / 120.0;
                let below = |limit: f64| p().filter(|p| *p < limit).count();
                println!("{over} {test}: {mean}, {}, {}", below(0.05), below(0.5));
                // A uniform number has mean 0.5 with an error of 0.026; 6 of 120 lie below 0.05, with an error of 2.4.
                assert!((mean - 0.5).abs() < 0.09, "{over}, test {test}: {mean}");
                assert!((1..=14).contains(&below(0.05)), "{over}, test {test}: {}", below(0.05));
                assert!((42..=78).contains(&below(0.5)), "{over}, test {test}: {}", below(0.5));
            }
            for p in tests(&waves, &world(1, over, 1.0), &world(2, over, brighter)) {
                assert!(p < 5e-3, "{p}");
            }
        }
    }

    /// Correlated contributions make errors from the scatter of single blocks too small; waves correct this fault.
    #[test]
    fn single_blocks_take_what_gathers_for_a_difference() {
        let waves = FieldWaves::new([SIDE, SIDE], [2, 5]);
        let (mut below, mut squares) = (0, [0.0; 3]);
        for n in 0..120 {
            let [a, b] = [1, 2].map(|k| sums(&world(2 * n + k, 4, 1.0)));
            let (of_blocks, of_waves) = (paired_error(&a, &b), waves.difference(&a, &b));
            let t = of_waves.value / of_blocks;
            below += usize::from(student_two_sided(t, SIDE * SIDE - 1) < 0.05);
            let all = [of_waves.value, of_waves.error, of_blocks];
            squares.iter_mut().zip(all).for_each(|(s, v)| *s += v * v);
        }
        assert!(below > 20, "{below} of 120");
        // Reference: the scatter of the differences themselves, which 120 worlds give to 6.5 %.
        let [_, by_waves, by_blocks] = squares.map(|s| (s / squares[0]).sqrt());
        println!(
            "errors told, in units of the scatter: {by_waves} by waves, {by_blocks} by blocks"
        );
        assert!((0.75..1.25).contains(&by_waves) && by_blocks < 0.75, "{by_waves} {by_blocks}");
    }

    /// For a single number, random rotation is Student's test.
    #[test]
    fn turning_one_number_is_the_test_of_student() {
        let waves = FieldWaves::new([4, 4], [2, 3]);
        let values: Vec<Vec<f64>> = noise(16, 3).iter().map(|v| vec![v - 0.4]).collect();
        let blocks = |shift: f64| -> Vec<(f64, f64)> {
            values.iter().map(|v| (shift + v[0], 1.0)).collect()
        };
        let expected = waves.difference(&blocks(0.0), &[(0.0, 1.0); 16]);
        let (found, p) = waves.largest_in_errors(&values);
        assert!((found / expected.t.abs() - 1.0).abs() < 1e-9, "{found} {expected:?}");
        assert!((p / expected.p - 1.0).abs() < 0.3, "{p} {expected:?}");
        assert_eq!(waves.count(), 5);
    }
}
