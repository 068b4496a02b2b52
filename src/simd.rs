//! Plain loops for the vector units of the machine at hand.

/// Runs `f` compiled for the widest vectors the machine has. Mark the closure `#[inline(always)]`, or its loops are compiled
/// for the least machine. Its kind is FnOnce by this signature: the shim around others would not be inlined.
#[inline(always)]
pub(crate) fn vectorised<R>(f: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(f)
}
