//! Sums intensities at frequencies over rings.

use crate::detect::RadialBins;
use num_complex::Complex32;

/// Sums intensities at frequencies over rings.
pub(super) struct RingSums {
    rings: usize,
    /// Index of a frequency, index of a ring, and the share of the frequency's pixel on the ring.
    shares: Vec<(u32, u32, f32)>,
}

impl RingSums {
    /// Computes the shares for frequencies at some angles (mrad), in their order. Edges of rings are `ramp_mrad` wide. Only the `wanted`
    /// rings are summed.
    pub fn new(
        bins: &RadialBins,
        ramp_mrad: f64,
        angles_mrad: impl Iterator<Item = f64>,
        wanted: impl Fn(usize) -> bool,
    ) -> Self {
        let mut shares = Vec::new();
        for (at, theta) in angles_mrad.enumerate() {
            bins.shares(theta, ramp_mrad, |ring, share| {
                if wanted(ring) {
                    shares.push((at as u32, ring as u32, share as f32));
                }
            });
        }
        RingSums { rings: bins.rings, shares }
    }

    /// Adds the intensities of amplitudes, multiplied by a weight, to `out`; `sums` is work space.
    pub fn add(&self, amplitudes: &[Complex32], weight: f32, sums: &mut Vec<f64>, out: &mut [f32]) {
        sums.clear();
        sums.resize(self.rings, 0.0);
        for (at, ring, share) in &self.shares {
            sums[*ring as usize] += f64::from(share * amplitudes[*at as usize].norm_sqr());
        }
        for (to, sum) in out.iter_mut().zip(sums) {
            *to += (*sum * f64::from(weight)) as f32;
        }
    }

    /// Operations for one pattern.
    pub fn flops(&self) -> usize {
        5 * self.shares.len()
    }
}
