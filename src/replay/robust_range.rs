//! Computes percentiles of values, for example of an image.

use rayon::prelude::*;

/// Number of bits of a value that one pass over the image determines.
const DIGIT_BITS: u32 = 16;
/// Least number of values that one thread counts.
const LEAST_AT_ONCE: usize = 1 << 20;

/// Computes percentiles (0 to 100) of the finite values, interpolated between neighbours; `None` if there are none.
///
/// The values are not copied, which would take as much memory again: the value of a rank is found digit by digit, by counting.
pub(super) fn percentiles<const N: usize>(values: &[f64], wanted: [f64; N]) -> Option<[f64; N]> {
    let count = values.iter().filter(|v| v.is_finite()).count();
    let last = count.checked_sub(1)?;
    Some(wanted.map(|percent| {
        let place = percent.clamp(0.0, 100.0) * 0.01 * last as f64;
        let below = place.floor() as usize;
        let low = of_rank(values, below);
        let share = place - below as f64;
        if share > 0.0 && below < last {
            low + share * (of_rank(values, below + 1) - low)
        } else {
            low
        }
    }))
}

/// Returns the finite value of a rank: the number of smaller values before it in order.
fn of_rank(values: &[f64], rank: usize) -> f64 {
    let (mut prefix, mut left) = (0_u64, rank);
    for settled in (0..64).step_by(DIGIT_BITS as usize) {
        let shift = 64 - DIGIT_BITS - settled;
        let none = || vec![0_usize; 1 << DIGIT_BITS];
        let add = |mut counts: Vec<usize>, value: &f64| {
            let key = key(*value);
            if value.is_finite() && (settled == 0 || key >> (64 - settled) == prefix) {
                counts[(key >> shift) as usize & ((1 << DIGIT_BITS) - 1)] += 1;
            }
            counts
        };
        let both = |a: Vec<usize>, b: Vec<usize>| a.iter().zip(&b).map(|(a, b)| a + b).collect();
        let counts =
            values.par_iter().with_min_len(LEAST_AT_ONCE).fold(none, add).reduce(none, both);
        let mut digit = 0;
        while left >= counts[digit] {
            left -= counts[digit];
            digit += 1;
        }
        prefix = prefix << DIGIT_BITS | digit as u64;
    }
    value(prefix)
}

const SIGN: u64 = 1 << 63;

/// Converts a value to a whole number with the same order.
fn key(value: f64) -> u64 {
    // Both zeros become one value.
    let bits = (value + 0.0).to_bits();
    if bits & SIGN == 0 { bits | SIGN } else { !bits }
}

/// Converts such a number back to its value.
fn value(key: u64) -> f64 {
    f64::from_bits(if key & SIGN == 0 { !key } else { key & !SIGN })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_numpy() {
        // Values of numpy.percentile([5, 1, 4, 2], [0, 25, 50, 99.9, 100]).
        let found =
            percentiles(&[5.0, 1.0, f64::NAN, 4.0, 2.0], [0.0, 25.0, 50.0, 99.9, 100.0]).unwrap();
        for (found, expected) in found.iter().zip([1.0, 1.75, 3.0, 4.997, 5.0]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert_eq!(percentiles(&[7.0], [50.0]), Some([7.0]));
        assert_eq!(percentiles(&[f64::NAN, f64::INFINITY], [50.0]), None);
    }

    #[test]
    fn ranks_are_those_of_sorted_values() {
        let mut values = vec![0.0, -0.0, -1e-300, 1e300, -7.5, -7.25, 3.0, 3.0, f64::MIN, 5e-324];
        let unsorted = values.clone();
        values.sort_by(|a, b| a.partial_cmp(b).unwrap());
        for (rank, expected) in values.iter().enumerate() {
            assert_eq!(of_rank(&unsorted, rank), *expected, "{rank}");
        }
    }
}
