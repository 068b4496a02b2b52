//! Fourier transforms along the rows of a matrix, one SIMD lane per row.
//!
//! As many rows as the vector unit has lanes are read into cache transposed, transformed together, and written
//! back transposed.

use super::butterfly::{Lanes, mul};
use super::passes::{Middle, RadixPasses};
use super::radix_plan::{RadixPlan, lanes};
use super::tile;
use num_complex::Complex32;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// The plan for blocks of [`lanes`] rows of `n` columns.
#[derive(Debug, Clone)]
pub struct RowPlan {
    plan: RadixPlan,
    /// Position of each column after the forward passes.
    position: Vec<usize>,
}

/// A block of rows in the order in which [`RowPlan::convolve`] multiplies by it.
pub type Arranged = [f32];

impl RowPlan {
    /// A plan for `n` columns, or `None` when [`RadixPlan`] cannot have one.
    pub fn new(n: usize) -> Option<Self> {
        let plan = RadixPlan::new(n)?;
        let mut position = vec![0; n];
        plan.order().iter().enumerate().for_each(|(at, &column)| position[column] = at);
        Some(RowPlan { plan, position })
    }

    /// Number of `f32` that scratch must have room for. A tile may reach beyond the last column.
    pub fn scratch_len(&self) -> usize {
        (self.plan.points() + tile::MOST_COLUMNS) * 2 * lanes()
    }

    /// Number of `f32` of a block in the order of [`RowPlan::arrange`].
    pub fn arranged_len(&self) -> usize {
        self.plan.points() * 2 * lanes()
    }

    /// Transforms a block of rows in place, natural order to natural order, unnormalised.
    pub fn transform(
        &self,
        rows: &mut [Complex32],
        stride: usize,
        inverse: bool,
        scratch: &mut [f32],
    ) {
        self.check(rows, stride, scratch);
        self.dispatch(rows, stride, RowTask::Transform { inverse }, scratch);
    }

    /// Puts a block of rows of real-space factors into the order of [`RowPlan::convolve`].
    pub fn arrange(&self, rows: &[Complex32], stride: usize, out: &mut Arranged) {
        let read = (lanes() - 1).saturating_mul(stride).saturating_add(self.padded());
        assert!(rows.len() >= read && out.len() >= self.arranged_len());
        let rows = rows.as_ptr().cast::<f32>();
        Arch::new().dispatch(Arrange { plan: self, rows, stride: 2 * stride, out });
    }

    /// Inverse transform of a block of rows, multiplication by `by`, forward transform; unnormalised.
    /// Columns outside `live` count as zero and are not written; `live` ranges are rounded up to whole
    /// vectors.
    ///
    /// # Panics
    /// If a rounded range ends beyond the padded columns.
    pub fn convolve(
        &self,
        rows: &mut [Complex32],
        stride: usize,
        live: &[Range<usize>],
        by: &Arranged,
        scratch: &mut [f32],
    ) {
        self.check(rows, stride, scratch);
        assert!(by.len() >= self.arranged_len());
        let (padded, tile) = (self.padded(), self.tile_columns());
        for range in live {
            let columns = range.end.min(padded).saturating_sub(range.start);
            let end = range.start.saturating_add(columns.next_multiple_of(tile));
            assert!(end <= padded, "{range:?} is not within {padded} columns");
        }
        self.dispatch(rows, stride, RowTask::Convolve { live, by }, scratch);
    }

    /// Columns, rounded up to whole tiles.
    fn padded(&self) -> usize {
        self.plan.points().next_multiple_of(self.tile_columns())
    }

    /// [`tile::columns`] on this processor.
    fn tile_columns(&self) -> usize {
        (lanes() / 2).max(1)
    }

    fn check(&self, rows: &[Complex32], stride: usize, scratch: &[f32]) {
        let all = lanes().saturating_mul(stride);
        assert!(self.padded() <= stride && rows.len() >= all, "rows are not padded");
        assert!(scratch.len() >= self.scratch_len());
    }

    fn dispatch(
        &self,
        rows: &mut [Complex32],
        stride: usize,
        task: RowTask<'_>,
        scratch: &mut [f32],
    ) {
        // Complex32 is repr(C) of two f32, so rows are twice as long in floats.
        let data = rows.as_mut_ptr().cast::<f32>();
        Arch::new().dispatch(RowPass { plan: self, data, stride: 2 * stride, task, scratch });
    }
}

struct Arrange<'a> {
    plan: &'a RowPlan,
    rows: *const f32,
    stride: usize,
    out: &'a mut [f32],
}

impl WithSimd for Arrange<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let out: *mut Lanes<S> = self.out.as_mut_ptr().cast();
        let position = &self.plan.position;
        for first in (0..position.len()).step_by(tile::columns::<S>()) {
            // SAFETY: RowPlan::arrange checked that all rows are readable to the end of the last tile.
            let values = unsafe { tile::load(simd, self.rows.add(2 * first), self.stride) };
            for (v, &at) in values.iter().zip(&position[first..]).take(tile::columns::<S>()) {
                // SAFETY: `at` is a column of the plan, and RowPlan::arrange checked that `out` has room for all.
                unsafe { out.add(at).write_unaligned(*v) };
            }
        }
    }
}

enum RowTask<'a> {
    Convolve { live: &'a [Range<usize>], by: &'a Arranged },
    Transform { inverse: bool },
}

