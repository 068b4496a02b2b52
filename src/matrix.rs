//! Matrix products.

use num_complex::Complex32;

/// `out[m, n] = a[m, k] b[k, n]` on one thread. `out` and `b` are row-major with the given row strides;
/// `a` has a stride for rows and one for columns.
pub(crate) fn multiply<T: Number>(
    (m, n, k): (usize, usize, usize),
    (out, out_stride): (&mut [T], usize),
    (a, [a_row, a_column]): (&[T], [usize; 2]),
    (b, b_stride): (&[T], usize),
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
            T::ZERO,
            T::ONE,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// What matrices are made of.
pub(crate) trait Number: 'static {
    const ZERO: Self;
    const ONE: Self;
}

impl Number for f32 {
    const ZERO: f32 = 0.0;
    const ONE: f32 = 1.0;
}

impl Number for Complex32 {
    const ZERO: Complex32 = Complex32::ZERO;
    const ONE: Complex32 = Complex32::ONE;
}
