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
