//! The multislice step: transmit, propagate.
//!
//! Between steps a wave is kept with its rows Fourier-transformed (unnormalised) and its columns in
//! real space. One step is then two passes over memory: down columns (transform, multiply by the
//! Fresnel propagator and the anti-aliasing disk, inverse transform), and along rows (inverse
//! transform, multiply by the transmission function, transform). Columns beyond the disk are skipped.
//! Waves that meet the same part of the specimen step together, so that it is read once for all.
//! Step and transforms together leave the norm as it is; propagation alone divides by the row length,
//! which the transforms of rows make good.

use super::plan::{Grid, Plan};
use super::transmission::{Layout, Transmission};
use crate::fft::multiplier::{Disk, DiskMultiplier};
use crate::fft::radix::lanes;
use crate::fft::{Buffer, Fft2, Scratch};
use num_complex::Complex32;
use std::collections::HashMap;
use std::f64::consts::PI;
use std::ops::Range;

/// Steps waves through the slices of a plan.
pub(super) struct Stepper {
    fft: Fft2,
    grid: Grid,
    wavelength: f64,
    disk: Disk,
    band: Vec<Range<usize>>,
    planes: Vec<f64>,
    /// Propagators for the distinct distances met so far.
    propagators: Vec<DiskMultiplier>,
    /// Which of them is for a distance, in 1e-9 Angstrom.
    by_distance: HashMap<i64, usize>,
}

/// One leg of a wave's way: on to a slice that holds atoms, and through it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    /// The slice.
    pub slice: usize,
    /// The propagator to its plane.
    propagator: usize,
}

/// Transmission functions and where waves stand on them.
#[derive(Clone, Copy)]
pub(super) struct Specimen<'a> {
    pub transmission: &'a Transmission,
    /// Pixel (row, column) under the waves' first pixel.
    pub origin: (usize, usize),
}

/// One thread's work space.
pub(super) struct Workspace {
    pub fft: Scratch,
    /// A block of rows of a transmission function.
    block: Buffer,
}

/// Waves of up to this many bytes together stay in a core's cache.
const GROUP_BYTES: usize = 1 << 20;
/// Larger waves: enough that reading the specimen from memory does not matter.
const LARGE_GROUP: usize = 4;
/// Beyond this, more waves together gain nothing.
const MOST_TOGETHER: usize = 16;

/// How many waves of so many bytes each should step together.
pub(super) fn group(wave_bytes: usize) -> usize {
    (GROUP_BYTES / wave_bytes.max(1)).clamp(LARGE_GROUP, MOST_TOGETHER)
}

impl Stepper {
    pub fn new(plan: &Plan) -> Self {
        let grid = plan.wave_grid;
        let (ny, nx) = grid.shape();
        let fft = Fft2::new(ny, nx);
        let reach = (plan.band_limit * grid.extent_angstrom[0]) as usize;
        let band = fft.band_columns(reach.min(nx / 2));
        let wavelength = plan.settings.optics.wavelength_angstrom();
        Stepper {
            fft,
            grid,
            wavelength,
            disk: plan.disk(),
            band,
            planes: plan.slices.planes.clone(),
            propagators: Vec::new(),
            by_distance: HashMap::new(),
        }
    }

    /// The legs of a wave that starts at height `start` (Angstrom) and passes the given slices, with
    /// the height of the plane where it ends. What lies between them is passed in one step.
    pub fn route(&mut self, start: f64, slices: impl Iterator<Item = usize>) -> (Vec<Leg>, f64) {
        let mut at = start;
        let mut legs = Vec::new();
        for slice in slices {
            let propagator = self.propagator_index(self.planes[slice] - at);
            legs.push(Leg { slice, propagator });
            at = self.planes[slice];
        }
        (legs, at)
    }

    /// How many waves should step together.
    pub fn group(&self) -> usize {
        group(self.fft.buffer_len() * size_of::<Complex32>())
    }

    pub fn workspace(&self) -> Workspace {
        Workspace { fft: self.fft.scratch(), block: Buffer::zeros(self.fft.arranged_len()) }
    }

    /// Takes waves along one leg.
    pub fn travel(
        &self,
        waves: &mut [Buffer],
        leg: Leg,
        specimen: Specimen<'_>,
        w: &mut Workspace,
    ) {
        self.propagate_by(waves, &self.propagators[leg.propagator], &mut w.fft);
        if let Some(t) = &specimen.transmission.slices[leg.slice] {
            self.transmit(waves, t, specimen.transmission.layout, specimen.origin, w);
        }
    }