struct RowPass<'a> {
    plan: &'a RowPlan,
    data: *mut f32,
    stride: usize,
    task: RowTask<'a>,
    scratch: &'a mut [f32],
}

impl WithSimd for RowPass<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (scratch, _) = S::as_mut_simd_f32s(self.scratch);
        let kernel = RadixPasses {
            simd,
            plan: &self.plan.plan,
            data: scratch.as_mut_ptr().cast::<Lanes<S>>(),
        };
        let block = RowBlock { kernel: &kernel, rows: self.data, stride: self.stride };
        // SAFETY: RowPlan's methods checked that the rows and `by` are as long as `RowBlock` needs, that `live` lies within the padded
        // columns, and that scratch has room for the plan's numbers and a tile beyond them. `position` is the plan's.
        unsafe {
            match self.task {
                RowTask::Convolve { live, by } => block.convolve(live, by),
                RowTask::Transform { inverse } => block.transform(&self.plan.position, inverse),
            }
        }
    }
}

/// A block of rows, `stride` floats apart and as long as the plan's columns in whole tiles, and scratch for the plan's numbers and a
/// tile beyond them. Every method needs both to be there, and nothing else to read or write them meanwhile.
struct RowBlock<'a, S: Simd> {
    kernel: &'a RadixPasses<'a, S>,
    rows: *mut f32,
    stride: usize,
}

/// Exchanges real and imaginary parts, which turns forward transforms into inverse ones.
#[inline(always)]
fn swap<S: Simd>(v: Lanes<S>) -> Lanes<S> {
    (v.1, v.0)
}

impl<S: Simd> RowBlock<'_, S> {
    /// Transposes columns into scratch, `swapped` or not.
    ///
    /// # Safety
    /// Rows and scratch must be there, and `columns` in whole tiles within the padded columns.
    #[inline(always)]
    unsafe fn load(&self, columns: Range<usize>, swapped: bool) {
        for first in columns.step_by(tile::columns::<S>()) {
            // SAFETY: the tile lies within the padded columns, for which there is room in the rows and in scratch.
            unsafe {
                let tile = tile::load(self.kernel.simd, self.rows.add(2 * first), self.stride);
                for c in 0..tile::columns::<S>() {
                    let v = if swapped { swap::<S>(tile[c]) } else { tile[c] };
                    *self.kernel.data.add(first + c) = v;
                }
            }
        }
    }

    /// Inverse transform, multiplication, forward transform.
    ///
    /// # Safety
    /// Rows and scratch must be there, `live` in whole tiles within the padded columns, and `by` as long as the plan.
    #[inline(always)]
    unsafe fn convolve(&self, live: &[Range<usize>], by: &Arranged) {
        // SAFETY: all tiles and all zeros between them lie within the padded columns, and scratch holds the plan's numbers.
        unsafe {
            let (simd, n) = (self.kernel.simd, self.kernel.plan.points());
            let zero = simd.splat_f32s(0.0);
            let mut filled = 0;
            let padded = n.next_multiple_of(tile::columns::<S>());
            let live = live.iter().map(|r| r.start..r.end.min(padded));
            for range in live.clone() {
                for x in filled..range.start {
                    *self.kernel.data.add(x) = (zero, zero);
                }
                filled = range.end;
                self.load(range, true);
            }
            for x in filled..n {
                *self.kernel.data.add(x) = (zero, zero);
            }
            self.kernel.first_forward();
            self.kernel.convolve_inner(&Multiply { by: by.as_ptr().cast() });
            self.kernel.last_inverse();
            for range in live {
                for first in range.step_by(tile::columns::<S>()) {
                    let mut v = [(zero, zero); tile::MOST_COLUMNS];
                    for c in 0..tile::columns::<S>() {
                        v[c] = swap::<S>(*self.kernel.data.add(first + c));
                    }
                    tile::store::<S>(&v, self.rows.add(2 * first), self.stride);
                }
            }
        }
    }

    /// Transform in place, natural order to natural order.
    ///
    /// # Safety
    /// Rows and scratch must be there, and `position` must be a column's position for each of the plan's columns.
    #[inline(always)]
    unsafe fn transform(&self, position: &[usize], inverse: bool) {
        // SAFETY: tiles begin at columns of the plan and so lie within the padded ones; positions are below the plan's length.
        unsafe {
            let n = self.kernel.plan.points();
            self.load(0..n, inverse);
            self.kernel.forward_from(0);
            let zero = self.kernel.simd.splat_f32s(0.0);
            for first in (0..n).step_by(tile::columns::<S>()) {
                let mut v = [(zero, zero); tile::MOST_COLUMNS];
                for c in 0..tile::columns::<S>().min(n - first) {
                    let value = *self.kernel.data.add(*position.get_unchecked(first + c));
                    v[c] = if inverse { swap::<S>(value) } else { value };
                }
                tile::store::<S>(&v, self.rows.add(2 * first), self.stride);
            }
        }
    }
}

/// Multiplication by arranged factors, as many as the plan has numbers, between an inverse and a forward transform.
struct Multiply<S: Simd> {
    by: *const Lanes<S>,
}

impl<S: Simd> Middle<S> for Multiply<S> {
    #[inline(always)]
    unsafe fn apply(&self, simd: S, position: usize, v: Lanes<S>) -> Lanes<S> {
        // SAFETY: there is a factor for every position of the plan.
        unsafe { swap::<S>(mul(simd, swap::<S>(v), self.by.add(position).read_unaligned())) }
    }
}
