//! The plan of a two-dimensional transform, and its execution.

use super::buffer::{Buffer, floats};
use super::column_transform::ColumnPlan;
use super::radix_plan::lanes;
use super::row_transform::RowPlan;
use num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::ops::Range;
use std::sync::Arc;

/// One thread's work space for [`Fft2`], with arbitrary contents.
pub(crate) struct Scratch {
    pub(super) single: Vec<Complex32>,
    pub(super) block: Buffer,
}

/// The method for transforming columns.
pub(super) enum ColumnKernel {
    /// In SIMD blocks.
    Blocked(ColumnPlan),
    /// One by one, by `rustfft`.
    Single { forward: Arc<dyn Fft<f32>>, inverse: Arc<dyn Fft<f32>> },
}

/// A plan for arrays of one shape, shared by all threads.
pub(crate) struct Fft2 {
    pub(super) ny: usize,
    pub(super) nx: usize,
    pub(super) stride: usize,
    row_forward: Arc<dyn Fft<f32>>,
    row_inverse: Arc<dyn Fft<f32>>,
    /// `None`: rows go one by one through `rustfft`.
    pub(super) rows: Option<RowPlan>,
    pub(super) columns: ColumnKernel,
}

impl Fft2 {
    /// Plans transforms of `ny` rows by `nx` columns.
    pub(crate) fn new(ny: usize, nx: usize) -> Self {
        Self::with_kernel(ny, nx, true)
    }

    /// As [`Fft2::new`]; with `blocked = false`, `rustfft` transforms rows and columns one by one, as the reference for the SIMD blocks.
    pub(crate) fn with_kernel(ny: usize, nx: usize, blocked: bool) -> Self {
        assert!(ny > 0 && nx > 0, "empty transform");
        let mut planner = FftPlanner::new();
        let columns = match ColumnPlan::new(ny).filter(|_| blocked) {
            Some(plan) => ColumnKernel::Blocked(plan),
            None => ColumnKernel::Single {
                forward: planner.plan_fft_forward(ny),
                inverse: planner.plan_fft_inverse(ny),
            },
        };
        Fft2 {
            ny,
            nx,
            // An odd number of 128-byte lines: rows then fall into different cache sets.
            stride: (nx.div_ceil(16) | 1) * 16,
            row_forward: planner.plan_fft_forward(nx),
            row_inverse: planner.plan_fft_inverse(nx),
            rows: RowPlan::new(nx).filter(|_| blocked),
            columns,
        }
    }

    /// Shape of the arrays: (rows, columns) = (ny, nx), without padding.
    pub(crate) fn shape(&self) -> (usize, usize) {
        (self.ny, self.nx)
    }

    /// Elements from one row to the next.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// A zeroed array of this plan: ny rows of [`Fft2::stride`] elements, and further rows that complete the last block.
    pub(crate) fn buffer(&self) -> Buffer {
        Buffer::zeros(self.buffer_len())
    }

    /// Elements of [`Fft2::buffer`].
    pub(crate) fn buffer_len(&self) -> usize {
        self.ny.next_multiple_of(lanes()) * self.stride
    }

    /// Work space for one thread.
    pub(crate) fn scratch(&self) -> Scratch {
        let row = self.row_forward.get_inplace_scratch_len();
        let row = row.max(self.row_inverse.get_inplace_scratch_len());
        let (single, columns) = match &self.columns {
            ColumnKernel::Blocked(plan) => (0, plan.scratch_len() / 2),
            ColumnKernel::Single { forward, inverse } => {
                let inner = forward.get_inplace_scratch_len();
                (inner.max(inverse.get_inplace_scratch_len()), self.ny)
            }
        };
        let rows = self.rows.as_ref().map_or(0, |plan| plan.scratch_len() / 2);
        let single = vec![Complex32::ZERO; row.max(single)];
        Scratch { single, block: Buffer::zeros(columns.max(rows)) }
    }

    /// Floating-point operations of one transform by the usual count, `5 N log2 N`.
    pub(crate) fn nominal_flops(&self) -> f64 {
        let n = (self.nx * self.ny) as f64;
        5.0 * n * n.log2()
    }

    /// Transforms all rows in place.
    pub(crate) fn all_rows(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.some_rows(data, self.ny, inverse, scratch);
    }

    /// Transforms the first `count` rows in place. If `data` has room for it, the rest of the last block of
    /// rows is transformed with them.
    pub(crate) fn some_rows(
        &self,
        data: &mut [Complex32],
        count: usize,
        inverse: bool,
        scratch: &mut Scratch,
    ) {
        let mut done = 0;
        if let Some(plan) = &self.rows {
            let up = count.next_multiple_of(lanes());
            let whole = if up * self.stride <= data.len() { up } else { count / lanes() * lanes() };
            for block in data[..whole * self.stride].chunks_exact_mut(lanes() * self.stride) {
                plan.transform(block, self.stride, inverse, scratch.block_floats());
            }
            done = whole;
        }
        for row in data.chunks_exact_mut(self.stride).take(count).skip(done) {
            self.single_row(row, inverse, scratch);
        }
    }

