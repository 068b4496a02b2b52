//! The Bessel function J0 from a table: the radial integrals of atoms need millions of values for each element.

use std::sync::OnceLock;

/// Distance of the table's points.
const STEP: f64 = 0.05;
/// Largest argument in the table.
const END: f64 = 2600.0;

/// J0 and its derivative times [`STEP`], at multiples of [`STEP`].
fn table() -> &'static [[f64; 2]] {
    static TABLE: OnceLock<Vec<[f64; 2]>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let point = |i: usize| {
            let x = i as f64 * STEP;
            [libm::j0(x), -STEP * libm::j1(x)]
        };
        (0..(END / STEP) as usize + 2).map(point).collect()
    })
}

/// J0 at any argument of at least 0, to 2e-8: cubic Hermite interpolation.
pub struct J0(&'static [[f64; 2]]);

impl J0 {
    pub fn new() -> Self {
        J0(table())
    }

    #[inline]
    pub fn at(&self, x: f64) -> f64 {
        let place = x / STEP;
        let i = place as usize;
        let Some(&[[a, da], [b, db]]) = self.0.get(i..i + 2).and_then(|p| p.first_chunk()) else {
            return libm::j0(x);
        };
        let t = place - i as f64;
        let bend = 2.0 * (a - b) + da + db;
        let rise = 3.0 * (b - a) - 2.0 * da - db;
        a + t * (da + t * (rise + t * bend))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_libm() {
        let j0 = J0::new();
        let worst = (0..400_000)
            .map(|i| f64::from(i) * 0.007_13)
            .map(|x| (j0.at(x) - libm::j0(x)).abs())
            .fold(0.0, f64::max);
        assert!(worst < 2e-8, "{worst}");
        assert_eq!(j0.at(0.0), 1.0);
    }
}
