//! The multislice step: transmit, propagate.
//!
//! Between steps a wave is kept with its rows Fourier-transformed (unnormalised) and its columns in
//! real space. One step is then two passes over memory: down columns (transform, multiply by the
//! Fresnel propagator and the anti-aliasing disk, inverse transform), and along rows (inverse
//! transform, multiply by the transmission function, transform). Columns beyond the disk are skipped.
//! Step and transforms together leave the norm as it is; propagation alone divides by the row length,
//! which the transforms of rows make good.

use super::plan::{Grid, Plan};
use crate::fft::columns::{Disk, DiskMultiplier};
use crate::fft::{Buffer, Fft2, Scratch};
use num_complex::Complex32;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::PI;
use std::ops::Range;

/// Steps waves through the slices of a plan.
pub(super) struct Stepper {
    fft: Fft2,
    grid: Grid,
    wavelength: f64,
    disk: Disk,
    band: Vec<Range<usize>>,
    dead: Range<usize>,
    planes: Vec<f64>,
    /// Propagators for the distinct distances met so far, in Angstrom.
    propagators: Vec<(f64, DiskMultiplier)>,
}

/// One leg of a wave's way: on to a slice that holds atoms, and through it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    /// The slice.
    pub slice: usize,
    /// The propagator to its plane.
    propagator: usize,
}

/// Transmission functions and where a wave stands on them.
#[derive(Clone, Copy)]
pub(super) struct Specimen<'a> {
    /// One per slice.
    pub transmission: &'a [Option<Buffer>],
    /// Elements from row to row.
    pub stride: usize,
    /// (rows, columns)
    pub shape: (usize, usize),
    /// Pixel (row, column) under the wave's first pixel.
    pub origin: (usize, usize),
}

impl Stepper {
    pub fn new(plan: &Plan) -> Self {
        let grid = plan.wave_grid;
        let (ny, nx) = grid.shape();
        let fft = Fft2::new(ny, nx);
        let reach = (plan.band_limit * grid.extent_angstrom[0]) as usize;
        let band = fft.band_columns(reach.min(nx / 2));
        let dead = match band.as_slice() {
            [low, high] => low.end..high.start,
            _ => 0..0,
        };
        let wavelength = plan.settings.optics.wavelength_angstrom();
        Stepper {
            fft,
            grid,
            wavelength,
            disk: plan.disk(),
            band,
            dead,
            planes: plan.slices.planes.clone(),
            propagators: Vec::new(),
        }
    }

    /// The legs of a wave that starts at height `start` (Angstrom) and passes the given slices, with
    /// the height of the plane where it ends. Empty slices are passed in one step, which is exact.
    pub fn route(
        &mut self,
        start: f64,
        slices: Range<usize>,
        transmission: &[Option<Buffer>],
    ) -> (Vec<Leg>, f64) {
        let mut at = start;
        let mut legs = Vec::new();
        for slice in slices.filter(|&i| transmission[i].is_some()) {
            let propagator = self.propagator_index(self.planes[slice] - at);
            legs.push(Leg { slice, propagator });
            at = self.planes[slice];
        }
        (legs, at)
    }

    /// Takes a wave along one leg.
    pub fn travel(
        &self,
        wave: &mut [Complex32],
        leg: Leg,
        specimen: Specimen<'_>,
        scratch: &mut Scratch,
    ) {
        self.propagate_by(wave, &self.propagators[leg.propagator].1, scratch);
        if let Some(t) = &specimen.transmission[leg.slice] {
            self.transmit(wave, t, specimen, scratch);
        }
    }

    pub fn fft(&self) -> &Fft2 {
        &self.fft
    }

    pub fn band(&self) -> &[Range<usize>] {
        &self.band
    }

    fn propagator_index(&mut self, distance: f64) -> usize {
        let same = |p: &(f64, DiskMultiplier)| (p.0 - distance).abs() < 1e-9;
        self.propagators.iter().position(same).unwrap_or_else(|| {
            let made = self.propagator(distance);
            self.propagators.push((distance, made));
            self.propagators.len() - 1
        })
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

    /// Rows back to real space, times the transmission function `data`, rows forward.
    pub fn transmit(
        &self,
        wave: &mut [Complex32],
        data: &[Complex32],
        t: Specimen<'_>,
        scratch: &mut Scratch,
    ) {
        let (ny, nx) = self.fft.shape();
        let arch = Arch::new();
        let mut at = t.origin.0;
        for row in wave.chunks_exact_mut(self.fft.stride()).take(ny) {
            let source = &data[at * t.stride..][..t.shape.1];
            row[self.dead.clone()].fill(Complex32::ZERO);
            let next = (at + PREFETCH_ROWS) % t.shape.0 * t.stride + t.origin.1;
            prefetch(&data[next..(next + nx).min(data.len())]);
            self.fft.row(row, true, scratch);
            let split = nx.min(t.shape.1 - t.origin.1);
            arch.dispatch(Multiply { row: &mut row[..split], by: &source[t.origin.1..] });
            arch.dispatch(Multiply { row: &mut row[split..nx], by: source });
            self.fft.row(row, false, scratch);
            at += 1;
            if at == t.shape.0 {
                at = 0;
            }
        }
    }

    /// Propagates by a prepared propagator.
    pub fn propagate_by(
        &self,
        wave: &mut [Complex32],
        propagator: &DiskMultiplier,
        scratch: &mut Scratch,
    ) {
        self.fft.convolve_columns(wave, &self.band, propagator, scratch);
    }

    /// Brings Fourier coefficients into the form that the steps need.
    pub fn start(&self, wave: &mut [Complex32], scratch: &mut Scratch) {
        self.columns(wave, true, scratch);
        let row_length = self.fft.shape().1 as f32;
        wave.iter_mut().for_each(|v| *v *= row_length);
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

/// The transforms of this many rows take longer than a row needs to arrive from memory.
const PREFETCH_ROWS: usize = 6;

/// Asks for data that will be read soon.
#[inline]
fn prefetch(data: &[Complex32]) {
    #[cfg(target_arch = "x86_64")]
    for line in data.chunks(8) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // A hint, which reads nothing.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = data;
}

/// Element by element.
struct Multiply<'a> {
    row: &'a mut [Complex32],
    by: &'a [Complex32],
}

impl WithSimd for Multiply<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let n = self.row.len().min(self.by.len());
        let (a, a_rest) = S::as_mut_simd_c32s(&mut self.row[..n]);
        let (b, b_rest) = S::as_simd_c32s(&self.by[..n]);
        for (x, y) in a.iter_mut().zip(b) {
            *x = simd.mul_c32s(*x, *y);
        }
        for (x, y) in a_rest.iter_mut().zip(b_rest) {
            *x *= y;
        }
    }
}