    /// Transforms one row by `rustfft`.
    pub(super) fn single_row(&self, row: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        let fft = if inverse { &self.row_inverse } else { &self.row_forward };
        fft.process_with_scratch(&mut row[..self.nx], &mut scratch.single);
    }

    /// Transforms all columns in place.
    pub(crate) fn all_columns(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.some_columns(data, 0..self.nx, inverse, scratch);
    }

    /// Transforms the given columns in place.
    pub(crate) fn some_columns(
        &self,
        data: &mut [Complex32],
        range: Range<usize>,
        inverse: bool,
        scratch: &mut Scratch,
    ) {
        match &self.columns {
            ColumnKernel::Blocked(plan) => {
                plan.transform(data, self.stride, range, inverse, scratch.block_floats())
            }
            ColumnKernel::Single { forward, inverse: backward } => {
                let fft = if inverse { backward } else { forward };
                for x in range {
                    self.gather(data, x, &mut scratch.block);
                    fft.process_with_scratch(&mut scratch.block[..self.ny], &mut scratch.single);
                    self.scatter(data, x, &scratch.block);
                }
            }
        }
    }

    /// Forward transform in place.
    pub(crate) fn forward(&self, data: &mut [Complex32], scratch: &mut Scratch) {
        self.both(data, false, scratch);
    }

    /// Inverse transform in place, unnormalised.
    pub(crate) fn inverse(&self, data: &mut [Complex32], scratch: &mut Scratch) {
        self.both(data, true, scratch);
    }

    /// As [`Fft2::inverse`], where only the rows of the frequencies `-m..=m` hold values other than zero.
    pub(crate) fn inverse_of_low_rows(
        &self,
        data: &mut [Complex32],
        m: usize,
        scratch: &mut Scratch,
    ) {
        // Whole blocks, so that a row's transform has the same bytes.
        let high = self.ny.saturating_sub(m) / lanes() * lanes();
        if (m + 1).next_multiple_of(lanes()) >= high {
            return self.inverse(data, scratch);
        }
        self.some_rows(data, m + 1, true, scratch);
        self.some_rows(&mut data[high * self.stride..], self.ny - high, true, scratch);
        self.all_columns(data, true, scratch);
    }

    fn both(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.all_rows(data, inverse, scratch);
        self.all_columns(data, inverse, scratch);
    }

    /// Column ranges that cover the frequencies `-m..=m`, in whole SIMD vectors and disjoint.
    pub(crate) fn band_columns(&self, m: usize) -> Vec<Range<usize>> {
        let low = (m + 1).next_multiple_of(lanes());
        let high = m.next_multiple_of(lanes());
        if low + high >= self.nx {
            return std::iter::once(0..self.nx.next_multiple_of(lanes())).collect();
        }
        vec![0..low, self.nx - high..self.nx]
    }

    /// Copies column `x` into `column`.
    pub(super) fn gather(&self, data: &[Complex32], x: usize, column: &mut [Complex32]) {
        for y in 0..self.ny {
            column[y] = data[y * self.stride + x];
        }
    }

    /// Copies `column` into column `x`.
    pub(super) fn scatter(&self, data: &mut [Complex32], x: usize, column: &[Complex32]) {
        for y in 0..self.ny {
            data[y * self.stride + x] = column[y];
        }
    }
}

impl Scratch {
    pub(super) fn block_floats(&mut self) -> &mut [f32] {
        floats(&mut self.block)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BandLimit, frequency};
    use super::*;

    fn noise(n: usize) -> Vec<Complex32> {
        use crate::rng::{Purpose, normal3};
        let value = |i| normal3(1, Purpose::Phonon, 0, i);
        (0..n as u64).map(|i| Complex32::new(value(i)[0] as f32, value(i)[1] as f32)).collect()
    }

    fn filled(fft: &Fft2) -> Buffer {
        let mut data = fft.buffer();
        // The padding holds noise too, to test that it has no effect.
        let values = noise(data.len());
        data.copy_from_slice(&values);
        data
    }

    fn assert_close(fft: &Fft2, a: &[Complex32], b: &[Complex32], tolerance: f32) {
        let (ny, nx) = fft.shape();
        let scale = b.iter().map(|v| v.norm()).fold(0.0, f32::max);
        for y in 0..ny {
            for x in 0..nx {
                let i = y * fft.stride() + x;
                let error = (a[i] - b[i]).norm() / scale;
                assert!(error < tolerance, "{ny}x{nx} at {y},{x}: {} against {}", a[i], b[i]);
            }
        }
    }

