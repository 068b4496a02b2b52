//! Two-dimensional Fourier transforms: plan, then execute.
//!
//! Arrays are row-major with x (the column index) fastest; rows are padded to [`Fft2::stride`]
//! elements. Transforms are unnormalised and in natural order: `forward` multiplies by
//! `exp(-2 pi i ...)`, and `inverse(forward(a)) = nx ny a`. Rows and columns are transformed in SIMD
//! blocks ([`rows`], [`columns`]), or one by one by `rustfft` when the length has a prime factor above 5.

mod butterfly;
pub mod columns;
mod kernel;
pub mod multiplier;
pub mod radix;
mod real;
pub mod rows;
mod tile;

use columns::ColumnPlan;
use multiplier::{Disk, DiskMultiplier};
use num_complex::Complex32;
use radix::lanes;
use rows::RowPlan;
use rustfft::{Fft, FftPlanner};
use std::ops::{Deref, DerefMut, Range};
use std::sync::Arc;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct CacheLine([Complex32; 8]);

/// A buffer of complex numbers that starts on a cache line.
#[derive(Clone)]
pub struct Buffer {
    lines: Vec<CacheLine>,
}

impl Buffer {
    /// `len` zeros (rounded up to whole cache lines).
    pub fn zeros(len: usize) -> Self {
        Buffer { lines: vec![CacheLine([Complex32::ZERO; 8]); len.div_ceil(8)] }
    }
}

impl Deref for Buffer {
    type Target = [Complex32];
    fn deref(&self) -> &[Complex32] {
        // CacheLine is repr(C) of eight Complex32, without padding.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * 8) }
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [Complex32] {
        unsafe {
            std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * 8)
        }
    }
}

/// Work space of [`Fft2`]; its contents do not matter.
pub struct Scratch {
    single: Vec<Complex32>,
    block: Buffer,
}

enum Columns {
    Blocked(ColumnPlan),
    Single { forward: Arc<dyn Fft<f32>>, inverse: Arc<dyn Fft<f32>> },
}

/// A plan for arrays of one shape, shared by all threads.
pub struct Fft2 {
    ny: usize,
    nx: usize,
    stride: usize,
    row_forward: Arc<dyn Fft<f32>>,
    row_inverse: Arc<dyn Fft<f32>>,
    /// `None`: rows one by one.
    rows: Option<RowPlan>,
    columns: Columns,
}

impl Fft2 {
    /// Plans transforms of `ny` rows by `nx` columns.
    pub fn new(ny: usize, nx: usize) -> Self {
        Self::with_kernel(ny, nx, true)
    }

