//! Compiles plain loops for the vector units of the machine that runs them.

/// Runs `f` compiled for the widest vectors that the machine has. The closure must be marked `#[inline(always)]`; otherwise its loops are
/// compiled for the oldest supported machine. So is what an iterator in the closure collects: write a loop. `f` is FnOnce since the shim
/// around Fn closures would not be inlined.
#[inline(always)]
pub(crate) fn vectorised<R>(f: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(f)
}

/// Returns the lesser number. `f64::min` takes more instructions, since it handles NaN.
#[inline(always)]
pub(crate) fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Returns the greater number; faster than `f64::max` (see [`lesser`]).
#[inline(always)]
pub(crate) fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
