//! The factors of a transform's length, its twiddle factors, and the order of its frequencies.

use pulp::{Arch, Simd, WithSimd};

/// Radices tried, in this order, when a length is factorised.
const RADICES: [usize; 5] = [8, 5, 4, 3, 2];

/// One pass over the data.
#[derive(Debug, Clone)]
pub struct RadixStage {
    /// Length of the stage's butterflies.
    pub radix: usize,
    /// Length of the transforms that this stage splits.
    pub len: usize,
    /// `exp(-2 pi i j q / len)` for j in 0..len/radix (slow) and q in 1..radix (fast).
    pub twiddles: Vec<[f32; 2]>,
}

/// The plan for transforming `n` numbers in place.
#[derive(Debug, Clone)]
pub struct RadixPlan {
    n: usize,
    stages: Vec<RadixStage>,
    order: Vec<usize>,
}

/// Factorises into 8, 5, 4, 3, 2; `None` when another prime is left or there are fewer than two
/// factors. Small radices come last: the last pass is fused with the multiplication.
fn factorise(mut n: usize) -> Option<Vec<usize>> {
    let mut factors = Vec::new();
    for radix in RADICES {
        while n > 1 && n.is_multiple_of(radix) {
            // 16 r is split as 4 * 4 * r, so that no single 2 is left after an 8.
            if radix == 8 && n / 8 == 2 {
                break;
            }
            factors.push(radix);
            n /= radix;
        }
    }
    (n == 1 && factors.len() >= 2).then_some(factors)
}

impl RadixPlan {
    /// A plan for `n` numbers, or `None` when `n` has prime factors other than 2, 3 and 5 or is tiny.
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
            stages.push(RadixStage { radix, len, twiddles });
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
        Some(RadixPlan { n, stages, order })
    }

    /// Number of transformed numbers.
    pub fn points(&self) -> usize {
        self.n
    }

    /// The passes, first to last.
    pub fn stages(&self) -> &[RadixStage] {
        &self.stages
    }

    /// Frequency index found at each position after the forward passes.
    pub fn order(&self) -> &[usize] {
        &self.order
    }
}

/// Number of SIMD lanes (`f32`) of this processor. Columns are transformed in blocks of this many, so rows must be
/// padded for the last block to fit.
pub(crate) fn lanes() -> usize {
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