    /// As [`Fft2::new`]; with `blocked = false` rows and columns are transformed one by one by
    /// `rustfft`, the plain reference for the SIMD kernels.
    pub fn with_kernel(ny: usize, nx: usize, blocked: bool) -> Self {
        assert!(ny > 0 && nx > 0, "empty transform");
        let mut planner = FftPlanner::new();
        let columns = match ColumnPlan::new(ny).filter(|_| blocked) {
            Some(plan) => Columns::Blocked(plan),
            None => Columns::Single {
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

    /// (rows, columns)
    pub fn shape(&self) -> (usize, usize) {
        (self.ny, self.nx)
    }

    /// Elements from one row to the next.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// A zeroed array of this plan's shape, with room for whole blocks of rows.
    pub fn buffer(&self) -> Buffer {
        Buffer::zeros(self.buffer_len())
    }

    /// Elements of [`Fft2::buffer`].
    pub fn buffer_len(&self) -> usize {
        self.ny.next_multiple_of(lanes()) * self.stride
    }

    /// Work space for one thread.
    pub fn scratch(&self) -> Scratch {
        let row = self.row_forward.get_inplace_scratch_len();
        let row = row.max(self.row_inverse.get_inplace_scratch_len());
        let (single, columns) = match &self.columns {
            Columns::Blocked(plan) => (0, plan.scratch_len() / 2),
            Columns::Single { forward, inverse } => {
                let inner = forward.get_inplace_scratch_len();
                (inner.max(inverse.get_inplace_scratch_len()), self.ny)
            }
        };
        let rows = self.rows.as_ref().map_or(0, |plan| plan.scratch_len() / 2);
        let single = vec![Complex32::ZERO; row.max(single)];
        Scratch { single, block: Buffer::zeros(columns.max(rows)) }
    }

    /// Floating-point operations of one transform by the usual count, `5 N log2 N`.
    pub fn nominal_flops(&self) -> f64 {
        let n = (self.nx * self.ny) as f64;
        5.0 * n * n.log2()
    }

    /// Transforms all rows in place.
    pub fn all_rows(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.some_rows(data, self.ny, inverse, scratch);
    }

    /// Transforms the first `count` rows in place, and with them what whole blocks of rows hold beyond if `data` has
    /// room for them.
    pub fn some_rows(
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

    fn single_row(&self, row: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        let fft = if inverse { &self.row_inverse } else { &self.row_forward };
        fft.process_with_scratch(&mut row[..self.nx], &mut scratch.single);
    }

    /// Blocks of rows in [`Fft2::buffer`].
    pub fn row_blocks(&self) -> usize {
        self.ny.div_ceil(lanes())
    }

    /// Elements of a block of rows that [`Fft2::arrange_block`] has prepared.
    pub fn arranged_len(&self) -> usize {
        self.nx * lanes()
    }

    /// Prepares a block of [`lanes`] rows of real-space factors, `stride` elements apart, for
    /// [`Fft2::convolve_block`]. Rows need room for a vector beyond the last column.
    pub fn arrange_block(&self, rows: &[Complex32], stride: usize, out: &mut [Complex32]) {
        match &self.rows {
            Some(plan) => plan.arrange(rows, stride, floats(out)),
            None => {
                for (row, out) in rows.chunks(stride).zip(out.chunks_exact_mut(self.nx)) {
                    out.copy_from_slice(&row[..self.nx]);
                }
            }
        }
    }

    /// Takes a block of rows (whole rows, [`Fft2::stride`] apart) back to real space, multiplies it and
    /// transforms it forward, unnormalised. Columns outside `live` are taken as zero and are
    /// meaningless afterwards.
    pub fn convolve_block(
        &self,
        rows: &mut [Complex32],
        live: &[Range<usize>],
        by: &[Complex32],
        scratch: &mut Scratch,
    ) {
        let Some(plan) = &self.rows else {
            for (row, by) in rows.chunks_exact_mut(self.stride).zip(by.chunks_exact(self.nx)) {
                let mut end = 0;
                for range in live {
                    row[end..range.start].fill(Complex32::ZERO);
                    end = range.end;
                }
                row[end.min(self.nx)..].fill(Complex32::ZERO);
                self.single_row(row, true, scratch);
                row.iter_mut().zip(by).for_each(|(v, t)| *v *= t);
                self.single_row(row, false, scratch);
            }
            return;
        };
        plan.convolve(rows, self.stride, live, const_floats(by), scratch.block_floats());
    }

    /// Transforms all columns in place.
    pub fn all_columns(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.some_columns(data, 0..self.nx, inverse, scratch);
    }

    /// Transforms the given columns in place.
    pub fn some_columns(
        &self,
        data: &mut [Complex32],
        range: Range<usize>,
        inverse: bool,
        scratch: &mut Scratch,
    ) {
        match &self.columns {
            Columns::Blocked(plan) => {
                plan.transform(data, self.stride, range, inverse, scratch.block_floats())
            }
            Columns::Single { forward, inverse: backward } => {
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
    pub fn forward(&self, data: &mut [Complex32], scratch: &mut Scratch) {
        self.both(data, false, scratch);
    }

    /// Inverse transform in place, unnormalised.
    pub fn inverse(&self, data: &mut [Complex32], scratch: &mut Scratch) {
        self.both(data, true, scratch);
    }

    fn both(&self, data: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        self.all_rows(data, inverse, scratch);
        self.all_columns(data, inverse, scratch);
    }

    /// Prepares a multiplier for [`Fft2::convolve_columns`]; see [`DiskMultiplier`].
    pub fn multiplier(
        &self,
        row: &[Complex32],
        row_k2: &[f64],
        column: &[Complex32],
        column_k2: &[f64],
        disk: Disk,
    ) -> DiskMultiplier {
        let natural: Vec<usize>;
        let order = match &self.columns {
            Columns::Blocked(plan) => plan.order(),
            Columns::Single { .. } => {
                natural = (0..self.ny).collect();
                &natural
            }
        };
        DiskMultiplier::new(order, row, row_k2, column, column_k2, disk)
    }

    /// Transforms columns of every wave, multiplies and transforms back, unnormalised. Columns outside
    /// `ranges` are left alone; ranges are rounded up to whole SIMD vectors.
    pub fn convolve_columns<W: DerefMut<Target = [Complex32]>>(
        &self,
        waves: &mut [W],
        ranges: &[Range<usize>],
        multiplier: &DiskMultiplier,
        scratch: &mut Scratch,
    ) {
        for range in ranges.iter().cloned() {
            match &self.columns {
                Columns::Blocked(plan) => {
                    plan.convolve(waves, self.stride, range, multiplier, scratch.block_floats())
                }
                Columns::Single { forward, inverse } => {
                    for wave in &mut *waves {
                        for x in range.clone().filter(|&x| x < self.nx) {
                            self.gather(wave, x, &mut scratch.block);
                            let column = &mut scratch.block[..self.ny];
                            forward.process_with_scratch(column, &mut scratch.single);
                            multiplier.apply(x, column);
                            inverse.process_with_scratch(column, &mut scratch.single);
                            self.scatter(wave, x, &scratch.block);
                        }
                    }
                }
            }
        }
    }

    /// Column ranges that cover the frequencies `-m..=m`, in whole SIMD vectors and disjoint.
    pub fn band_columns(&self, m: usize) -> Vec<Range<usize>> {
        let lanes = radix::lanes();
        let low = (m + 1).next_multiple_of(lanes);
        let high = m.next_multiple_of(lanes);
        if low + high >= self.nx {
            return std::iter::once(0..self.nx.next_multiple_of(lanes)).collect();
        }
        vec![0..low, self.nx - high..self.nx]
    }

    fn gather(&self, data: &[Complex32], x: usize, column: &mut [Complex32]) {
        for y in 0..self.ny {
            column[y] = data[y * self.stride + x];
        }
    }

    fn scatter(&self, data: &mut [Complex32], x: usize, column: &[Complex32]) {
        for y in 0..self.ny {
            data[y * self.stride + x] = column[y];
        }
    }
}

impl Scratch {
    fn block_floats(&mut self) -> &mut [f32] {
        floats(&mut self.block)
    }
}

/// Real and imaginary parts in turn.
fn floats(data: &mut [Complex32]) -> &mut [f32] {
    // Complex32 is repr(C) of two f32.
    unsafe { std::slice::from_raw_parts_mut(data.as_mut_ptr().cast(), data.len() * 2) }
}

fn const_floats(data: &[Complex32]) -> &[f32] {
    unsafe { std::slice::from_raw_parts(data.as_ptr().cast(), data.len() * 2) }
}

/// The FFT frequency index of bin `i` of `n`: 0, 1, ..., -2, -1.
pub fn frequency(i: usize, n: usize) -> i64 {
    if i < n.div_ceil(2) { i as i64 } else { i as i64 - n as i64 }
}

/// The smallest fast length that is at least `min`: `multiple` times a product of any number of 2 and
/// 3 and at most one 5 (rows of 625 = 5^4 run at half the speed of 640).
pub fn good_size(min: usize, multiple: usize) -> usize {
    let smooth = |mut n: usize| {
        for p in [2, 3] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1 || n == 5
    };
    let first = min.max(1).next_multiple_of(multiple);
    (0..).map(|i| first + i * multiple).find(|&n| smooth(n / multiple)).unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize) -> Vec<Complex32> {
        use crate::rng::{Purpose, normal3};
        let value = |i| normal3(1, Purpose::Phonon, 0, i);
        (0..n as u64).map(|i| Complex32::new(value(i)[0] as f32, value(i)[1] as f32)).collect()
    }

    fn filled(fft: &Fft2) -> Buffer {
        let mut data = fft.buffer();
        // padding holds noise as well: it must not matter
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
            let disk = Disk { limit_k2: 0.09, full_k2: 0.08 };
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

    #[test]
    fn good_sizes() {
        assert_eq!(good_size(625, 1), 640);
        assert_eq!(good_size(641, 1), 648);
        assert_eq!(good_size(751, 4), 768);
        assert_eq!(good_size(751, 7), 756);
    }
}
