//! Transform, multiply and transform back in one pass over memory.

use super::band_limit::{BandLimit, BandLimitedMultiplier};
use super::buffer::{const_floats, floats};
use super::fft2::{ColumnKernel, Fft2, Scratch};
use super::radix_plan::lanes;
use num_complex::Complex32;
use std::ops::{DerefMut, Range};

impl Fft2 {
    /// Number of blocks of rows in [`Fft2::buffer`].
    pub(crate) fn row_blocks(&self) -> usize {
        self.ny.div_ceil(lanes())
    }

    /// Elements of one block as [`Fft2::arrange_block`] writes it.
    pub(crate) fn arranged_len(&self) -> usize {
        self.nx * lanes()
    }

    /// Reorders a block of [`lanes`] rows of real-space factors, `stride` elements apart, into `out`
    /// ([`Fft2::arranged_len`] elements) for [`Fft2::convolve_block`]. Rows must be readable one SIMD vector
    /// beyond the last column.
    pub(crate) fn arrange_block(&self, rows: &[Complex32], stride: usize, out: &mut [Complex32]) {
        match &self.rows {
            Some(plan) => plan.arrange(rows, stride, floats(out)),
            None => {
                for (row, out) in rows.chunks(stride).zip(out.chunks_exact_mut(self.nx)) {
                    out.copy_from_slice(&row[..self.nx]);
                }
            }
        }
    }

    /// Inverse transform of a block of rows ([`Fft2::stride`] apart), multiplication by `by`, forward
    /// transform; unnormalised. Columns outside `live` count as zero, and hold garbage afterwards.
    pub(crate) fn convolve_block(
        &self,
        rows: &mut [Complex32],
        live: &[Range<usize>],
        by: &[Complex32],
        scratch: &mut Scratch,
    ) {
        let Some(plan) = &self.rows else {
            for (row, by) in rows.chunks_exact_mut(self.stride).zip(by.chunks_exact(self.nx)) {
                self.convolve_single_row(row, live, by, scratch);
            }
            return;
        };
        plan.convolve(rows, self.stride, live, const_floats(by), scratch.block_floats());
    }

    /// [`Fft2::convolve_block`] for one row, by `rustfft`.
    fn convolve_single_row(
        &self,
        row: &mut [Complex32],
        live: &[Range<usize>],
        by: &[Complex32],
        scratch: &mut Scratch,
    ) {
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

    /// Prepares the multiplier `row[ky] column[kx] w(k^2)` for [`Fft2::convolve_columns`], w being the weight
    /// of the band limit. `row` and `row_k2` have ny elements in FFT order, `column` and `column_k2` nx;
    /// `row_k2` and `column_k2` are squared frequencies in the unit of the band limit.
    pub(crate) fn multiplier(
        &self,
        row: &[Complex32],
        row_k2: &[f64],
        column: &[Complex32],
        column_k2: &[f64],
        band_limit: BandLimit,
    ) -> BandLimitedMultiplier {
        let natural: Vec<usize>;
        let order = match &self.columns {
            ColumnKernel::Blocked(plan) => plan.order(),
            ColumnKernel::Single { .. } => {
                natural = (0..self.ny).collect();
                &natural
            }
        };
        BandLimitedMultiplier::new(order, row, row_k2, column, column_k2, band_limit)
    }

    /// Forward transform of the columns of every wave, multiplication, inverse transform; unnormalised. Columns outside `ranges` are not
    /// changed; ranges are rounded up to whole SIMD vectors.
    pub(crate) fn convolve_columns<W: DerefMut<Target = [Complex32]>>(
        &self,
        waves: &mut [W],
        ranges: &[Range<usize>],
        multiplier: &BandLimitedMultiplier,
        scratch: &mut Scratch,
    ) {
        for range in ranges.iter().cloned() {
            match &self.columns {
                ColumnKernel::Blocked(plan) => {
                    plan.convolve(waves, self.stride, range, multiplier, scratch.block_floats())
                }
                ColumnKernel::Single { forward, inverse } => {
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
}
