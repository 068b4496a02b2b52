//! Arrays that start on a cache line, and complex numbers seen as floats.

use num_complex::Complex32;
use std::ops::{Deref, DerefMut};

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct CacheLine([Complex32; 8]);

/// A buffer of complex numbers that starts on a cache line.
#[derive(Clone)]
pub(crate) struct Buffer {
    lines: Vec<CacheLine>,
}

impl Buffer {
    /// `len` zeros (rounded up to whole cache lines).
    pub(crate) fn zeros(len: usize) -> Self {
        Buffer { lines: vec![CacheLine([Complex32::ZERO; 8]); len.div_ceil(8)] }
    }
}

impl Deref for Buffer {
    type Target = [Complex32];
    fn deref(&self) -> &[Complex32] {
        // SAFETY: CacheLine is repr(C) of eight Complex32, without padding.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * 8) }
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [Complex32] {
        // SAFETY: as in `deref`.
        unsafe {
            std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * 8)
        }
    }
}

/// Real and imaginary parts in turn.
pub(super) fn floats(data: &mut [Complex32]) -> &mut [f32] {
    // SAFETY: Complex32 is repr(C) of two f32.
    unsafe { std::slice::from_raw_parts_mut(data.as_mut_ptr().cast(), data.len() * 2) }
}

/// Real and imaginary parts in turn, to read.
pub(super) fn const_floats(data: &[Complex32]) -> &[f32] {
    // SAFETY: Complex32 is repr(C) of two f32.
    unsafe { std::slice::from_raw_parts(data.as_ptr().cast(), data.len() * 2) }
}
