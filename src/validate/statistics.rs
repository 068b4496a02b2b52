//! Statistical tests.

use serde::Serialize;

use super::field_waves::FieldWaves;
use crate::rng::philox4x32_10;

/// Returns the probability that a normal variable lies further from its mean than `z` standard deviations, on either side.
pub(crate) fn two_sided(z: f64) -> f64 {
    libm::erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// A ratio of two sums over blocks: defects per site, intensity per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ratio {
    /// The ratio.
    pub value: f64,
    /// Its standard error, from the scatter of the blocks.
    pub error: f64,
}

impl Ratio {
    /// Computes the ratio from (numerator, denominator) of each block. Neighbouring sites are not independent (defects cluster, grains
    /// differ), but whole blocks nearly are, so that the error is right even then (W. G. Cochran, Sampling Techniques, 3rd ed. (1977), sec.
    /// 6.3).
    pub(crate) fn of_blocks(blocks: &[(f64, f64)]) -> Self {
        let n = blocks.len() as f64;
        let (top, bottom) = blocks.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
        let value = top / bottom;
        let square: f64 = blocks.iter().map(|b| (b.0 - value * b.1).powi(2)).sum();
        Ratio { value, error: (square * n / (n - 1.0)).sqrt() / bottom.abs() }
    }

    /// Returns the difference in standard errors; zero for equal values.
    pub(crate) fn z(self, other: Ratio, least_error: f64) -> f64 {
        let difference = self.value - other.value;
        match difference {
            0.0 => 0.0,
            d => d / self.error.hypot(other.error).max(least_error),
        }
    }
}

/// Returns the standard error of the difference of two rates of independent events, `a.0` of `a.1` and `b.0` of `b.1`.
pub(crate) fn binomial_error(a: (f64, f64), b: (f64, f64)) -> f64 {
    let rate = (a.0 + b.0) / (a.1 + b.1);
    (rate * (1.0 - rate) * (1.0 / a.1 + 1.0 / b.1)).sqrt()
}

/// Returns the probability that Student's t with `freedom` degrees of freedom lies further from 0 than `t`, on either side (M. Abramowitz
/// and I. A. Stegun, Handbook of Mathematical Functions (1964), 26.7.3 and 26.7.4).
pub(crate) fn student_two_sided(t: f64, freedom: usize) -> f64 {
    // Above this number the normal distribution is right to 1 % at 4 standard deviations.
    const MANY: usize = 2000;
    if freedom == 0 || freedom > MANY || !t.is_finite() {
        return two_sided(t);
    }
    let n = freedom as f64;
    let (angle, cosine) = ((t.abs() / n.sqrt()).atan(), (n / (n + t * t)).sqrt());
    let odd = freedom % 2 == 1;
    let mut term = if odd { cosine } else { 1.0 };
    let mut sum = if freedom == 1 { 0.0 } else { term };
    let mut k = if odd { 3 } else { 2 };
    while k < freedom {
        term *= cosine * cosine * (k - 1) as f64 / k as f64;
        sum += term;
        k += 2;
    }
    let within = match odd {
        true => std::f64::consts::FRAC_2_PI * (angle + angle.sin() * sum),
        false => angle.sin() * sum,
    };
    (1.0 - within).clamp(0.0, 1.0)
}

/// Returns the standard error of the difference of two ratios whose blocks lie at the same places of two fields, from the scatter of the
/// differences, block by block: features that both fields have at a place (a boundary, the lattice) are no scatter.
pub(crate) fn paired_error(a: &[(f64, f64)], b: &[(f64, f64)]) -> f64 {
    let residuals = |blocks: &[(f64, f64)]| {
        let (top, bottom) = blocks.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
        let of = move |b: &(f64, f64)| (b.0 - top / bottom * b.1) / bottom;
        blocks.iter().map(of).collect::<Vec<f64>>()
    };
    let n = a.len() as f64;
    let pairs = residuals(a).into_iter().zip(residuals(b));
    (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() * n / (n - 1.0)).sqrt()
}

/// Result of a Kolmogorov-Smirnov test of two samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Ks {
    /// Largest distance of the cumulative distributions.
    pub distance: f64,
    /// Share of random relabellings of the blocks whose distance is at least as large.
    pub p: f64,
}

/// A sample: the block and the value of each item.
pub(crate) type Sample = [(u32, f32)];

/// Correspondence of the blocks of two worlds.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Places<'a> {
    /// Blocks lie at the same places in both worlds: features that both have there (a boundary, an edge, the lattice) are no difference.
    /// The waves over the field show how far worlds of one kind differ.
    Same(&'a FieldWaves),
    /// Blocks lie anywhere; the numbers of blocks in each world. Any blocks may be exchanged.
    Any([usize; 2]),
}

