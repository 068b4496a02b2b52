//! Matrix products.

use num_complex::{Complex32, Complex64};

/// The product `out[m, n] = a[m, k] b[k, n]`, on one thread. `out` and `b` are row-major with the given row strides; `a` has a
/// stride for rows and one for columns.
pub(crate) fn multiply<T: MatrixElement>(
    (m, n, k): (usize, usize, usize),
    (out, out_stride): (&mut [T], usize),
    (a, [a_row, a_column]): (&[T], [usize; 2]),
    (b, b_stride): (&[T], usize),
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    let last = |count: usize, stride: usize| (count - 1).saturating_mul(stride);
    assert!(out.len() >= last(m, out_stride).saturating_add(n));
    assert!(a.len() > last(m, a_row).saturating_add(last(k, a_column)));
    assert!(b.len() >= last(k, b_stride).saturating_add(n));
    // SAFETY: the assertions cover every element that dimensions and strides reach; `out` is borrowed mutably, so it is neither of
    // the others.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            out_stride as isize,
            false,
            a.as_ptr(),
            a_column as isize,
            a_row as isize,
            b.as_ptr(),
            1,
            b_stride as isize,
            T::ZERO,
            T::ONE,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// Rows of a Gram matrix that are computed together, from their diagonal block on; the rest follows by symmetry.
const GRAM_ROWS: usize = 32;

/// The Gram matrix `out[i, j] = sum_k conj(a[i, k]) a[j, k]` for `n` rows of `a`, all row-major, on one thread.
pub(crate) fn gram(n: usize, a: &[Complex32], out: &mut [Complex32]) {
    let k = a.len() / n.max(1);
    assert!(a.len() == n * k && out.len() >= n * n);
    for first in (0..n).step_by(GRAM_ROWS) {
        let rows = GRAM_ROWS.min(n - first);
        // SAFETY: rows `first..first + rows` of `out`, columns from `first` on, and rows of `a` of `k` elements: all within them, as
        // asserted.
        unsafe {
            gemm::gemm(
                rows,
                n - first,
                k,
                out.as_mut_ptr().add(first * n + first),
                1,
                n as isize,
                false,
                a.as_ptr().add(first * k),
                1,
                k as isize,
                a.as_ptr().add(first * k),
                k as isize,
                1,
                Complex32::ZERO,
                Complex32::ONE,
                false,
                true,
                false,
                gemm::Parallelism::None,
            );
        }
    }
    for i in 0..n {
        for j in 0..i {
            out[i * n + j] = out[j * n + i].conj();
        }
    }
}

/// The elements of matrices.
pub(crate) trait MatrixElement: 'static {
    const ZERO: Self;
    const ONE: Self;
}

impl MatrixElement for f32 {
    const ZERO: f32 = 0.0;
    const ONE: f32 = 1.0;
}

impl MatrixElement for Complex64 {
    const ZERO: Complex64 = Complex64::ZERO;
    const ONE: Complex64 = Complex64::ONE;
}

impl MatrixElement for Complex32 {
    const ZERO: Complex32 = Complex32::ZERO;
    const ONE: Complex32 = Complex32::ONE;
}
