//! Percentiles of the values of an image.

/// Percentiles (0 to 100) of some finite values, interpolated between neighbours; changes their order. Not for an empty list.
pub(super) fn percentiles<const N: usize>(values: &mut [f64], wanted: [f64; N]) -> [f64; N] {
    wanted.map(|percent| {
        let place = percent.clamp(0.0, 100.0) * 0.01 * (values.len() - 1) as f64;
        let below = place.floor() as usize;
        let (_, low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
        let low = *low;
        let high = above.iter().copied().fold(f64::INFINITY, f64::min);
        let share = place - below as f64;
        if share > 0.0 && high.is_finite() { low + share * (high - low) } else { low }
    })
}

#[cfg(test)]
mod tests {
    use super::percentiles;

    #[test]
    fn percentiles_are_those_of_numpy() {
        // numpy.percentile([5, 1, 4, 2], [0, 25, 50, 99.9, 100])
        let found = percentiles(&mut [5.0, 1.0, 4.0, 2.0], [0.0, 25.0, 50.0, 99.9, 100.0]);
        for (found, expected) in found.iter().zip([1.0, 1.75, 3.0, 4.997, 5.0]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert_eq!(percentiles(&mut [7.0], [50.0]), [7.0]);
    }
}
