//! Lengths that transform fast, and the frequencies of their bins.

/// The signed frequency index of bin `i` of `n` in FFT order: 0, 1, ..., -2, -1.
pub(crate) fn frequency(i: usize, n: usize) -> i64 {
    if i < n.div_ceil(2) { i as i64 } else { i as i64 - n as i64 }
}

/// The smallest fast length that is at least `min`: `multiple` times a product of 2s, 3s and at most one 5
/// (rows of 625 = 5^4 run at half the speed of 640).
pub(crate) fn good_size(min: usize, multiple: usize) -> usize {
    let smooth = |mut n: usize| {
        for p in [2, 3] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1 || n == 5
    };
    let first = min.max(1).next_multiple_of(multiple);
    (0..).map(|i| first + i * multiple).find(|&n| smooth(n / multiple)).unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn good_sizes() {
        assert_eq!(good_size(625, 1), 640);
        assert_eq!(good_size(641, 1), 648);
        assert_eq!(good_size(751, 4), 768);
        assert_eq!(good_size(751, 7), 756);
    }
}
