//! In-place passes of a Fourier transform over numbers in SIMD lanes, one transform per lane.
//!
//! Forward transforms decimate in frequency, inverse ones in time: the spectrum between them stays in
//! digit-reversed order. The last forward pass, the multiplication and the first inverse pass are done
//! together in registers.

use super::butterfly::{Lanes, dft, inverse_dft, mul, mul_conj, splat};
use super::radix_plan::{RadixPlan, RadixStage};
use pulp::Simd;

/// The operation on each number between a transform and its inverse; `position` counts in the plan's order.
pub trait Middle<S: Simd> {
    /// # Safety
    /// `position` must be below the plan's length.
    unsafe fn apply(&self, simd: S, position: usize, v: Lanes<S>) -> Lanes<S>;
}

/// The numbers under transformation.
///
/// `data` is raw because passes read and write with strides that slices would check at every access. Every method needs `data` to
/// point to as many numbers as the plan has, which nothing else reads or writes meanwhile. A stage that splits transforms of `len`
/// numbers into `radix` parts then stays within them: `base` is a multiple of `len`, which divides the plan's length, so
/// `base + j + q len / radix` with `j < len / radix` and `q < radix` is below it, and `twiddles` has `radix - 1` elements for each j.
pub struct RadixPasses<'a, S: Simd> {
    pub simd: S,
    pub plan: &'a RadixPlan,
    pub data: *mut Lanes<S>,
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
/// As [`by_radix`], for methods that take a second generic argument.
macro_rules! by_radix_with {
    ($radix:expr, $self:ident.$method:ident($($arg:expr),*)) => {
        match $radix {
            2 => $self.$method::<2, _>($($arg),*),
            3 => $self.$method::<3, _>($($arg),*),
            4 => $self.$method::<4, _>($($arg),*),
            5 => $self.$method::<5, _>($($arg),*),
            _ => $self.$method::<8, _>($($arg),*),
        }
    };
}
pub(super) use by_radix;

