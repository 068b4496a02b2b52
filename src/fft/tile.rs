//! Moves complex numbers between memory and SIMD lanes: splits them into real and imaginary parts, and transposes
//! tiles of rows so that each lane holds one row.
//!
//! The order of lanes within a vector is the cheapest one on the processor. It is the same for everything that these functions load, so
//! lanes of different arrays always match.

use super::butterfly::Lanes;
use pulp::Simd;
use std::mem::size_of;

/// Most columns of a tile.
pub const MOST_COLUMNS: usize = 8;

/// Columns of a tile. A tile has as many rows as there are lanes, and each row of it fills one vector.
pub const fn columns<S: Simd>() -> usize {
    if S::F32_LANES < 2 { 1 } else { S::F32_LANES / 2 }
}

/// Checks the assumptions of pointers to the floats of lanes: lanes are two vectors of floats and nothing else, and a tile's array has room
/// for all columns.
const fn check_layout<S: Simd>() {
    assert!(size_of::<Lanes<S>>() == 2 * S::F32_LANES * size_of::<f32>());
    assert!(columns::<S>() <= MOST_COLUMNS);
}

/// Splits two vectors of interleaved complex numbers.
#[inline(always)]
pub fn split<S: Simd>(simd: S, pair: [S::f32s; 2]) -> Lanes<S> {
    // SAFETY: `simd` is there only on processors that have its instructions.
    #[cfg(target_arch = "x86_64")]
    if let Some(lanes) = unsafe { x86::split::<S>(pair) } {
        return lanes;
    }
    let [re, im] = simd.deinterleave_shfl_f32s(pair);
    (re, im)
}

/// Inverts [`split`].
#[inline(always)]
pub fn join<S: Simd>(simd: S, v: Lanes<S>) -> [S::f32s; 2] {
    // SAFETY: `simd` is there only on processors that have its instructions.
    #[cfg(target_arch = "x86_64")]
    if let Some(pair) = unsafe { x86::join::<S>(v) } {
        return pair;
    }
    simd.interleave_shfl_f32s([v.0, v.1])
}

/// Loads a tile of as many rows as there are lanes, `stride` floats apart: element `c` of the result
/// holds column `c` of [`columns`].
///
/// # Safety
/// `tile` must be readable over [`columns`] complex numbers in each of the rows.
#[inline(always)]
pub unsafe fn load<S: Simd>(simd: S, tile: *const f32, stride: usize) -> [Lanes<S>; MOST_COLUMNS] {
    // SAFETY: `simd` is there only on processors that have its instructions, and the caller vouches for the tile.
    #[cfg(target_arch = "x86_64")]
    if let Some(lanes) = unsafe { x86::load::<S>(tile, stride) } {
        return lanes;
    }
    let zero = simd.splat_f32s(0.0);
    let mut out = [(zero, zero); MOST_COLUMNS];
    const { check_layout::<S>() };
    let lanes: *mut f32 = out.as_mut_ptr().cast();
    for row in 0..S::F32_LANES {
        for column in 0..columns::<S>() {
            for part in 0..2 {
                let at = (column * 2 + part) * S::F32_LANES + row;
                // SAFETY: `out` has this float (`check_layout`); the caller vouches for the tile.
                unsafe {
                    *lanes.add(at) = *tile.add(row * stride + 2 * column + part);
                }
            }
        }
    }
    out
}

/// Inverts [`load`].
///
/// # Safety
/// As for [`load`], with `tile` writable; the processor must have the instructions of `S`.
#[inline(always)]
pub unsafe fn store<S: Simd>(v: &[Lanes<S>; MOST_COLUMNS], tile: *mut f32, stride: usize) {
    // SAFETY: the caller vouches for the processor and for the tile.
    #[cfg(target_arch = "x86_64")]
    if unsafe { x86::store::<S>(v, tile, stride) } {
        return;
    }
    const { check_layout::<S>() };
    let lanes: *const f32 = v.as_ptr().cast();
    for row in 0..S::F32_LANES {
        for column in 0..columns::<S>() {
            for part in 0..2 {
                let at = (column * 2 + part) * S::F32_LANES + row;
                // SAFETY: `v` has this float (`check_layout`); the caller vouches for the tile.
                unsafe {
                    *tile.add(row * stride + 2 * column + part) = *lanes.add(at);
                }
            }
        }
    }
}

