//! Fourier transforms down the columns of a matrix, one SIMD lane per column.
//!
//! A block of as many columns as the vector unit has lanes is transformed by an in-place
//! decimation-in-frequency scheme without transposes. The first pass reads the matrix and the last
//! writes it; what lies between stays in cache. For a convolution (transform, multiply, inverse
//! transform) the digit-reversed order in the middle is never undone: the multiplier is stored in
//! that order, and the innermost pass transforms, multiplies and transforms back in registers.

use super::butterfly::{Lanes, dft, inverse_dft, mul, mul_conj, splat};
use num_complex::Complex32;
use pulp::{Arch, Simd, WithSimd};

/// Radices tried, in this order, when a length is factorised.
const RADICES: [usize; 5] = [8, 5, 4, 3, 2];

#[derive(Debug, Clone)]
struct Stage {
    radix: usize,
    /// Length of the transforms that this stage splits.
    len: usize,
    /// `exp(-2 pi i j q / len)` for j in 0..len/radix (slow) and q in 1..radix (fast).
    twiddles: Vec<[f32; 2]>,
}

/// How to transform columns of `n` rows.
#[derive(Debug, Clone)]
pub struct ColumnPlan {
    n: usize,
    stages: Vec<Stage>,
    /// Frequency index found at each position after the forward passes.
    order: Vec<usize>,
}

/// An anti-aliasing disk in frequency space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// Squared radius: zero from here on.
    pub limit_k2: f64,
    /// Squared radius below which the disk is one. Between the two it falls as the smooth step
    /// `u^2 (3 - 2 u)` of the squared frequency, a cosine taper to 1 %.
    pub full_k2: f64,
}

impl Disk {
    /// One below `limit`, zero from there on.
    pub fn hard(limit: f64) -> Self {
        Disk { limit_k2: limit * limit, full_k2: limit * limit }
    }

    /// The weight at squared frequency `k2`.
    pub fn weight(&self, k2: f64) -> f64 {
        let u = ((self.limit_k2 - k2) * self.slope()).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    }

    /// Steep but finite for a hard edge, so that no weight is NaN.
    fn slope(&self) -> f64 {
        (self.limit_k2 - self.full_k2).max(1e-20).recip()
    }
}

/// A multiplier in frequency space that is separable but for a disk:
/// `row[ky] * column[kx] * disk(kx^2 + ky^2)`.
#[derive(Debug, Clone)]
pub struct DiskMultiplier {
    row: Vec<[f32; 2]>,
    row_room: Vec<f32>,
    column: Vec<[f32; 2]>,
    column_k2: Vec<[f32; 2]>,
    slope: f32,
}

impl DiskMultiplier {
    /// `row` and `column` are indexed by FFT frequency; `row_k2`, `column_k2` hold the squared
    /// frequencies, `order` the frequency index at each position of a transformed column.
    pub fn new(
        order: &[usize],
        row: &[Complex32],
        row_k2: &[f64],
        column: &[Complex32],
        column_k2: &[f64],
        disk: Disk,
    ) -> Self {
        let padded = column.len() + lanes();
        let column_at = |x: usize| column.get(x).map_or([0.0; 2], |c| [c.re, c.im]);
        let k2_at = |x: usize| column_k2.get(x).map_or([f32::INFINITY; 2], |&k| [k as f32; 2]);
        DiskMultiplier {
            row: order.iter().map(|&y| [row[y].re, row[y].im]).collect(),
            row_room: order.iter().map(|&y| (disk.limit_k2 - row_k2[y]) as f32).collect(),
            column: (0..padded).map(column_at).collect(),
            column_k2: (0..padded).map(k2_at).collect(),
            slope: disk.slope() as f32,
        }
    }

    /// Multiplies column `x`, whose elements are in this multiplier's order.
    pub fn apply(&self, x: usize, column: &mut [Complex32]) {
        let [re, im] = self.column[x];
        for (y, v) in column.iter_mut().enumerate() {
            let [a, b] = self.row[y];
            let u = ((self.row_room[y] - self.column_k2[x][0]) * self.slope).clamp(0.0, 1.0);
            let weight = u * u * (3.0 - 2.0 * u);
            *v *= Complex32::new(re, im) * Complex32::new(a, b) * weight;
        }
    }
}