    const SHAPES: [(usize, usize); 9] = [
        (16, 7),
        (20, 33),
        (30, 18),
        (64, 20),
        (96, 17),
        (125, 40),
        (135, 16),
        (192, 192),
        (77, 24),
    ];

    #[test]
    fn blocked_columns_agree_with_rustfft_with_garbage_in_scratch() {
        for (ny, nx) in SHAPES {
            let (fast, plain) = (Fft2::new(ny, nx), Fft2::with_kernel(ny, nx, false));
            for inverse in [false, true] {
                let (mut a, mut b) = (filled(&fast), filled(&fast));
                let mut scratch = fast.scratch();
                scratch.block_floats().fill(f32::NAN);
                fast.both(&mut a, inverse, &mut scratch);
                plain.both(&mut b, inverse, &mut plain.scratch());
                assert_close(&fast, &a, &b, 1e-6);
            }
        }
    }

    #[test]
    fn inverse_undoes_forward() {
        for (ny, nx) in SHAPES {
            let fft = Fft2::new(ny, nx);
            let (mut a, b) = (filled(&fft), filled(&fft));
            let mut scratch = fft.scratch();
            fft.forward(&mut a, &mut scratch);
            fft.inverse(&mut a, &mut scratch);
            a.iter_mut().for_each(|v| *v /= (ny * nx) as f32);
            assert_close(&fft, &a, &b, 1e-6);
        }
    }

    #[test]
    fn fused_convolution_agrees_with_plain_one() {
        for (ny, nx) in SHAPES {
            let (fast, plain) = (Fft2::new(ny, nx), Fft2::with_kernel(ny, nx, false));
            let k2 = |n: usize| -> Vec<f64> {
                (0..n).map(|i| (frequency(i, n) as f64 / n as f64).powi(2)).collect()
            };
            let phase = |n: usize| -> Vec<Complex32> {
                k2(n).iter().map(|k| Complex32::from_polar(1.0, 40.0 * *k as f32)).collect()
            };
            let disk = BandLimit { limit_k2: 0.09, full_k2: 0.08 };
            let prepare = |f: &Fft2| f.multiplier(&phase(ny), &k2(ny), &phase(nx), &k2(nx), disk);
            let (mut a, mut b) = (filled(&fast), filled(&fast));
            let mut scratch = fast.scratch();
            scratch.block_floats().fill(f32::NAN);
            let all = fast.band_columns(nx / 2);
            fast.convolve_columns(&mut [&mut *a], &all, &prepare(&fast), &mut scratch);
            plain.convolve_columns(&mut [&mut *b], &all, &prepare(&plain), &mut plain.scratch());
            assert_close(&fast, &a, &b, 1e-6);
        }
    }

    #[test]
    #[should_panic(expected = "the multiplier is for another shape")]
    fn multipliers_of_another_shape_are_refused() {
        let (fft, narrow) = (Fft2::new(16, 400), Fft2::new(16, 16));
        let disk = BandLimit { limit_k2: 1.0, full_k2: 1.0 };
        let ones = [Complex32::ONE; 16];
        let other = narrow.multiplier(&ones, &[0.0; 16], &ones, &[0.0; 16], disk);
        let mut data = fft.buffer();
        let all = fft.band_columns(200);
        fft.convolve_columns(&mut [&mut *data], &all, &other, &mut fft.scratch());
    }

    /// Columns up to the first live one are zeros in scratch. Scratch has no room for columns beyond the rows.
    #[test]
    #[should_panic(expected = "is not within 16 columns")]
    fn live_columns_beyond_the_rows_are_refused() {
        let fft = Fft2::new(16, 16);
        let mut rows = Buffer::zeros(lanes() * fft.stride());
        let by = Buffer::zeros(fft.arranged_len());
        let beyond = 100_000..100_016;
        fft.convolve_block(&mut rows, std::slice::from_ref(&beyond), &by, &mut fft.scratch());
    }

    #[test]
    fn band_columns_cover_the_band_without_overlap() {
        for nx in [16, 33, 100, 192, 480] {
            let fft = Fft2::new(16, nx);
            for m in 0..nx / 2 {
                let ranges = fft.band_columns(m);
                let mut seen = vec![0; fft.stride()];
                for r in &ranges {
                    let end = r.start + r.len().next_multiple_of(lanes());
                    seen[r.start..end].iter_mut().for_each(|n| *n += 1);
                }
                assert!(seen.iter().all(|&n| n <= 1), "{nx} {m} {ranges:?}");
                assert!((0..=m).all(|i| seen[i] == 1 && seen[(nx - i) % nx] == 1));
            }
        }
    }
}
