//! Rounds complex numbers from double precision, in which they are computed, to single precision, in which they are stored.

use num_complex::{Complex32, Complex64};

/// Rounds to single precision.
pub(super) fn single(c: Complex64) -> Complex32 {
    Complex32::new(c.re as f32, c.im as f32)
}