/// Factorises into 8, 5, 4, 3, 2; `None` when another prime is left or there are fewer than two
/// factors. Small radices come last: the last pass is fused with the multiplication.
fn factorise(mut n: usize) -> Option<Vec<usize>> {
    let mut factors = Vec::new();
    for radix in RADICES {
        while n > 1 && n.is_multiple_of(radix) {
            // 16 = 4 * 4 and 2 r = never a lone 2 after an 8
            if radix == 8 && n / 8 == 2 {
                break;
            }
            factors.push(radix);
            n /= radix;
        }
    }
    (n == 1 && factors.len() >= 2).then_some(factors)
}

impl ColumnPlan {
    /// A plan for `n` rows, or `None` when `n` has prime factors other than 2, 3 and 5 or is tiny.
    pub fn new(n: usize) -> Option<Self> {
        let mut len = n;
        let mut stages = Vec::new();
        for radix in factorise(n)? {
            let mut twiddles = Vec::with_capacity(len);
            for j in 0..len / radix {
                for q in 1..radix {
                    let (sin, cos) =
                        (-2.0 * std::f64::consts::PI * (j * q) as f64 / len as f64).sin_cos();
                    twiddles.push([cos as f32, sin as f32]);
                }
            }
            stages.push(Stage { radix, len, twiddles });
            len /= radix;
        }
        let order = (0..n)
            .map(|position| {
                let (mut rest, mut weight, mut frequency) = (position, 1, 0);
                for stage in &stages {
                    let sub = stage.len / stage.radix;
                    frequency += rest / sub * weight;
                    rest %= sub;
                    weight *= stage.radix;
                }
                frequency
            })
            .collect();
        Some(ColumnPlan { n, stages, order })
    }

    /// The radices in the order in which they are applied.
    pub fn radices(&self) -> Vec<usize> {
        self.stages.iter().map(|s| s.radix).collect()
    }

    /// Number of `f32` that the scratch of every call must have room for.
    pub fn scratch_len(&self) -> usize {
        self.n * 2 * lanes()
    }

    /// Frequency index found at each position after the forward passes.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Transforms `columns` of `data` (rows of length `stride`), multiplies and transforms back,
    /// unnormalised. The range is rounded up to whole vectors: the rows must be padded, see
    /// [`lanes`].
    pub fn convolve(
        &self,
        data: &mut [Complex32],
        stride: usize,
        columns: std::ops::Range<usize>,
        multiplier: &DiskMultiplier,
        scratch: &mut [f32],
    ) {
        self.run(data, stride, columns, Task::Convolve(multiplier), scratch);
    }

    /// Transforms columns in place, natural order to natural order, unnormalised.
    pub fn transform(
        &self,
        data: &mut [Complex32],
        stride: usize,
        columns: std::ops::Range<usize>,
        inverse: bool,
        scratch: &mut [f32],
    ) {
        self.run(data, stride, columns, Task::Transform { inverse }, scratch);
    }

    fn run(
        &self,
        data: &mut [Complex32],
        stride: usize,
        columns: std::ops::Range<usize>,
        task: Task<'_>,
        scratch: &mut [f32],
    ) {
        let end = columns.start + columns.len().next_multiple_of(lanes());
        assert!(end <= stride && data.len() >= self.n * stride, "rows are not padded to lanes");
        assert!(scratch.len() >= self.scratch_len());
        // Complex32 is repr(C) of two f32.
        let data: &mut [f32] = unsafe {
            std::slice::from_raw_parts_mut(data.as_mut_ptr().cast::<f32>(), data.len() * 2)
        };
        Arch::new().dispatch(Run { plan: self, data, stride, columns, task, scratch });
    }
}

/// SIMD lanes of this processor: columns are handled in blocks of this many, and rows must be
/// padded so that the last block fits.
pub fn lanes() -> usize {
    struct Count;
    impl WithSimd for Count {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    Arch::new().dispatch(Count)
}

#[derive(Clone, Copy)]
enum Task<'a> {
    Convolve(&'a DiskMultiplier),
    Transform { inverse: bool },
}

struct Run<'a> {
    plan: &'a ColumnPlan,
    data: &'a mut [f32],
    stride: usize,
    columns: std::ops::Range<usize>,
    task: Task<'a>,
    scratch: &'a mut [f32],
}

