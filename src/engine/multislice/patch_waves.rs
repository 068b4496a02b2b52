//! Waves in which the probes of a patch are expanded, and the probes' coefficients on them.

use super::super::basis::Basis;
use super::super::coherent_tail::SharedWaves;
use crate::made_once::KeptWithin;
use num_complex::Complex32;
use std::sync::Arc;

/// Probes of a patch: their numbers, and their positions in the window (Angstrom).
pub(super) type PatchProbes = [(usize, [f64; 2])];
/// Coefficients of probes on waves, (wave, probe) row-major, for each focus with its weight.
pub(super) type Coefficients = Vec<(f64, Vec<Complex32>)>;

/// Coefficients are kept up to this many bytes. All configurations of a specimen, and all library images of a family, have the same.
const ROOM_BYTES: usize = 64 << 20;

/// Waves that are propagated in place of a patch's probes.
pub(super) struct PatchWaves {
    waves: WavesIn,
    kept: KeptWithin<Vec<[u64; 2]>, Coefficients>,
}

/// Where waves are defined.
pub(super) enum WavesIn {
    /// In the window.
    Window(Basis),
    /// In the box around the window, for detectors that read the coherent tail.
    Box(SharedWaves),
}

impl PatchWaves {
    pub fn new(waves: WavesIn) -> Self {
        PatchWaves { waves, kept: KeptWithin::new(ROOM_BYTES) }
    }

    /// Number of waves.
    pub fn len(&self) -> usize {
        match &self.waves {
            WavesIn::Window(basis) => basis.len(),
            WavesIn::Box(shared) => shared.len(),
        }
    }

    /// Coefficients of wave `j` on the window's bins.
    pub fn inside(&self, j: usize) -> &[Complex32] {
        match &self.waves {
            WavesIn::Window(basis) => basis.wave(j),
            WavesIn::Box(shared) => &shared.inside[j],
        }
    }

    /// The part of wave `j` outside the window, if it is known.
    pub fn outside(&self, j: usize) -> Option<&[Complex32]> {
        match &self.waves {
            WavesIn::Window(_) => None,
            WavesIn::Box(shared) => Some(&shared.outside[j]),
        }
    }

    /// Sums of the waves with the coefficients of some probes, (wave, probe) row-major: for each probe its coefficients on the window's bins,
    /// and the coefficients of its part outside, which are empty if that is not known.
    pub fn sums(
        &self,
        coefficients: &[Complex32],
        probes: usize,
    ) -> (Vec<Vec<Complex32>>, Vec<Vec<Complex32>>) {
        let sum = |probe: usize, parts: &[&[Complex32]]| {
            let mut sum = vec![Complex32::ZERO; parts[0].len()];
            for (part, c) in parts.iter().zip(coefficients.iter().skip(probe).step_by(probes)) {
                sum.iter_mut().zip(*part).for_each(|(sum, wave)| *sum += c * wave);
            }
            sum
        };
        let inside: Vec<_> = (0..self.len()).map(|j| self.inside(j)).collect();
        let outside: Vec<_> =
            (0..self.len()).map(|j| self.outside(j).unwrap_or_default()).collect();
        let parts = |probe| (sum(probe, &inside), sum(probe, &outside));
        (0..probes).map(parts).unzip()
    }

    /// The coefficients of probes, from `make` if they are not kept.
    pub fn coefficients(
        &self,
        probes: &PatchProbes,
        foci: usize,
        make: impl FnOnce(&WavesIn) -> Coefficients,
    ) -> Arc<Coefficients> {
        let key = probes.iter().map(|(_, position)| position.map(f64::to_bits)).collect();
        let bytes = size_of::<Complex32>() * self.len() * probes.len() * foci;
        self.kept.get(key, bytes, || make(&self.waves))
    }
}