impl<S: Simd> RadixPasses<'_, S> {
    /// Stages `from..` forward.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers.
    #[inline(always)]
    pub unsafe fn forward_from(&self, from: usize) {
        // SAFETY: the stages are the plan's, and `at` counts in steps of their length.
        unsafe {
            for stage in &self.plan.stages()[from..] {
                let mut at = 0;
                while at < self.plan.points() {
                    by_radix!(stage.radix, self.forward(stage, at));
                    at += stage.len;
                }
            }
        }
    }

    /// All stages after the first forward, `middle`, and back to the first.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers.
    #[inline(always)]
    pub unsafe fn convolve_inner<M: Middle<S>>(&self, middle: &M) {
        let first = self.plan.stages()[0].radix;
        let sub = self.plan.points() / first;
        for part in 0..first {
            // SAFETY: a plan has at least two stages, and the second splits transforms of `sub` numbers.
            unsafe { self.convolve_part(1, part * sub, middle) };
        }
    }

    /// The first stage, in place.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers.
    #[inline(always)]
    pub unsafe fn first_forward(&self) {
        let stage = &self.plan.stages()[0];
        // SAFETY: the first stage splits the whole transform, which begins at 0.
        unsafe { by_radix!(stage.radix, self.forward(stage, 0)) }
    }

    /// The last inverse stage, in place.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers.
    #[inline(always)]
    pub unsafe fn last_inverse(&self) {
        let stage = &self.plan.stages()[0];
        // SAFETY: as in `first_forward`.
        unsafe { by_radix!(stage.radix, self.inverse(stage, 0)) }
    }

    /// Stages `level..` forward, `middle`, and back, for one of the transforms that stage `level` splits.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers, and `base` to the first number of one of these transforms.
    #[inline(always)]
    unsafe fn convolve_part<M: Middle<S>>(&self, level: usize, base: usize, middle: &M) {
        // At most 7 levels below the first; written as loops over positions rather than by
        // recursion, which could not be inlined into the SIMD context.
        // SAFETY: the lengths of later stages divide `len`, so `at` and the last stage stay in `base..base + len`.
        unsafe {
            let stages = self.plan.stages();
            let last = stages.len() - 1;
            let len = stages[level].len;
            for l in level..last {
                let mut at = base;
                while at < base + len {
                    by_radix!(stages[l].radix, self.forward(&stages[l], at));
                    at += stages[l].len;
                }
            }
            by_radix_with!(stages[last].radix, self.innermost(base..base + len, middle));
            for l in (level..last).rev() {
                let mut at = base;
                while at < base + len {
                    by_radix!(stages[l].radix, self.inverse(&stages[l], at));
                    at += stages[l].len;
                }
            }
        }
    }

    /// Butterfly and twiddle factors of a forward stage.
    ///
    /// # Safety
    /// `R` must be the stage's radix, and `j` below its length over its radix.
    #[inline(always)]
    pub unsafe fn twiddled<const R: usize>(
        &self,
        x: &mut [Lanes<S>; R],
        stage: &RadixStage,
        j: usize,
    ) {
        // SAFETY: there are R - 1 twiddle factors for each j.
        unsafe {
            dft::<S, R>(self.simd, x);
            let w = stage.twiddles.as_ptr().add(j * (R - 1));
            for q in 1..R {
                x[q] = mul(self.simd, x[q], splat(self.simd, *w.add(q - 1)));
            }
        }
    }

    /// A forward stage of the transform that begins at `base`.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers, `R` must be the stage's radix, and `base` and its length must lie within the plan.
    #[inline(always)]
    unsafe fn forward<const R: usize>(&self, stage: &RadixStage, base: usize) {
        // SAFETY: j < sub and q < R, so all numbers are in `base..base + len`.
        unsafe {
            let sub = stage.len / R;
            for j in 0..sub {
                let p = self.data.add(base + j);
                let mut x = [*p; R];
                for q in 1..R {
                    x[q] = *p.add(q * sub);
                }
                self.twiddled(&mut x, stage, j);
                for q in 0..R {
                    *p.add(q * sub) = x[q];
                }
            }
        }
    }

    /// Twiddle factors and butterfly of an inverse stage.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers, `R` must be the stage's radix, `base` and the stage's length must lie within the plan, and
    /// `j` must be below the length over the radix.
    #[inline(always)]
    pub unsafe fn untwiddled<const R: usize>(
        &self,
        stage: &RadixStage,
        base: usize,
        j: usize,
    ) -> [Lanes<S>; R] {
        // SAFETY: j < sub and q < R, so all numbers are in `base..base + len`; there are R - 1 twiddle factors for each j.
        unsafe {
            let sub = stage.len / R;
            let p = self.data.add(base + j);
            let w = stage.twiddles.as_ptr().add(j * (R - 1));
            let mut x = [*p; R];
            for q in 1..R {
                x[q] = mul_conj(self.simd, *p.add(q * sub), splat(self.simd, *w.add(q - 1)));
            }
            inverse_dft::<S, R>(self.simd, &mut x);
            x
        }
    }

    /// An inverse stage of the transform that begins at `base`.
    ///
    /// # Safety
    /// As for [`Self::forward`].
    #[inline(always)]
    unsafe fn inverse<const R: usize>(&self, stage: &RadixStage, base: usize) {
        // SAFETY: as in `forward`.
        unsafe {
            let sub = stage.len / R;
            for j in 0..sub {
                let x = self.untwiddled::<R>(stage, base, j);
                for q in 0..R {
                    *self.data.add(base + j + q * sub) = x[q];
                }
            }
        }
    }

    /// Final forward stage, multiplication and first inverse stage without leaving registers.
    ///
    /// # Safety
    /// `data` must point to the plan's numbers, and `range` must lie among them and be whole transforms of `R`.
    #[inline(always)]
    unsafe fn innermost<const R: usize, M: Middle<S>>(
        &self,
        range: std::ops::Range<usize>,
        middle: &M,
    ) {
        // SAFETY: `base + q` is within `range`, and so within the plan.
        unsafe {
            for base in range.step_by(R) {
                let p = self.data.add(base);
                let mut x = [*p; R];
                for q in 1..R {
                    x[q] = *p.add(q);
                }
                dft::<S, R>(self.simd, &mut x);
                for q in 0..R {
                    x[q] = middle.apply(self.simd, base + q, x[q]);
                }
                inverse_dft::<S, R>(self.simd, &mut x);
                for q in 0..R {
                    *p.add(q) = x[q];
                }
            }
        }
    }
}
