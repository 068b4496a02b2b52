//! Small discrete Fourier transforms on SIMD vectors, one transform per lane.
//!
//! All are unnormalised forward transforms, `X_q = sum_p x_p exp(-2 pi i p q / R)`. Swapping real and
//! imaginary parts before and after turns a forward transform into an inverse one.

use pulp::Simd;

/// Complex numbers, one per SIMD lane: (real parts, imaginary parts).
pub type Lanes<S> = (<S as Simd>::f32s, <S as Simd>::f32s);

#[inline(always)]
pub fn add<S: Simd>(s: S, a: Lanes<S>, b: Lanes<S>) -> Lanes<S> {
    (s.add_f32s(a.0, b.0), s.add_f32s(a.1, b.1))
}

#[inline(always)]
pub fn sub<S: Simd>(s: S, a: Lanes<S>, b: Lanes<S>) -> Lanes<S> {
    (s.sub_f32s(a.0, b.0), s.sub_f32s(a.1, b.1))
}

/// `-i a`
#[inline(always)]
fn minus_i<S: Simd>(s: S, a: Lanes<S>) -> Lanes<S> {
    (a.1, s.neg_f32s(a.0))
}

/// `a b`
#[inline(always)]
pub fn mul<S: Simd>(s: S, a: Lanes<S>, b: Lanes<S>) -> Lanes<S> {
    let re = s.negate_mul_add_f32s(a.1, b.1, s.mul_f32s(a.0, b.0));
    let im = s.mul_add_f32s(a.0, b.1, s.mul_f32s(a.1, b.0));
    (re, im)
}

/// `a conj(b)`
#[inline(always)]
pub fn mul_conj<S: Simd>(s: S, a: Lanes<S>, b: Lanes<S>) -> Lanes<S> {
    let re = s.mul_add_f32s(a.1, b.1, s.mul_f32s(a.0, b.0));
    let im = s.negate_mul_add_f32s(a.0, b.1, s.mul_f32s(a.1, b.0));
    (re, im)
}

/// Copies one complex number to all lanes.
#[inline(always)]
pub fn splat<S: Simd>(s: S, w: [f32; 2]) -> Lanes<S> {
    (s.splat_f32s(w[0]), s.splat_f32s(w[1]))
}

/// `a + w b` with a real constant.
#[inline(always)]
fn add_scaled<S: Simd>(s: S, a: Lanes<S>, w: S::f32s, b: Lanes<S>) -> Lanes<S> {
    (s.mul_add_f32s(w, b.0, a.0), s.mul_add_f32s(w, b.1, a.1))
}

#[inline(always)]
fn scale<S: Simd>(s: S, w: S::f32s, b: Lanes<S>) -> Lanes<S> {
    (s.mul_f32s(w, b.0), s.mul_f32s(w, b.1))
}

#[inline(always)]
fn dft3<S: Simd>(s: S, x: [Lanes<S>; 3]) -> [Lanes<S>; 3] {
    const SIN: f32 = 0.866_025_4;
    let sum = add(s, x[1], x[2]);
    let middle = add_scaled(s, x[0], s.splat_f32s(-0.5), sum);
    let side = minus_i(s, scale(s, s.splat_f32s(SIN), sub(s, x[1], x[2])));
    [add(s, x[0], sum), add(s, middle, side), sub(s, middle, side)]
}

#[inline(always)]
fn dft4<S: Simd>(s: S, x: [Lanes<S>; 4]) -> [Lanes<S>; 4] {
    let (a, b) = (add(s, x[0], x[2]), sub(s, x[0], x[2]));
    let (c, d) = (add(s, x[1], x[3]), minus_i(s, sub(s, x[1], x[3])));
    [add(s, a, c), add(s, b, d), sub(s, a, c), sub(s, b, d)]
}