    pub fn fft(&self) -> &Fft2 {
        &self.fft
    }

    pub fn band(&self) -> &[Range<usize>] {
        &self.band
    }

    fn propagator_index(&mut self, distance: f64) -> usize {
        // Equal distances between planes differ by rounding.
        let key = (distance * 1e9).round() as i64;
        if let Some(&index) = self.by_distance.get(&key) {
            return index;
        }
        self.propagators.push(self.propagator(distance));
        self.by_distance.insert(key, self.propagators.len() - 1);
        self.propagators.len() - 1
    }

    /// `exp(-i pi lambda dz k^2)` inside the disk, divided by the number of pixels.
    pub fn propagator(&self, distance: f64) -> DiskMultiplier {
        let (ny, nx) = self.grid.shape();
        let axis = |n: usize, dk: f64, scale: f64| {
            let k2: Vec<f64> =
                (0..n).map(|i| (crate::fft::frequency(i, n) as f64 * dk).powi(2)).collect();
            let phase = |k2: &f64| {
                let (sin, cos) = (-PI * self.wavelength * distance * k2).sin_cos();
                Complex32::new((scale * cos) as f32, (scale * sin) as f32)
            };
            (k2.iter().map(phase).collect::<Vec<_>>(), k2)
        };
        let dk = self.grid.dk();
        let (row, row_k2) = axis(ny, dk[1], 1.0);
        let (column, column_k2) = axis(nx, dk[0], 1.0 / (nx * ny) as f64);
        self.fft.multiplier(&row, &row_k2, &column, &column_k2, self.disk)
    }

    /// Rows back to real space, times the transmission function `t`, rows forward.
    pub fn transmit(
        &self,
        waves: &mut [Buffer],
        t: &[Complex32],
        layout: Layout,
        origin: (usize, usize),
        w: &mut Workspace,
    ) {
        let (rows, stride) = (lanes(), self.fft.stride());
        let arranged = self.fft.arranged_len();
        for b in 0..self.fft.row_blocks() {
            let by = match layout {
                Layout::Arranged => &t[b * arranged..][..arranged],
                Layout::Padded { stride } => {
                    let first = (origin.0 + b * rows) * stride + origin.1;
                    let area = &t[first..];
                    if b + 1 < self.fft.row_blocks() {
                        self.prefetch(&area[rows * stride..], stride);
                    }
                    self.fft.arrange_block(area, stride, &mut w.block);
                    &w.block
                }
            };
            for wave in &mut *waves {
                let block = &mut wave[b * rows * stride..][..rows * stride];
                self.fft.convolve_block(block, &self.band, by, &mut w.fft);
            }
        }
    }

    /// Asks for a block of rows that will be read soon.
    fn prefetch(&self, rows: &[Complex32], stride: usize) {
        let columns = self.fft.shape().1;
        for row in rows.chunks(stride).take(lanes()) {
            prefetch(&row[..columns.min(row.len())]);
        }
    }

    /// Propagates by a prepared propagator.
    pub fn propagate_by(
        &self,
        waves: &mut [Buffer],
        propagator: &DiskMultiplier,
        scratch: &mut Scratch,
    ) {
        self.fft.convolve_columns(waves, &self.band, propagator, scratch);
    }

    /// Brings Fourier coefficients into the form that the steps need. Columns outside `live`
    /// (see [`Fft2::band_columns`]) have to be zero.
    pub fn start(&self, wave: &mut [Complex32], live: &[Range<usize>], scratch: &mut Scratch) {
        let row_length = self.fft.shape().1 as f32;
        for range in live {
            for row in wave.chunks_exact_mut(self.fft.stride()) {
                row[range.clone()].iter_mut().for_each(|v| *v *= row_length);
            }
            self.fft.some_columns(wave, range.clone(), true, scratch);
        }
    }

    /// Transforms the columns inside the band, forward or back. After the forward transform the
    /// array holds the wave's Fourier coefficients times the number of pixels; elements beyond the
    /// band are meaningless.
    pub fn columns(&self, wave: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        for range in &self.band {
            self.fft.some_columns(wave, range.clone(), inverse, scratch);
        }
    }
}

/// Asks for data that will be read soon.
#[inline]
fn prefetch(data: &[Complex32]) {
    #[cfg(target_arch = "x86_64")]
    for line in data.chunks(8) {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        // A hint, which reads nothing.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = data;
}
