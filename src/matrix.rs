//! Complex matrix products.

use num_complex::Complex32;

/// `out[m, n] = a[m, k] b[k, n]` on one thread. `out` and `b` are row-major with the given row strides;
/// `a` has a stride for rows and one for columns.
pub(crate) fn multiply(
    (m, n, k): (usize, usize, usize),
    (out, out_stride): (&mut [Complex32], usize),
    (a, [a_row, a_column]): (&[Complex32], [usize; 2]),
    (b, b_stride): (&[Complex32], usize),
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    assert!(out.len() >= (m - 1) * out_stride + n);
    assert!(a.len() > (m - 1) * a_row + (k - 1) * a_column);
    assert!(b.len() >= (k - 1) * b_stride + n);
    // The assertions cover every element that dimensions and strides reach.
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
            Complex32::ZERO,
            Complex32::ONE,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}