#[inline(always)]
fn dft5<S: Simd>(s: S, x: [Lanes<S>; 5]) -> [Lanes<S>; 5] {
    // cos and sin of 2 pi / 5 and 4 pi / 5
    let (c1, c2) = (s.splat_f32s(0.309_017), s.splat_f32s(-0.809_017));
    let (s1, s2) = (s.splat_f32s(0.951_056_5), s.splat_f32s(0.587_785_24));
    let (p1, m1) = (add(s, x[1], x[4]), sub(s, x[1], x[4]));
    let (p2, m2) = (add(s, x[2], x[3]), sub(s, x[2], x[3]));
    let a1 = add_scaled(s, add_scaled(s, x[0], c1, p1), c2, p2);
    let a2 = add_scaled(s, add_scaled(s, x[0], c2, p1), c1, p2);
    let b1 = minus_i(s, add_scaled(s, scale(s, s1, m1), s2, m2));
    let b2 = minus_i(s, sub(s, scale(s, s2, m1), scale(s, s1, m2)));
    let sum = add(s, x[0], add(s, p1, p2));
    [sum, add(s, a1, b1), add(s, a2, b2), sub(s, a2, b2), sub(s, a1, b1)]
}

#[inline(always)]
fn dft8<S: Simd>(s: S, x: [Lanes<S>; 8]) -> [Lanes<S>; 8] {
    let even = dft4(s, [x[0], x[2], x[4], x[6]]);
    let odd = dft4(s, [x[1], x[3], x[5], x[7]]);
    let half = s.splat_f32s(std::f32::consts::FRAC_1_SQRT_2);
    // multiply by exp(-i pi / 4), -i, exp(-3 i pi / 4)
    let o1 = scale(s, half, add(s, odd[1], minus_i(s, odd[1])));
    let o2 = minus_i(s, odd[2]);
    let o3 = scale(s, half, sub(s, minus_i(s, odd[3]), odd[3]));
    let o = [odd[0], o1, o2, o3];
    [
        add(s, even[0], o[0]),
        add(s, even[1], o[1]),
        add(s, even[2], o[2]),
        add(s, even[3], o[3]),
        sub(s, even[0], o[0]),
        sub(s, even[1], o[1]),
        sub(s, even[2], o[2]),
        sub(s, even[3], o[3]),
    ]
}

/// Stores a transform of length `N` = `R`. Where the compiler does not inline across parts of the crate (without LTO, as tests are built),
/// `copy_from_slice` and `zip` are calls through memory, which double the time of a transform.
#[expect(clippy::manual_memcpy)]
#[inline(always)]
fn put<T: Copy, const R: usize, const N: usize>(x: &mut [T; R], y: [T; N]) {
    for k in 0..N.min(R) {
        x[k] = y[k];
    }
}

/// Forward transform of length `R` (2, 3, 4, 5 or 8), in place.
#[inline(always)]
pub fn dft<S: Simd, const R: usize>(s: S, x: &mut [Lanes<S>; R]) {
    match R {
        2 => {
            let (a, b) = (x[0], x[1]);
            x[0] = add(s, a, b);
            x[1] = sub(s, a, b);
        }
        3 => {
            let y = dft3(s, [x[0], x[1], x[2]]);
            put(x, y);
        }
        4 => {
            let y = dft4(s, [x[0], x[1], x[2], x[3]]);
            put(x, y);
        }
        5 => {
            let y = dft5(s, [x[0], x[1], x[2], x[3], x[4]]);
            put(x, y);
        }
        8 => {
            let y = dft8(s, [x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]]);
            put(x, y);
        }
        _ => unreachable!("radices are chosen by RadixPlan::new"),
    }
}

/// Inverse transform of length `R`, in place.
#[inline(always)]
pub fn inverse_dft<S: Simd, const R: usize>(s: S, x: &mut [Lanes<S>; R]) {
    for v in x.iter_mut() {
        *v = (v.1, v.0);
    }
    dft::<S, R>(s, x);
    for v in x.iter_mut() {
        *v = (v.1, v.0);
    }
}
