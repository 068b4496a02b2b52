//! Counter-based random numbers: a pure function of (seed, stream, index), so results do not
//! depend on call order, threads or restarts.
//!
//! Philox4x32-10, J. K. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC'11. Transcendental functions come from `libm`, so
//! the numbers are identical on every processor.

use rand::rand_core::{Infallible, TryRng};

/// The use of a random number; separates streams of one seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Thermal displacements.
    Phonon = 1,
    /// Vacancies and substitutions of sites.
    Defect = 2,
    /// Poisson noise of the detector.
    Dose = 3,
    /// The atoms on partially occupied sites.
    Occupancy = 4,
    /// Waves of phase boundaries and roughness of interfaces.
    Interface = 5,
    /// Centres of clusters of vacancies.
    Cluster = 6,
    /// Rows and pairs of vacancies.
    VacancyGroup = 7,
    /// Atoms of the random network of carbon.
    Carbon = 16,
    /// Places, sizes and orientations of nanoparticles.
    Particle = 17,
    /// Atoms of the amorphous layers of a stack.
    Amorphous = 18,
    /// Atoms that like sites on both sides of an interface exchange.
    Interdiffusion = 19,
    /// Contents of the pool of units.
    Pool = 32,
    /// Phonons of library cells, and the choice of cells for the units of a world.
    Library = 33,
    /// Regions of audits.
    Audit = 34,
    /// Probes on which the error of windows is measured.
    AccuracySample = 35,
    /// Places and doses of tiles for training.
    Tile = 36,
    /// Random walk of the specimen in a recording.
    Drift = 40,
    /// Displacement of the lines of a scan.
    LineJitter = 41,
    /// Phase of the mains.
    Hum = 42,
    /// Electrons that a recording counts.
    Electrons = 43,
    /// Heights of a detector's pulses.
    PulseHeight = 44,
    /// Noise of the read-out.
    ReadNoise = 45,
    /// The atoms that the beam displaces, and the times.
    Damage = 48,
    /// Seeds of the recordings of a live world.
    LiveRecording = 49,
    /// Seeds of specimens of the benchmark, for training and for scores.
    HeldOut = 50,
    /// Electrons counted in an episode of the benchmark.
    Acquired = 51,
    /// Simulated experiments of the test for a defect.
    Detectability = 52,
}

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// The Philox4x32-10 bijection of a 128-bit counter under a 64-bit key.
#[inline]
pub(crate) fn philox4x32_10(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for round in 0..10 {
        if round > 0 {
            key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
        }
        let p0 = u64::from(MULTIPLIERS[0]) * u64::from(counter[0]);
        let p1 = u64::from(MULTIPLIERS[1]) * u64::from(counter[2]);
        counter = [
            (p1 >> 32) as u32 ^ counter[1] ^ key[0],
            p1 as u32,
            (p0 >> 32) as u32 ^ counter[3] ^ key[1],
            p0 as u32,
        ];
    }
    counter
}

/// Four random words for item `index` of stream (`seed`, `purpose`, `substream`).
///
/// `substream` below 2^24: configuration number, draw number ...
#[inline]
pub fn words(seed: u64, purpose: Purpose, substream: u32, index: u64) -> [u32; 4] {
    debug_assert!(substream < 1 << 24);
    let counter = [index as u32, (index >> 32) as u32, substream | (purpose as u32) << 24, 0];
    philox4x32_10(counter, [seed as u32, (seed >> 32) as u32])
}

/// A uniform number in (0, 1).
#[inline]
pub fn uniform(seed: u64, purpose: Purpose, substream: u32, index: u64) -> f64 {
    open_unit(words(seed, purpose, substream, index)[0])
}

/// Three independent standard normal numbers.
pub(crate) fn normal3(seed: u64, purpose: Purpose, substream: u32, index: u64) -> [f64; 3] {
    let w = words(seed, purpose, substream, index).map(open_unit);
    let (r1, r2) = (libm::sqrt(-2.0 * libm::log(w[0])), libm::sqrt(-2.0 * libm::log(w[2])));
    let (a1, a2) = (2.0 * std::f64::consts::PI * w[1], 2.0 * std::f64::consts::PI * w[3]);
    [r1 * libm::cos(a1), r1 * libm::sin(a1), r2 * libm::cos(a2)]
}

/// Converts a random word to a number between 0 and 1, without both.
#[inline]
pub(crate) fn open_unit(word: u32) -> f64 {
    (f64::from(word) + 0.5) / 4_294_967_296.0
}

/// A field, and a recording of all its frames, has fewer pixels than 2 to this power.
const PIXEL_BITS: u32 = 48;

/// Number of the random numbers of a pixel on a detector. Detector 0 has the number of the pixel.
pub(crate) fn item_of_detector(pixel: u64, detector: u16) -> u64 {
    pixel | u64::from(detector) << PIXEL_BITS
}

/// A generator for the `rand` ecosystem, private to one item: its stream depends on
/// (seed, purpose, index) only.
#[derive(Debug, Clone)]
pub(crate) struct ItemRng {
    key: [u32; 2],
    counter: [u32; 4],
    buffer: [u32; 4],
    used: usize,
}

impl ItemRng {
    /// The generator of item `index`.
    #[inline]
    pub(crate) fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let counter = [index as u32, (index >> 32) as u32, (purpose as u32) << 24, 0];
        let key = [seed as u32, (seed >> 32) as u32];
        ItemRng { key, counter, buffer: [0; 4], used: 4 }
    }
}

impl TryRng for ItemRng {
    type Error = Infallible;
    #[inline]
    fn try_next_u32(&mut self) -> std::result::Result<u32, Infallible> {
        if self.used == 4 {
            self.buffer = philox4x32_10(self.counter, self.key);
            self.counter[3] += 1;
            self.used = 0;
        }
        self.used += 1;
        Ok(self.buffer[self.used - 1])
    }
    #[inline]
    fn try_next_u64(&mut self) -> std::result::Result<u64, Infallible> {
        let low = u64::from(self.try_next_u32()?);
        Ok(low | u64::from(self.try_next_u32()?) << 32)
    }
    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> std::result::Result<(), Infallible> {
        for chunk in bytes.chunks_mut(4) {
            let word = self.try_next_u32()?.to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known-answer vectors of Random123 (kat_vectors, philox4x32 10).
    #[test]
    fn philox_matches_random123_vectors() {
        let f = u32::MAX;
        assert_eq!(
            philox4x32_10([0; 4], [0; 2]),
            [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]
        );
        assert_eq!(
            philox4x32_10([f; 4], [f; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
        assert_eq!(
            philox4x32_10(
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0]
            ),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn normals_have_unit_variance_per_component_and_no_correlation() {
        let n = 40_000;
        let mut second = [[0.0; 3]; 3];
        for i in 0..n {
            let v = normal3(7, Purpose::Phonon, 3, i);
            for a in 0..3 {
                for b in 0..3 {
                    second[a][b] += v[a] * v[b] / n as f64;
                }
            }
        }
        for a in 0..3 {
            for b in 0..3 {
                let expected = if a == b { 1.0 } else { 0.0 };
                assert!((second[a][b] - expected).abs() < 0.03, "{second:?}");
            }
        }
    }
}