impl WithSimd for Run<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (scratch, _) = S::as_mut_simd_f32s(self.scratch);
        for first in self.columns.step_by(S::F32_LANES) {
            let mut block = Block {
                simd,
                plan: self.plan,
                data: self.data.as_mut_ptr(),
                stride: 2 * self.stride,
                column: first,
                scratch: scratch.as_mut_ptr().cast(),
            };
            // Bounds were checked by ColumnPlan::run for all rows and for whole vectors.
            unsafe {
                match self.task {
                    Task::Convolve(m) => block.convolve(m),
                    Task::Transform { inverse: false } => block.transform::<false>(),
                    Task::Transform { inverse: true } => block.transform::<true>(),
                }
            }
        }
    }
}

/// One block of columns. `data` and `scratch` are raw because passes read and write them with
/// strides that slices would check at every access.
struct Block<'a, S: Simd> {
    simd: S,
    plan: &'a ColumnPlan,
    data: *mut f32,
    stride: usize,
    column: usize,
    scratch: *mut Lanes<S>,
}

/// Calls a method that is generic over the radix.
macro_rules! by_radix {
    ($radix:expr, $self:ident.$method:ident($($arg:expr),*)) => {
        match $radix {
            2 => $self.$method::<2>($($arg),*),
            3 => $self.$method::<3>($($arg),*),
            4 => $self.$method::<4>($($arg),*),
            5 => $self.$method::<5>($($arg),*),
            _ => $self.$method::<8>($($arg),*),
        }
    };
}

