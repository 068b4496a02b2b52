//! Fourier transforms down the columns of a matrix, one SIMD lane per column.
//!
//! As many columns as the vector unit has lanes are transformed together, without transposes. The first pass
//! reads them from the matrix and the last writes them back; the passes between work in cache.

use super::band_limit::BandLimitedMultiplier;
use super::butterfly::{Lanes, mul, splat};
use super::passes::{Middle, RadixPasses, by_radix};
use super::radix_plan::{RadixPlan, lanes};
use super::tile;
use num_complex::Complex32;
use pulp::{Arch, Simd, WithSimd};
use std::ops::{DerefMut, Range};

/// The plan for columns of `n` rows.
#[derive(Debug, Clone)]
pub struct ColumnPlan {
    plan: RadixPlan,
}

impl ColumnPlan {
    /// A plan for `n` rows, or `None` when [`RadixPlan`] cannot have one.
    pub fn new(n: usize) -> Option<Self> {
        Some(ColumnPlan { plan: RadixPlan::new(n)? })
    }

    /// Number of `f32` that the scratch of every call must have room for.
    pub fn scratch_len(&self) -> usize {
        // Room for a block of columns, and for the block of the multiplier.
        2 * self.plan.points() * 2 * lanes()
    }

    /// Frequency index found at each position after the forward passes.
    pub fn order(&self) -> &[usize] {
        self.plan.order()
    }

    /// Forward transform of `columns` of every wave (rows of length `stride`), multiplication, inverse transform; unnormalised. The range
    /// is rounded up to whole vectors, so rows must be padded ([`lanes`]). The multiplier is computed once for all waves.
    ///
    /// # Panics
    /// If the rounded columns do not lie within the rows, or the multiplier is for arrays of another shape.
    pub fn convolve<W: DerefMut<Target = [Complex32]>>(
        &self,
        waves: &mut [W],
        stride: usize,
        columns: Range<usize>,
        multiplier: &BandLimitedMultiplier,
        scratch: &mut [f32],
    ) {
        let fits = multiplier.reaches(self.plan.points(), in_vectors(&columns));
        assert!(fits, "the multiplier is for another shape");
        for waves in waves.chunks_mut(MOST_WAVES) {
            let mut at = [std::ptr::null_mut(); MOST_WAVES];
            for (at, wave) in at.iter_mut().zip(&mut *waves) {
                *at = self.checked(wave, stride, &columns, scratch);
            }
            let waves = &at[..waves.len()];
            let (plan, columns) = (&self.plan, columns.clone());
            Arch::new().dispatch(Convolve { plan, waves, stride, columns, multiplier, scratch });
        }
    }

    /// Transforms columns in place, natural order to natural order, unnormalised.
    pub fn transform(
        &self,
        data: &mut [Complex32],
        stride: usize,
        columns: Range<usize>,
        inverse: bool,
        scratch: &mut [f32],
    ) {
        let data = self.checked(data, stride, &columns, scratch);
        let plan = &self.plan;
        Arch::new().dispatch(Transform { plan, data, stride, columns, inverse, scratch });
    }

    /// The matrix as floats, after a check that the columns, in whole vectors, lie inside.
    fn checked(
        &self,
        data: &mut [Complex32],
        stride: usize,
        columns: &Range<usize>,
        scratch: &[f32],
    ) -> *mut f32 {
        let end = in_vectors(columns);
        let all = self.plan.points().saturating_mul(stride);
        assert!(columns.end <= stride && end <= stride && data.len() >= all, "rows are not padded");
        assert!(scratch.len() >= self.scratch_len());
        // Complex32 is repr(C) of two f32.
        data.as_mut_ptr().cast()
    }
}

/// The end of a range of columns that is rounded up to whole vectors.
fn in_vectors(columns: &Range<usize>) -> usize {
    columns.start.saturating_add(columns.len().next_multiple_of(lanes()))
}

/// Waves that one call of the kernel handles.
const MOST_WAVES: usize = 16;

struct Convolve<'a> {
    plan: &'a RadixPlan,
    waves: &'a [*mut f32],
    stride: usize,
    columns: Range<usize>,
    multiplier: &'a BandLimitedMultiplier,
    scratch: &'a mut [f32],
}