/// Number of classes that values are sorted into.
const CLASSES: usize = 400;
/// Largest number of relabellings; fewer are made once [`ENOUGH`] of them were at least as far apart as the samples (J. Besag and P.
/// Clifford, Biometrika 78 (1991) 301).
const RELABELLINGS: u32 = 99_999;
const ENOUGH: u32 = 200;

/// Returns the share of relabellings whose statistic is at least `found`.
pub(super) fn share(found: f64, mut statistic: impl FnMut(u32) -> f64) -> f64 {
    let mut larger = 0;
    for n in 0..RELABELLINGS {
        larger += u32::from(statistic(n) >= found - 1e-12);
        if larger == ENOUGH {
            return f64::from(larger) / f64::from(n + 1);
        }
    }
    f64::from(larger + 1) / f64::from(RELABELLINGS + 1)
}

/// Computes the Kolmogorov-Smirnov distance of two samples. Its significance comes from the waves over the field, or from exchanging whole
/// blocks between the samples, since items of a block are not independent.
///
/// Values are sorted into 400 classes that hold equal shares of both samples together.
pub(crate) fn kolmogorov_smirnov(a: &Sample, b: &Sample, places: Places) -> Ks {
    let edges = edges(a, b);
    if a.is_empty() || b.is_empty() || edges.is_empty() {
        let distance = if a.is_empty() == b.is_empty() { 0.0 } else { 1.0 };
        return Ks { distance, p: if distance == 0.0 { 1.0 } else { 0.0 } };
    }
    let count = |sample: &Sample, blocks: usize| {
        let mut table = vec![[0.0_f64; CLASSES + 1]; blocks];
        let class = |v: f32| edges.partition_point(|e| *e < v);
        sample.iter().for_each(|(block, v)| table[*block as usize][class(*v)] += 1.0);
        table
    };
    match places {
        Places::Same(waves) => {
            at_places(count(a, waves.places()), &count(b, waves.places()), waves)
        }
        Places::Any([first, second]) => among_all(count(a, first), count(b, second)),
    }
}

/// Number of values of each class in a block.
type ClassCounts = [f64; CLASSES + 1];

/// Sums the differences of the cumulative distributions over all places, and compares the sum with the waves over the field.
fn at_places(mut a: Vec<ClassCounts>, b: &[ClassCounts], waves: &FieldWaves) -> Ks {
    let total = |t: &[ClassCounts]| t.iter().flatten().sum::<f64>();
    let (all_a, all_b) = (total(&a), total(b));
    for (a, b) in a.iter_mut().zip(b) {
        let mut sum = 0.0;
        for (a, b) in a.iter_mut().zip(b) {
            sum += *a / all_a - b / all_b;
            *a = sum;
        }
    }
    let (distance, p) = waves.largest(&a);
    Ks { distance, p }
}

/// Compares the distance of the samples with the distances after random exchanges of blocks.
fn among_all(mut table: Vec<ClassCounts>, mut other: Vec<ClassCounts>) -> Ks {
    let filled = |counts: &ClassCounts| counts.iter().any(|c| *c > 0.0);
    table.retain(filled);
    other.retain(filled);
    let first = table.len();
    table.append(&mut other);
    let mut total = [0.0; CLASSES + 1];
    table.iter().for_each(|t| total.iter_mut().zip(t).for_each(|(s, v)| *s += v));
    let mut order: Vec<usize> = (0..table.len()).collect();
    let distance = |order: &[usize]| {
        let mut part = [0.0; CLASSES + 1];
        for &i in &order[..first] {
            part.iter_mut().zip(&table[i]).for_each(|(s, v)| *s += v);
        }
        largest_gap(&part, &total)
    };
    let found = distance(&order);
    let p = share(found, |n| {
        shuffle(&mut order, n);
        distance(&order)
    });
    Ks { distance: found, p }
}

/// Returns the edges of classes that hold equal shares of the pooled values.
fn edges(a: &Sample, b: &Sample) -> Vec<f32> {
    let mut pooled: Vec<f32> =
        a.iter().chain(b).map(|(_, v)| *v).filter(|v| v.is_finite()).collect();
    pooled.sort_unstable_by(f32::total_cmp);
    let mut edges: Vec<f32> =
        (1..CLASSES).filter_map(|i| pooled.get(i * pooled.len() / CLASSES).copied()).collect();
    edges.dedup();
    edges
}

/// Returns the largest distance between the cumulative distributions of a part and of the rest.
fn largest_gap(part: &[f64], total: &[f64]) -> f64 {
    let (n, all): (f64, f64) = (part.iter().sum(), total.iter().sum());
    if n == 0.0 || n == all {
        return 0.0;
    }
    let (mut left, mut right, mut gap) = (0.0, 0.0, 0.0_f64);
    for (p, t) in part.iter().zip(total) {
        left += p / n;
        right += (t - p) / (all - n);
        gap = gap.max((left - right).abs());
    }
    gap
}