impl<S: Simd> Block<'_, S> {
    #[inline(always)]
    unsafe fn load(&self, row: usize) -> Lanes<S> {
        unsafe {
            let at = self.data.add(row * self.stride + 2 * self.column).cast::<[S::f32s; 2]>();
            let [re, im] = self.simd.deinterleave_shfl_f32s(at.read_unaligned());
            (re, im)
        }
    }

    #[inline(always)]
    unsafe fn store(&self, row: usize, v: Lanes<S>) {
        unsafe {
            let at = self.data.add(row * self.stride + 2 * self.column).cast::<[S::f32s; 2]>();
            at.write_unaligned(self.simd.interleave_shfl_f32s([v.0, v.1]));
        }
    }

    /// Column factors in the lane order that `load` produces.
    #[inline(always)]
    unsafe fn column_values(&self, values: &[[f32; 2]]) -> Lanes<S> {
        unsafe {
            let at = values.as_ptr().add(self.column).cast::<[S::f32s; 2]>();
            let [a, b] = self.simd.deinterleave_shfl_f32s(at.read_unaligned());
            (a, b)
        }
    }

    #[inline(always)]
    unsafe fn convolve(&mut self, m: &DiskMultiplier) {
        unsafe {
            let first = self.plan.stages[0].radix;
            by_radix!(first, self.first_forward(false));
            let sub = self.plan.n / first;
            let column = self.column_values(&m.column);
            let k2 = self.column_values(&m.column_k2).0;
            for part in 0..first {
                self.convolve_part(1, part * sub, m, column, k2);
            }
            by_radix!(first, self.last_inverse());
        }
    }

    #[inline(always)]
    unsafe fn convolve_part(
        &mut self,
        level: usize,
        base: usize,
        m: &DiskMultiplier,
        column: Lanes<S>,
        k2: S::f32s,
    ) {
        // At most 7 levels below the first; written as loops over positions rather than by
        // recursion, which could not be inlined into the SIMD context.
        unsafe {
            let stages = &self.plan.stages;
            let last = stages.len() - 1;
            let len = stages[level].len;
            for l in level..last {
                let mut at = base;
                while at < base + len {
                    by_radix!(stages[l].radix, self.forward(&stages[l], at));
                    at += stages[l].len;
                }
            }
            let mut at = base;
            while at < base + len {
                by_radix!(stages[last].radix, self.innermost(at, m, column, k2));
                at += stages[last].len;
            }
            for l in (level..last).rev() {
                let mut at = base;
                while at < base + len {
                    by_radix!(stages[l].radix, self.inverse(&stages[l], at));
                    at += stages[l].len;
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn transform<const INVERSE: bool>(&mut self) {
        unsafe {
            let stages = &self.plan.stages;
            by_radix!(stages[0].radix, self.first_forward(INVERSE));
            for stage in &stages[1..] {
                let mut at = 0;
                while at < self.plan.n {
                    by_radix!(stage.radix, self.forward(stage, at));
                    at += stage.len;
                }
            }
            for (position, &row) in self.plan.order.iter().enumerate() {
                let v = *self.scratch.add(position);
                self.store(row, if INVERSE { (v.1, v.0) } else { v });
            }
        }
    }

    /// First pass: matrix to scratch. `swapped` exchanges real and imaginary parts.
    #[inline(always)]
    unsafe fn first_forward<const R: usize>(&mut self, swapped: bool) {
        unsafe {
            let stage = &self.plan.stages[0];
            let sub = stage.len / R;
            for j in 0..sub {
                let mut x = [self.load(j); R];
                for q in 1..R {
                    x[q] = self.load(j + q * sub);
                }
                if swapped {
                    for v in &mut x {
                        *v = (v.1, v.0);
                    }
                }
                self.butterfly_and_twiddle(&mut x, stage, j);
                for q in 0..R {
                    *self.scratch.add(j + q * sub) = x[q];
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn butterfly_and_twiddle<const R: usize>(
        &self,
        x: &mut [Lanes<S>; R],
        stage: &Stage,
        j: usize,
    ) {
        unsafe {
            dft::<S, R>(self.simd, x);
            let w = stage.twiddles.as_ptr().add(j * (R - 1));
            for q in 1..R {
                x[q] = mul(self.simd, x[q], splat(self.simd, *w.add(q - 1)));
            }
        }
    }

    #[inline(always)]
    unsafe fn forward<const R: usize>(&mut self, stage: &Stage, base: usize) {
        unsafe {
            let sub = stage.len / R;
            for j in 0..sub {
                let p = self.scratch.add(base + j);
                let mut x = [*p; R];
                for q in 1..R {
                    x[q] = *p.add(q * sub);
                }
                self.butterfly_and_twiddle(&mut x, stage, j);
                for q in 0..R {
                    *p.add(q * sub) = x[q];
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn untwiddle_and_butterfly<const R: usize>(
        &self,
        stage: &Stage,
        base: usize,
        j: usize,
    ) -> [Lanes<S>; R] {
        unsafe {
            let sub = stage.len / R;
            let p = self.scratch.add(base + j);
            let w = stage.twiddles.as_ptr().add(j * (R - 1));
            let mut x = [*p; R];
            for q in 1..R {
                x[q] = mul_conj(self.simd, *p.add(q * sub), splat(self.simd, *w.add(q - 1)));
            }
            inverse_dft::<S, R>(self.simd, &mut x);
            x
        }
    }

    #[inline(always)]
    unsafe fn inverse<const R: usize>(&mut self, stage: &Stage, base: usize) {
        unsafe {
            let sub = stage.len / R;
            for j in 0..sub {
                let x = self.untwiddle_and_butterfly::<R>(stage, base, j);
                for q in 0..R {
                    *self.scratch.add(base + j + q * sub) = x[q];
                }
            }
        }
    }

    /// Last pass: scratch to matrix.
    #[inline(always)]
    unsafe fn last_inverse<const R: usize>(&mut self) {
        unsafe {
            let stage = &self.plan.stages[0];
            let sub = stage.len / R;
            for j in 0..sub {
                let x = self.untwiddle_and_butterfly::<R>(stage, 0, j);
                for q in 0..R {
                    self.store(j + q * sub, x[q]);
                }
            }
        }
    }

    /// Final forward stage, multiplication and first inverse stage without leaving registers.
    #[inline(always)]
    unsafe fn innermost<const R: usize>(
        &mut self,
        base: usize,
        m: &DiskMultiplier,
        column: Lanes<S>,
        k2: S::f32s,
    ) {
        unsafe {
            let s = self.simd;
            let p = self.scratch.add(base);
            let mut x = [*p; R];
            for q in 1..R {
                x[q] = *p.add(q);
            }
            dft::<S, R>(s, &mut x);
            let (zero, one) = (s.splat_f32s(0.0), s.splat_f32s(1.0));
            let (two, three) = (s.splat_f32s(2.0), s.splat_f32s(3.0));
            let slope = s.splat_f32s(m.slope);
            for q in 0..R {
                let room = s.splat_f32s(*m.row_room.as_ptr().add(base + q));
                let u = s.mul_f32s(s.sub_f32s(room, k2), slope);
                let u = s.min_f32s(s.max_f32s(u, zero), one);
                let weight = s.mul_f32s(s.mul_f32s(u, u), s.negate_mul_add_f32s(two, u, three));
                let row = splat(s, *m.row.as_ptr().add(base + q));
                let v = mul(s, x[q], mul(s, column, row));
                x[q] = (s.mul_f32s(v.0, weight), s.mul_f32s(v.1, weight));
            }
            inverse_dft::<S, R>(s, &mut x);
            for q in 0..R {
                *p.add(q) = x[q];
            }
        }
    }
}