impl WithSimd for Convolve<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (scratch, _) = S::as_mut_simd_f32s(self.scratch);
        let data: *mut Lanes<S> = scratch.as_mut_ptr().cast();
        let kernel = RadixPasses { simd, plan: self.plan, data };
        // SAFETY: ColumnPlan::checked found all rows of every wave long enough for whole vectors, and room in scratch for the plan's
        // numbers twice; the second half holds the factors. ColumnPlan::convolve found the multiplier to be for this shape. The waves
        // are borrowed for the call and distinct, since each was lent as `&mut`.
        unsafe {
            let factors = data.add(self.plan.points());
            for first in self.columns.step_by(S::F32_LANES) {
                let band = InBand::<S>::new(simd, self.multiplier, first);
                for position in 0..self.plan.points() {
                    *factors.add(position) = band.factor(simd, position);
                }
                for &data in self.waves {
                    let stride = 2 * self.stride;
                    ColumnBlock { kernel: &kernel, data, stride, first }
                        .convolve(&Factors { factors });
                }
            }
        }
    }
}

struct Transform<'a> {
    plan: &'a RadixPlan,
    data: *mut f32,
    stride: usize,
    columns: Range<usize>,
    inverse: bool,
    scratch: &'a mut [f32],
}

impl WithSimd for Transform<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (scratch, _) = S::as_mut_simd_f32s(self.scratch);
        let kernel = RadixPasses { simd, plan: self.plan, data: scratch.as_mut_ptr().cast() };
        for first in self.columns.step_by(S::F32_LANES) {
            let stride = 2 * self.stride;
            let mut block = ColumnBlock { kernel: &kernel, data: self.data, stride, first };
            // SAFETY: ColumnPlan::checked found all rows long enough for whole vectors, and room in scratch for the plan's numbers.
            unsafe {
                match self.inverse {
                    false => block.transform::<false>(),
                    true => block.transform::<true>(),
                }
            }
        }
    }
}

/// One block of columns of the matrix at `data`: as many from `first` on as a vector has lanes, in rows `stride` floats apart.
///
/// Every method needs the matrix to have these columns in as many rows as the kernel's plan has numbers, the kernel's scratch to have
/// room for these numbers, and nothing else to read or write either meanwhile. All rows that are read and written are numbers of the plan.
struct ColumnBlock<'a, S: Simd> {
    kernel: &'a RadixPasses<'a, S>,
    data: *mut f32,
    stride: usize,
    first: usize,
}