/// Shuffles by Fisher and Yates with counter-based random numbers: a permutation number always gives the same order.
fn shuffle(order: &mut [usize], permutation: u32) {
    for i in (1..order.len()).rev() {
        let word = philox4x32_10([i as u32, permutation, 0, 0], [0x5374_656d, 0x4b53]);
        let random = u64::from(word[0]) << 32 | u64::from(word[1]);
        let j = (u128::from(random) * (i as u128 + 1)) >> 64;
        order.swap(i, j as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANY: Places = Places::Any([60, 60]);

    /// Uniform numbers in [0, 1).
    fn noise(n: usize, seed: u32) -> Vec<f32> {
        let word = |i: usize| philox4x32_10([i as u32, 0, 0, 0], [seed, 7])[0];
        (0..n).map(|i| (f64::from(word(i)) / 4_294_967_296.0) as f32).collect()
    }

    fn sample(values: Vec<f32>, per_block: usize) -> Vec<(u32, f32)> {
        values.into_iter().enumerate().map(|(i, v)| ((i / per_block) as u32, v)).collect()
    }

    #[test]
    fn the_normal_distribution_is_that_of_the_tables() {
        for (z, p) in [(1.959_964, 0.05), (2.575_829, 0.01), (3.290_527, 0.001), (0.0, 1.0)] {
            assert!((two_sided(z) - p).abs() < 1e-6, "{z}: {}", two_sided(z));
        }
    }

    #[test]
    fn the_error_of_a_ratio_is_that_of_repeated_samples() {
        // In 100 blocks of 50 trials of probability 0.3 the rate scatters by sqrt(0.3 0.7 / 5000).
        let expected = (0.3_f64 * 0.7 / 5000.0).sqrt();
        let of = |seed| {
            let draws = noise(5000, seed);
            let count = |b: &[f32]| b.iter().filter(|v| **v < 0.3).count() as f64;
            Ratio::of_blocks(&draws.chunks(50).map(|b| (count(b), 50.0)).collect::<Vec<_>>())
        };
        let all: Vec<Ratio> = (0..200).map(of).collect();
        let mean = all.iter().map(|r| r.error).sum::<f64>() / 200.0;
        assert!((mean / expected - 1.0).abs() < 0.03, "{mean} {expected}");
        let large = all.windows(2).filter(|w| two_sided(w[0].z(w[1], 0.0)) < 0.05).count();
        assert!((2..=20).contains(&large), "about 5 % of 199: {large}");
        assert!((binomial_error((300.0, 1000.0), (300.0, 1000.0)) - 0.0205).abs() < 1e-4);
    }

    #[test]
    fn equal_distributions_are_equal_and_others_are_not() {
        let (a, b) = (sample(noise(3000, 1), 50), sample(noise(3000, 2), 50));
        let same = kolmogorov_smirnov(&a, &b, ANY);
        assert!(same.p > 0.01 && same.distance < 0.05, "{same:?}");
        assert_eq!(kolmogorov_smirnov(&a, &a, ANY).p, 1.0);
        let moved = sample(noise(3000, 2).iter().map(|v| v + 0.1).collect(), 50);
        let moved = kolmogorov_smirnov(&a, &moved, ANY);
        assert!(moved.p < 2e-5 && (moved.distance - 0.1).abs() < 0.03, "{moved:?}");
        assert_eq!(kolmogorov_smirnov(&a, &[], ANY).p, 0.0);
    }

    /// Values are equal within a block: the textbook formula takes 3000 items as independent and finds a difference; exchanging blocks does
    /// not.
    #[test]
    fn blocks_keep_dependent_values_together() {
        let blocky = |seed| {
            let levels = noise(60, seed);
            sample((0..3000).map(|i| levels[i / 50]).collect(), 50)
        };
        let mut found = 0;
        for seed in 0..20 {
            let ks = kolmogorov_smirnov(&blocky(2 * seed + 1), &blocky(2 * seed + 2), ANY);
            found += u32::from(ks.p < 0.05);
            let effective: f64 = 1500.0;
            if seed == 0 {
                let textbook = 2.0 * (-2.0 * (effective.sqrt() * ks.distance).powi(2)).exp();
                assert!(textbook < 0.01, "{textbook} {ks:?}");
            }
        }
        assert!(found <= 4, "{found} of 20");
    }

    #[test]
    fn student_is_that_of_the_tables() {
        for (t, freedom, p) in [
            (12.706, 1, 0.05),
            (4.303, 2, 0.05),
            (2.228, 10, 0.05),
            (3.355, 8, 0.01),
            (1.9693, 255, 0.05),
        ] {
            let found = student_two_sided(t, freedom);
            assert!((found - p).abs() < 1e-4, "{t}, {freedom}: {found}");
        }
        assert!(student_two_sided(0.0, 7) == 1.0 && student_two_sided(40.0, 8) < 1e-9);
    }
}
