//! Complex numbers are worked out in double precision and kept in single precision.

use num_complex::{Complex32, Complex64};

/// Rounds to single precision.
pub(super) fn single(c: Complex64) -> Complex32 {
    Complex32::new(c.re as f32, c.im as f32)
}
