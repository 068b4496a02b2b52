//! Transforms to real arrays.

use super::fft2::{Fft2, Scratch};
use crate::simd::vectorised;
use num_complex::Complex32;

impl Fft2 {
    /// Inverse transform to a real array, unnormalised.
    ///
    /// On entry the first `nx / 2 + 1` columns of `data` (a [`Fft2::buffer`]) hold the half plane kx >= 0 of
    /// the spectrum; the other columns may hold anything. On return the real array lies in pairs of rows: the
    /// real parts of row `r` are its row `2 r`, the imaginary parts its row `2 r + 1` ([`Fft2::of_pair`]).
    pub(crate) fn inverse_real(&self, data: &mut [Complex32], scratch: &mut Scratch) {
        let ((ny, nx), stride) = (self.shape(), self.stride());
        let half = nx / 2 + 1;
        self.some_columns(data, 0..half, true, scratch);
        let (mut a, mut b) = (vec![Complex32::ZERO; half], vec![Complex32::ZERO; half]);
        for r in 0..ny.div_ceil(2) {
            // Row r is read (in an earlier turn, or now) before it is overwritten.
            a.copy_from_slice(&data[2 * r * stride..][..half]);
            match 2 * r + 1 < ny {
                true => b.copy_from_slice(&data[(2 * r + 1) * stride..][..half]),
                false => b.fill(Complex32::ZERO),
            }
            let row = &mut data[r * stride..][..nx];
            let (low, high) = row.split_at_mut(half);
            vectorised(
                #[inline(always)]
                || {
                    for ((v, a), b) in low.iter_mut().zip(&a).zip(&b) {
                        *v = Complex32::new(a.re - b.im, a.im + b.re);
                    }
                    // conj(a) + i conj(b) at the opposite frequencies
                    let opposite = a[1..].iter().zip(&b[1..]);
                    for (v, (a, b)) in high.iter_mut().rev().zip(opposite) {
                        *v = Complex32::new(a.re + b.im, b.re - a.im);
                    }
                },
            );
        }
        self.some_rows(data, ny.div_ceil(2), true, scratch);
    }

    /// The value at row `y`, column `x` of the real array that [`Fft2::inverse_real`] left in `data`.
    pub(crate) fn of_pair(&self, data: &[Complex32], y: usize, x: usize) -> f32 {
        let pair = data[y / 2 * self.stride() + x];
        if y.is_multiple_of(2) { pair.re } else { pair.im }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the complex transform of the whole spectrum, for even and odd shapes, with and without SIMD blocks.
    #[test]
    fn the_half_plane_gives_what_the_plane_gives() {
        for (ny, nx) in [(48, 30), (45, 32), (27, 25), (14, 22), (1, 8), (16, 1)] {
            let fft = Fft2::new(ny, nx);
            let (mut whole, mut scratch) = (fft.buffer(), fft.scratch());
            let value = |y: usize, x: usize| ((y * 131 + x * 71) % 97) as f32 / 97.0 - 0.4;
            for y in 0..ny {
                for x in 0..nx {
                    whole[y * fft.stride() + x] = value(y, x).into();
                }
            }
            fft.forward(&mut whole, &mut scratch);
            let mut half = fft.buffer();
            half.fill(Complex32::new(9.0, 9.0));
            for y in 0..ny {
                let row = y * fft.stride()..y * fft.stride() + nx / 2 + 1;
                half[row.clone()].copy_from_slice(&whole[row]);
            }
            fft.inverse_real(&mut half, &mut scratch);
            for y in 0..ny {
                for x in 0..nx {
                    let v = fft.of_pair(&half, y, x) / (nx * ny) as f32;
                    assert!((v - value(y, x)).abs() < 1e-6, "{ny} x {nx}, ({y}, {x}): {v}");
                }
            }
        }
    }
}
