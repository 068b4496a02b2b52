//! The multislice step: transmit, propagate.
//!
//! Between steps the rows of a wave are kept Fourier-transformed (unnormalised), its columns in real space. A step
//! is then two passes over memory: down columns (transform, multiply by the Fresnel propagator and the
//! anti-aliasing aperture, inverse transform), and along rows (inverse transform, multiply by the transmission
//! function, transform). Columns beyond the band limit are skipped. Waves that meet the same part of the specimen step
//! together, so that its transmission function is read from memory once for all of them. A whole step keeps the norm:
//! the propagator divides by the number of pixels, the unnormalised transforms multiply by it.

use super::grid::Grid;
use super::plan::Plan;
use super::slice_coverage::LocalSlice;
use super::transmission::{Transmission, TransmissionLayout};
use crate::fft::{BandLimit, BandLimitedMultiplier, Buffer, Fft2, Scratch, lanes};
use crate::plane;
use num_complex::Complex32;
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Steps waves through the slices of a plan.
pub(super) struct Stepper {
    fft: Fft2,
    grid: Grid,
    wavelength: f64,
    /// Points (x, y) of the cell that windows move over.
    cell: [usize; 2],
    /// Displacement of the beam (x, y) in Angstrom for each Angstrom of depth.
    slope: [f64; 2],
    anti_aliasing: BandLimit,
    /// Columns within the band limit.
    band: Vec<Range<usize>>,
    /// Pixels (x, y) by which windows have moved at each slice.
    window_moves: Vec<[i64; 2]>,
    /// Propagators for the distances met so far.
    propagators: Vec<BandLimitedMultiplier>,
    /// Index of the propagator for a distance in 1e-9 Angstrom over which windows move by these pixels (x, y).
    by_distance: HashMap<(i64, [i64; 2]), usize>,
}

/// One step of a wave: propagation to the plane where slices act, and transmission through them.
#[derive(Debug, Clone, Copy)]
pub(super) struct SliceStep {
    first: usize,
    last: usize,
    /// Index of the propagator to its plane.
    propagator: usize,
    /// Pixels (x, y) by which windows have moved there.
    moved: [i64; 2],
}

/// The part of the transmission functions that waves pass.
#[derive(Clone, Copy)]
pub(super) struct TransmissionView<'a> {
    pub transmission: &'a Transmission,
    /// The pixel (row, column) of the cell under the first pixel of the waves.
    pub origin: (usize, usize),
}

/// One thread's work space.
pub(super) struct StepWorkspace {
    pub fft: Scratch,
    /// A block of rows of a transmission function.
    block: Buffer,
    /// The block row by row, as a product.
    product: Buffer,
}

/// Waves of this total size in bytes stay in a core's cache.
const GROUP_BYTES: usize = 1 << 20;
/// Number of larger waves that step together: reading the transmission function from memory then takes little of the time.
const LARGE_GROUP: usize = 4;
/// Largest number of waves that step together. More do not make it faster.
const MOST_TOGETHER: usize = 16;