impl<S: Simd> ColumnBlock<'_, S> {
    /// # Safety
    /// The matrix must have the block's columns in this row.
    #[inline(always)]
    unsafe fn load(&self, row: usize) -> Lanes<S> {
        // SAFETY: two vectors of floats are a complex number in each of the block's columns.
        unsafe {
            let at = self.data.add(row * self.stride + 2 * self.first).cast::<[S::f32s; 2]>();
            tile::split(self.kernel.simd, at.read_unaligned())
        }
    }

    /// # Safety
    /// As for [`Self::load`].
    #[inline(always)]
    unsafe fn store(&self, row: usize, v: Lanes<S>) {
        // SAFETY: as in `load`.
        unsafe {
            let at = self.data.add(row * self.stride + 2 * self.first).cast::<[S::f32s; 2]>();
            at.write_unaligned(tile::join(self.kernel.simd, v));
        }
    }

    /// # Safety
    /// Matrix and scratch must be there, and a factor for each of the plan's numbers.
    #[inline(always)]
    unsafe fn convolve(&mut self, factors: &Factors<S>) {
        // SAFETY: the radix is the first stage's; the caller vouches for the rest.
        unsafe {
            let first = self.kernel.plan.stages()[0].radix;
            by_radix!(first, self.first_forward(false));
            self.kernel.convolve_inner(factors);
            by_radix!(first, self.last_inverse());
        }
    }

    /// # Safety
    /// Matrix and scratch must be there.
    #[inline(always)]
    unsafe fn transform<const INVERSE: bool>(&mut self) {
        // SAFETY: the radix is the first stage's, and positions and rows of `order` are below the plan's length.
        unsafe {
            let plan = self.kernel.plan;
            by_radix!(plan.stages()[0].radix, self.first_forward(INVERSE));
            self.kernel.forward_from(1);
            for (position, &row) in plan.order().iter().enumerate() {
                let v = *self.kernel.data.add(position);
                self.store(row, if INVERSE { (v.1, v.0) } else { v });
            }
        }
    }

    /// First pass: matrix to scratch. `swapped` exchanges real and imaginary parts.
    ///
    /// # Safety
    /// Matrix and scratch must be there, and `R` must be the first stage's radix.
    #[inline(always)]
    unsafe fn first_forward<const R: usize>(&mut self, swapped: bool) {
        // SAFETY: j < sub and q < R, so all rows are numbers of the plan.
        unsafe {
            let stage = &self.kernel.plan.stages()[0];
            let sub = stage.len / R;
            for j in 0..sub {
                let mut x = [self.load(j); R];
                for q in 1..R {
                    x[q] = self.load(j + q * sub);
                }
                if swapped {
                    for v in &mut x {
                        *v = (v.1, v.0);
                    }
                }
                self.kernel.twiddled(&mut x, stage, j);
                for q in 0..R {
                    *self.kernel.data.add(j + q * sub) = x[q];
                }
            }
        }
    }

    /// Last pass: scratch to matrix.
    ///
    /// # Safety
    /// As for [`Self::first_forward`].
    #[inline(always)]
    unsafe fn last_inverse<const R: usize>(&mut self) {
        // SAFETY: as in `first_forward`.
        unsafe {
            let stage = &self.kernel.plan.stages()[0];
            let sub = stage.len / R;
            for j in 0..sub {
                let x = self.kernel.untwiddled::<R>(stage, 0, j);
                for q in 0..R {
                    self.store(j + q * sub, x[q]);
                }
            }
        }
    }
}

/// A block of columns of a [`BandLimitedMultiplier`].
struct InBand<'a, S: Simd> {
    m: &'a BandLimitedMultiplier,
    column: Lanes<S>,
    k2: S::f32s,
}

impl<'a, S: Simd> InBand<'a, S> {
    /// # Safety
    /// The multiplier must reach to the end of the vector that begins at column `first`.
    #[inline(always)]
    unsafe fn new(simd: S, m: &'a BandLimitedMultiplier, first: usize) -> Self {
        // SAFETY: both arrays of the multiplier's columns reach as far as it does.
        let values = |values: &[[f32; 2]]| unsafe {
            let at = values.as_ptr().add(first).cast::<[S::f32s; 2]>();
            tile::split(simd, at.read_unaligned())
        };
        InBand { m, column: values(&m.column), k2: values(&m.column_k2).0 }
    }
}

impl<S: Simd> InBand<'_, S> {
    /// # Safety
    /// `position` must be a row of the multiplier.
    #[inline(always)]
    unsafe fn factor(&self, s: S, position: usize) -> Lanes<S> {
        // SAFETY: `row` and `row_room` have an element for every row.
        unsafe {
            let (zero, one) = (s.splat_f32s(0.0), s.splat_f32s(1.0));
            let (two, three) = (s.splat_f32s(2.0), s.splat_f32s(3.0));
            let room = s.splat_f32s(*self.m.row_room.as_ptr().add(position));
            let u = s.mul_f32s(s.sub_f32s(room, self.k2), s.splat_f32s(self.m.slope));
            let u = s.min_f32s(s.max_f32s(u, zero), one);
            let weight = s.mul_f32s(s.mul_f32s(u, u), s.negate_mul_add_f32s(two, u, three));
            let row = splat(s, *self.m.row.as_ptr().add(position));
            let v = mul(s, self.column, row);
            (s.mul_f32s(v.0, weight), s.mul_f32s(v.1, weight))
        }
    }
}

/// Multiplication by prepared factors, as many as the plan has numbers.
struct Factors<S: Simd> {
    factors: *const Lanes<S>,
}

impl<S: Simd> Middle<S> for Factors<S> {
    #[inline(always)]
    unsafe fn apply(&self, simd: S, position: usize, v: Lanes<S>) -> Lanes<S> {
        // SAFETY: there is a factor for every position of the plan.
        unsafe { mul(simd, v, *self.factors.add(position)) }
    }
}