/// Shuffles of AVX-512 and AVX2 for these functions. Every function asks which instruction set `S` stands for; the answer is known at
/// compile time.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Lanes, MOST_COLUMNS, Simd};
    use pulp::x86::{V3, V4};
    use std::any::TypeId;
    use std::arch::x86_64::*;
    use std::mem::transmute_copy;

    #[inline(always)]
    fn is<S: Simd, T: 'static>() -> bool {
        TypeId::of::<S>() == TypeId::of::<T>()
    }

    /// # Safety
    /// The processor must have the instructions of `S`.
    #[inline(always)]
    pub unsafe fn split<S: Simd>(pair: [S::f32s; 2]) -> Option<Lanes<S>> {
        // SAFETY: in each branch S::f32s are as many floats as the vector type that the function takes, any floats are valid in
        // either, and S has the function's instructions.
        unsafe {
            if is::<S, V4>() {
                return Some(transmute_copy(&split512(transmute_copy(&pair))));
            }
            if is::<S, V3>() {
                return Some(transmute_copy(&split256(transmute_copy(&pair))));
            }
        }
        None
    }

    /// # Safety
    /// The processor must have the instructions of `S`.
    #[inline(always)]
    pub unsafe fn join<S: Simd>(v: Lanes<S>) -> Option<[S::f32s; 2]> {
        let v = [v.0, v.1];
        // SAFETY: as in `split`.
        unsafe {
            if is::<S, V4>() {
                return Some(transmute_copy(&join512(transmute_copy(&v))));
            }
            if is::<S, V3>() {
                return Some(transmute_copy(&join256(transmute_copy(&v))));
            }
        }
        None
    }

    /// # Safety
    /// As for [`super::load`]; the processor must have the instructions of `S`.
    #[inline(always)]
    pub unsafe fn load<S: Simd>(
        tile: *const f32,
        stride: usize,
    ) -> Option<[Lanes<S>; MOST_COLUMNS]> {
        // SAFETY: as in `split`; the caller vouches for the tile.
        unsafe {
            if is::<S, V4>() {
                return Some(transmute_copy(&load512(tile, stride)));
            }
            if is::<S, V3>() {
                let mut out = [[_mm256_setzero_ps(); 2]; MOST_COLUMNS];
                [out[0], out[1], out[2], out[3]] = load256(tile, stride);
                return Some(transmute_copy(&out));
            }
        }
        None
    }

    /// # Safety
    /// As for [`super::store`].
    #[inline(always)]
    pub unsafe fn store<S: Simd>(
        v: &[Lanes<S>; MOST_COLUMNS],
        tile: *mut f32,
        stride: usize,
    ) -> bool {
        // SAFETY: as in `split`; the caller vouches for the tile.
        unsafe {
            if is::<S, V4>() {
                store512(transmute_copy(v), tile, stride);
                return true;
            }
            if is::<S, V3>() {
                let all: [[__m256; 2]; MOST_COLUMNS] = transmute_copy(v);
                store256([all[0], all[1], all[2], all[3]], tile, stride);
                return true;
            }
        }
        false
    }

    /// # Safety
    /// The processor must have AVX-512F.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn split512([a, b]: [__m512; 2]) -> [__m512; 2] {
        [_mm512_shuffle_ps::<0x88>(a, b), _mm512_shuffle_ps::<0xDD>(a, b)]
    }

    /// # Safety
    /// The processor must have AVX-512F.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn join512([re, im]: [__m512; 2]) -> [__m512; 2] {
        [_mm512_unpacklo_ps(re, im), _mm512_unpackhi_ps(re, im)]
    }

    /// # Safety
    /// The processor must have AVX2.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn split256([a, b]: [__m256; 2]) -> [__m256; 2] {
        [_mm256_shuffle_ps::<0x88>(a, b), _mm256_shuffle_ps::<0xDD>(a, b)]
    }

    /// # Safety
    /// The processor must have AVX2.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn join256([re, im]: [__m256; 2]) -> [__m256; 2] {
        [_mm256_unpacklo_ps(re, im), _mm256_unpackhi_ps(re, im)]
    }

    /// # Safety
    /// `tile` must be readable over 8 complex numbers in each of 16 rows.
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn load512(tile: *const f32, stride: usize) -> [[__m512; 2]; 8] {
        let mut halves = [[_mm512_setzero_pd(); 8]; 2];
        for (h, half) in halves.iter_mut().enumerate() {
            for (r, row) in half.iter_mut().enumerate() {
                // SAFETY: 8 complex numbers of row 8 h + r < 16.
                *row = unsafe { _mm512_loadu_pd(tile.add((8 * h + r) * stride).cast()) };
            }
            *half = transpose8(*half);
        }
        let mut out = [[_mm512_setzero_ps(); 2]; 8];
        for c in 0..8 {
            out[c] = split512([_mm512_castpd_ps(halves[0][c]), _mm512_castpd_ps(halves[1][c])]);
        }
        out
    }

    /// # Safety
    /// `tile` must be writable over 8 complex numbers in each of 16 rows.
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn store512(v: [[__m512; 2]; 8], tile: *mut f32, stride: usize) {
        let mut halves = [[_mm512_setzero_pd(); 8]; 2];
        for c in 0..8 {
            let [low, high] = join512(v[c]);
            (halves[0][c], halves[1][c]) = (_mm512_castps_pd(low), _mm512_castps_pd(high));
        }
        for (h, half) in halves.into_iter().enumerate() {
            for (r, row) in transpose8(half).into_iter().enumerate() {
                // SAFETY: 8 complex numbers of row 8 h + r < 16.
                unsafe { _mm512_storeu_pd(tile.add((8 * h + r) * stride).cast(), row) };
            }
        }
    }

    /// # Safety
    /// `tile` must be readable over 4 complex numbers in each of 8 rows.
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn load256(tile: *const f32, stride: usize) -> [[__m256; 2]; 4] {
        let mut halves = [[_mm256_setzero_pd(); 4]; 2];
        for (h, half) in halves.iter_mut().enumerate() {
            for (r, row) in half.iter_mut().enumerate() {
                // SAFETY: 4 complex numbers of row 4 h + r < 8.
                *row = unsafe { _mm256_loadu_pd(tile.add((4 * h + r) * stride).cast()) };
            }
            *half = transpose4(*half);
        }
        let mut out = [[_mm256_setzero_ps(); 2]; 4];
        for c in 0..4 {
            out[c] = split256([_mm256_castpd_ps(halves[0][c]), _mm256_castpd_ps(halves[1][c])]);
        }
        out
    }

    /// # Safety
    /// `tile` must be writable over 4 complex numbers in each of 8 rows.
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn store256(v: [[__m256; 2]; 4], tile: *mut f32, stride: usize) {
        let mut halves = [[_mm256_setzero_pd(); 4]; 2];
        for c in 0..4 {
            let [low, high] = join256(v[c]);
            (halves[0][c], halves[1][c]) = (_mm256_castps_pd(low), _mm256_castps_pd(high));
        }
        for (h, half) in halves.into_iter().enumerate() {
            for (r, row) in transpose4(half).into_iter().enumerate() {
                // SAFETY: 4 complex numbers of row 4 h + r < 8.
                unsafe { _mm256_storeu_pd(tile.add((4 * h + r) * stride).cast(), row) };
            }
        }
    }

    /// Transposes eight rows of eight 64-bit elements.
    ///
    /// # Safety
    /// The processor must have AVX-512F.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn transpose8(r: [__m512d; 8]) -> [__m512d; 8] {
        let mut out = r;
        // even, then odd columns: pairs of rows, then 4 x 4 blocks of 128 bits
        for odd in 0..2 {
            let mut p = [r[0]; 4];
            for i in 0..4 {
                let (a, b) = (r[2 * i], r[2 * i + 1]);
                p[i] = if odd == 0 { _mm512_unpacklo_pd(a, b) } else { _mm512_unpackhi_pd(a, b) };
            }
            let ab = _mm512_shuffle_f64x2::<0x44>(p[0], p[1]);
            let cd = _mm512_shuffle_f64x2::<0x44>(p[2], p[3]);
            let ef = _mm512_shuffle_f64x2::<0xEE>(p[0], p[1]);
            let gh = _mm512_shuffle_f64x2::<0xEE>(p[2], p[3]);
            out[odd] = _mm512_shuffle_f64x2::<0x88>(ab, cd);
            out[2 + odd] = _mm512_shuffle_f64x2::<0xDD>(ab, cd);
            out[4 + odd] = _mm512_shuffle_f64x2::<0x88>(ef, gh);
            out[6 + odd] = _mm512_shuffle_f64x2::<0xDD>(ef, gh);
        }
        out
    }

    /// Transposes four rows of four 64-bit elements.
    ///
    /// # Safety
    /// The processor must have AVX2.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn transpose4(r: [__m256d; 4]) -> [__m256d; 4] {
        let (a, b) = (_mm256_unpacklo_pd(r[0], r[1]), _mm256_unpackhi_pd(r[0], r[1]));
        let (c, d) = (_mm256_unpacklo_pd(r[2], r[3]), _mm256_unpackhi_pd(r[2], r[3]));
        [
            _mm256_permute2f128_pd::<0x20>(a, c),
            _mm256_permute2f128_pd::<0x20>(b, d),
            _mm256_permute2f128_pd::<0x31>(a, c),
            _mm256_permute2f128_pd::<0x31>(b, d),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    struct TransposeAndRestore;
    impl WithSimd for TransposeAndRestore {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            let (rows, width) = (S::F32_LANES, columns::<S>());
            let stride = 2 * width + 5;
            let data: Vec<f32> = (0..rows * stride).map(|i| i as f32).collect();
            let mut back = vec![0.0; data.len()];
            let first_row: *const f32 = data.as_ptr();
            // SAFETY: both arrays have as many rows as a tile, `stride` apart, and a tile's row is shorter; `column` holds two
            // vectors.
            unsafe {
                let tile = load(simd, first_row, stride);
                store::<S>(&tile, back.as_mut_ptr(), stride);
                // Every lane holds one row, with all columns in the same order of lanes.
                let floats: *const f32 = tile.as_ptr().cast();
                for lane in 0..rows {
                    let row = (*floats.add(lane) / stride as f32) as usize;
                    for c in 0..width {
                        for part in 0..2 {
                            let value = *floats.add((2 * c + part) * rows + lane);
                            assert_eq!(value, data[row * stride + 2 * c + part]);
                        }
                    }
                }
                // split() puts its numbers into the order of lanes that load() uses.
                let column: Vec<f32> =
                    (0..rows).flat_map(|r| [data[r * stride], data[r * stride + 1]]).collect();
                let pair = column.as_ptr().cast::<[S::f32s; 2]>().read_unaligned();
                let v = split(simd, pair);
                assert_eq!(format!("{v:?}"), format!("{:?}", tile[0]));
                assert_eq!(format!("{:?}", join(simd, v)), format!("{pair:?}"));
            }
            for r in 0..rows {
                let row = r * stride..r * stride + 2 * width;
                assert_eq!(data[row.clone()], back[row]);
            }
        }
    }

    #[test]
    fn tiles_are_transposed_and_restored() {
        Arch::new().dispatch(TransposeAndRestore);
        Simd::vectorize(pulp::Scalar::new(), TransposeAndRestore);
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            Simd::vectorize(simd, TransposeAndRestore);
        }
    }
}
