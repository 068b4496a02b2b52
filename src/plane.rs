//! Arithmetic of pairs: vectors (x, y), and (row, column). Each function works along both axes, with one rounding for each operation.

use std::ops::{Add, Div, Mul, Sub};

/// Combines the values of two pairs along each axis.
#[inline]
pub(crate) fn per_axis<A, B, C>(a: [A; 2], b: [B; 2], mut of: impl FnMut(A, B) -> C) -> [C; 2] {
    let ([a0, a1], [b0, b1]) = (a, b);
    [of(a0, b0), of(a1, b1)]
}

/// Sum `a + b`.
#[inline]
pub(crate) fn add<T: Add<Output = T>>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::add)
}

/// Difference `a - b`.
#[inline]
pub(crate) fn sub<T: Sub<Output = T>>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::sub)
}

/// Product along each axis.
#[inline]
pub(crate) fn mul<T: Mul<Output = T>>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::mul)
}

/// Quotient along each axis.
#[inline]
pub(crate) fn div<T: Div<Output = T>>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::div)
}

/// The smaller value along each axis.
#[inline]
pub(crate) fn min<T: Ord>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::min)
}

/// The larger value along each axis.
#[inline]
pub(crate) fn max<T: Ord>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    per_axis(a, b, T::max)
}

/// Turns (row, column) into (x, y), and back.
pub(crate) fn swapped<T>([first, second]: [T; 2]) -> [T; 2] {
    [second, first]
}