/// Number of waves, of `wave_bytes` each, that should step together.
pub(super) fn waves_together(wave_bytes: usize) -> usize {
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
            cell: plan.transmission_grid.points,
            slope: plan.settings.optics.slope(),
            anti_aliasing: plan.anti_aliasing(),
            band,
            window_moves: plan.slices.planes.iter().map(|z| plan.window_shift(*z)).collect(),
            propagators: Vec::new(),
            by_distance: HashMap::new(),
        }
    }

    /// The steps of a wave that starts at `start` and passes the given slices, and the plane where it ends: heights in Angstrom, and pixels
    /// (x, y) by which windows have moved there. Omitted slices are crossed in one step.
    pub fn path(
        &mut self,
        start: (f64, [i64; 2]),
        slices: impl Iterator<Item = LocalSlice>,
    ) -> (Vec<SliceStep>, (f64, [i64; 2])) {
        let mut at = start;
        let mut steps = Vec::new();
        for LocalSlice { first, last, height_angstrom } in slices {
            // Windows move with the beam's place at the first slice of a step; the propagator includes this.
            let plane = (height_angstrom, self.window_moves[first]);
            let pixels = plane::sub(plane.1, at.1);
            let propagator = self.propagator_index(plane.0 - at.0, pixels);
            steps.push(SliceStep { first, last, propagator, moved: plane.1 });
            at = plane;
        }
        (steps, at)
    }

    /// Number of waves that should step together.
    pub fn waves_together(&self) -> usize {
        waves_together(self.fft.buffer_len() * size_of::<Complex32>())
    }

    pub fn workspace(&self) -> StepWorkspace {
        let width = self.fft.shape().1 + lanes();
        StepWorkspace {
            fft: self.fft.scratch(),
            block: Buffer::zeros(self.fft.arranged_len()),
            product: Buffer::zeros(lanes() * width + lanes()),
        }
    }

    /// Propagates waves to the plane of a step, and transmits them.
    pub fn propagate(
        &self,
        waves: &mut [Buffer],
        step: SliceStep,
        view: TransmissionView<'_>,
        w: &mut StepWorkspace,
    ) {
        self.propagate_freely(waves, &self.propagators[step.propagator], &mut w.fft);
        for b in 0..self.fft.row_blocks() {
            let by = match (view.transmission.layout, &view.transmission.slices[step.first]) {
                (TransmissionLayout::Arranged, Some(t)) => &t[b * w.block.len()..][..w.block.len()],
                _ => {
                    self.arrange_rows((step, b), view, &mut w.block, &mut w.product);
                    &w.block
                }
            };
            self.transmit_rows(waves, b, by, &mut w.fft);
        }
    }

    /// The transmission functions of steps, for [`Stepper::propagate_through`].
    pub fn arrange(
        &self,
        steps: &[SliceStep],
        view: TransmissionView<'_>,
        out: &mut Vec<Buffer>,
        w: &mut StepWorkspace,
    ) {
        let (blocks, arranged) = (self.fft.row_blocks(), self.fft.arranged_len());
        if out.len() < steps.len() {
            out.resize_with(steps.len(), || Buffer::zeros(blocks * arranged));
        }
        for (step, out) in steps.iter().zip(out) {
            for (b, block) in out.chunks_exact_mut(arranged).take(blocks).enumerate() {
                self.arrange_rows((*step, b), view, block, &mut w.product);
            }
        }
    }

    /// Steps waves as [`Stepper::propagate`] does, with a transmission function from [`Stepper::arrange`].
    pub fn propagate_through(
        &self,
        waves: &mut [Buffer],
        step: SliceStep,
        transmission: &[Complex32],
        w: &mut StepWorkspace,
    ) {
        self.propagate_freely(waves, &self.propagators[step.propagator], &mut w.fft);
        self.transmit(waves, transmission, w);
    }

    /// A block of rows of the transmission function of a step in a window, in the order of [`Fft2::arrange_block`]. It is the product of
    /// the functions of its slices; slices without atoms are 1.
    fn arrange_rows(
        &self,
        (step, b): (SliceStep, usize),
        view: TransmissionView<'_>,
        out: &mut [Complex32],
        product: &mut [Complex32],
    ) {
        let all = &view.transmission.slices[step.first..=step.last];
        let mut slices = all.iter().flatten();
        let Some(first) = slices.next() else {
            return out.fill(Complex32::ONE);
        };
        let TransmissionLayout::Padded { stride } = view.transmission.layout else {
            return out.copy_from_slice(&first[b * out.len()..][..out.len()]);
        };
        let origin = self.moved(view.origin, step.moved);
        let from = (origin.0 + b * lanes()) * stride + origin.1;
        if step.first == step.last {
            return self.fft.arrange_block(&first[from..], stride, out);
        }
        let width = self.fft.shape().1 + lanes();
        for (y, row) in product.chunks_exact_mut(width).take(lanes()).enumerate() {
            let at = from + y * stride;
            row.copy_from_slice(&first[at..at + width]);
        }
        for slice in slices {
            for (y, row) in product.chunks_exact_mut(width).take(lanes()).enumerate() {
                let at = from + y * stride;
                row.iter_mut().zip(&slice[at..at + width]).for_each(|(p, t)| *p *= t);
            }
        }
        self.fft.arrange_block(product, width, out);
    }

    /// The pixel (row, column) of the cell under the first pixel of a window that began at `origin` and moved by these pixels (x, y).
    fn moved(&self, origin: (usize, usize), by: [i64; 2]) -> (usize, usize) {
        let along =
            |from: usize, k: usize| (from as i64 + by[k]).rem_euclid(self.cell[k] as i64) as usize;
        if by == [0; 2] { origin } else { (along(origin.0, 1), along(origin.1, 0)) }
    }

    pub fn fft(&self) -> &Fft2 {
        &self.fft
    }

    /// Columns within the band limit.
    pub fn band(&self) -> &[Range<usize>] {
        &self.band
    }

    fn propagator_index(&mut self, distance: f64, pixels: [i64; 2]) -> usize {
        // Equal distances between planes differ by rounding.
        let key = ((distance * 1e9).round() as i64, pixels);
        if let Some(&index) = self.by_distance.get(&key) {
            return index;
        }
        self.propagators.push(self.propagator(distance, pixels));
        self.by_distance.insert(key, self.propagators.len() - 1);
        self.propagators.len() - 1
    }

    /// The propagator `exp(-i pi lambda dz k^2 - 2 pi i k.s)` over `distance` dz (Angstrom) within the band limit, divided by the number of
    /// pixels. s is the displacement of the tilted beam, less the `pixels` (x, y) by which windows follow it.
    pub fn propagator(&self, distance: f64, pixels: [i64; 2]) -> BandLimitedMultiplier {
        let (ny, nx) = self.grid.shape();
        let (dk, pixel) = (self.grid.dk(), self.grid.sampling_angstrom());
        let axis = |axis: usize, n: usize, scale: f64| {
            let way = distance * self.slope[axis] - pixels[axis] as f64 * pixel[axis];
            let k: Vec<f64> =
                (0..n).map(|i| crate::fft::frequency(i, n) as f64 * dk[axis]).collect();
            let k2: Vec<f64> = k.iter().map(|k| k.powi(2)).collect();
            let phase = |(k, k2): (&f64, &f64)| {
                let phase = -PI * self.wavelength * distance * k2 - TAU * way * k;
                let (sin, cos) = phase.sin_cos();
                Complex32::new((scale * cos) as f32, (scale * sin) as f32)
            };
            (k.iter().zip(&k2).map(phase).collect::<Vec<_>>(), k2)
        };
        let (row, row_k2) = axis(1, ny, 1.0);
        let (column, column_k2) = axis(0, nx, 1.0 / (nx * ny) as f64);
        self.fft.multiplier(&row, &row_k2, &column, &column_k2, self.anti_aliasing)
    }

    /// Multiplies waves by the transmission function `t` in the order of [`Fft2::arrange_block`]: inverse transform of rows,
    /// product, forward transform.
    pub fn transmit(&self, waves: &mut [Buffer], t: &[Complex32], w: &mut StepWorkspace) {
        let blocks = t.chunks_exact(self.fft.arranged_len()).take(self.fft.row_blocks());
        for (b, by) in blocks.enumerate() {
            self.transmit_rows(waves, b, by, &mut w.fft);
        }
    }

    /// [`Stepper::transmit`] for the b-th block of rows.
    fn transmit_rows(
        &self,
        waves: &mut [Buffer],
        b: usize,
        by: &[Complex32],
        scratch: &mut Scratch,
    ) {
        let rows = lanes() * self.fft.stride();
        for wave in waves {
            let block = &mut wave[b * rows..][..rows];
            self.fft.convolve_block(block, &self.band, by, scratch);
        }
    }

    /// Propagates through free space.
    pub fn propagate_freely(
        &self,
        waves: &mut [Buffer],
        propagator: &BandLimitedMultiplier,
        scratch: &mut Scratch,
    ) {
        self.fft.convolve_columns(waves, &self.band, propagator, scratch);
    }

    /// The real-space values of a wave between steps after a last part of free space.
    pub fn leaving(
        &self,
        wave: &Buffer,
        propagator: &BandLimitedMultiplier,
        scratch: &mut Scratch,
    ) -> Buffer {
        let mut waves = [wave.clone()];
        self.propagate_freely(&mut waves, propagator, scratch);
        let [mut wave] = waves;
        if let [low, high] = self.band() {
            for row in wave.chunks_exact_mut(self.fft.stride()) {
                row[low.end..high.start].fill(Complex32::ZERO);
            }
        }
        self.fft.all_rows(&mut wave, true, scratch);
        wave
    }

    /// Turns Fourier coefficients into the form that steps need. Columns outside `live` (from [`Fft2::band_columns`]) must be zero.
    pub fn start(&self, wave: &mut [Complex32], live: &[Range<usize>], scratch: &mut Scratch) {
        let row_length = self.fft.shape().1 as f32;
        for range in live {
            for row in wave.chunks_exact_mut(self.fft.stride()) {
                row[range.clone()].iter_mut().for_each(|v| *v *= row_length);
            }
            self.fft.some_columns(wave, range.clone(), true, scratch);
        }
    }

    /// Transforms the columns within the band limit. After the forward transform of a wave between steps, the array holds
    /// its Fourier coefficients times the number of pixels; elements beyond the band limit are meaningless.
    pub fn transform_columns(&self, wave: &mut [Complex32], inverse: bool, scratch: &mut Scratch) {
        for range in &self.band {
            self.fft.some_columns(wave, range.clone(), inverse, scratch);
        }
    }
}
