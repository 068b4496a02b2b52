//! PRISM: probes assembled from plane waves.
//!
//! C. Ophus, "A fast image simulation algorithm for scanning transmission electron microscopy",
//! Adv. Struct. Chem. Imaging 3 (2017) 13. Exit waves are kept on a grid that just holds the band limit. The reduction is
//! then 2.25 times cheaper than on the full grid; without interpolation nothing is lost (see `full_exit_grid` in
//! [`super::settings::Settings`]).

use super::grid::Grid;
use super::plan::Plan;
use super::settings::Algorithm;
use super::single_precision::single;
use super::stepper::{SliceStep, StepWorkspace, Stepper, TransmissionView};
use crate::detect::DetectorMap;
use crate::error::{Error, Result};
use crate::fft::{Buffer, Fft2, Scratch};
use crate::plane;
use crate::progress::Progress;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// Propagates plane waves through given transmission functions. The reduction is in `prism_reduce`.
pub(super) struct Prism<'a> {
    pub(super) plan: &'a Plan,
    stepper: Stepper,
    /// Indices (kx, ky) on the Fourier grid of the cell, sorted by ky, then kx.
    pub(super) beams: Vec<[i64; 2]>,
    /// Amplitudes of the beams in a probe at the origin, for each focus; their squared moduli sum to its weight.
    pub(super) amplitudes: Vec<Vec<Complex64>>,
    /// Grid of the exit waves.
    pub(super) exit: Grid,
    pub(super) exit_fft: Fft2,
    /// Grid of the probes: the exit grid over the interpolation factors.
    pub(super) window: Grid,
    pub(super) window_fft: Fft2,
    pub(super) map: DetectorMap,
}

/// One thread's arrays.
struct PrismWorkspace {
    waves: Vec<Buffer>,
    step: StepWorkspace,
    exit: Scratch,
}

/// The slices between two recorded thicknesses.
struct PrismSection {
    /// Whether it begins at the entrance surface.
    first: bool,
    steps: Vec<SliceStep>,
    /// Propagator from the last plane to the exit boundary, in the order of [`crop_spectrum`].
    to_exit: Vec<Complex32>,
}

impl<'a> Prism<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        let Algorithm::Prism { interpolation } = plan.settings.algorithm else {
            unreachable!("the engine starts PRISM for PRISM plans only")
        };
        let stepper = Stepper::new(plan);
        let exit = plan.exit_grid.unwrap_or(plan.wave_grid);
        let window = Grid {
            points: plane::div(exit.points, interpolation),
            extent_angstrom: plane::div(exit.extent_angstrom, interpolation.map(|n| n as f64)),
        };
        let dk = exit.dk();
        let beams = plan.prism_beams();
        let spacing = plane::mul(dk, interpolation.map(|n| n as f64));
        let at_focus = |(weight, at): &(f64, Plan)| {
            let optics = &at.settings.optics;
            let amplitude =
                |b: &[i64; 2]| optics.transfer(plane::mul(b.map(|n| n as f64), dk), spacing);
            let mut amplitudes: Vec<Complex64> = beams.iter().map(amplitude).collect();
            let norm = amplitudes.iter().map(|a| a.norm_sqr()).sum::<f64>().sqrt();
            amplitudes.iter_mut().for_each(|a| *a /= norm / weight.sqrt());
            amplitudes
        };
        let amplitudes = plan.at_foci().iter().map(at_focus).collect();
        let (ny, nx) = exit.shape();
        let (wy, wx) = window.shape();
        let window_fft = Fft2::new(wy, wx);
        let map = plan.detector_map(&window, window_fft.stride(), 0.0);
        let exit_fft = Fft2::new(ny, nx);
        Prism { plan, stepper, beams, amplitudes, exit, exit_fft, window, window_fft, map }
    }

    /// Elements of the array of one exit wave.
    pub(super) fn exit_plane(&self) -> usize {
        self.exit_fft.stride() * self.exit.points[1]
    }

    /// Propagates all beams through the given slices to the exit boundary of the last. `waves` holds the exit waves in real space, one
    /// array of [`Prism::exit_plane`] elements after the other: on entry the waves of the slices before, on return the waves of the last
    /// slice.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn propagate(
        &mut self,
        waves: &mut [Complex32],
        view: TransmissionView<'_>,
        slices: Range<usize>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let edges = &self.plan.slices.boundaries;
        let (entrance, exit) = (edges[slices.start], edges[slices.end]);
        let (steps, end) =
            self.stepper.path((entrance, [0; 2]), view.transmission.filled(slices.clone()));
        let this = &*self;
        let section =
            PrismSection { first: slices.start == 0, steps, to_exit: this.fresnel(exit - end.0) };
        let plane = this.exit_plane();
        let together = this.stepper.waves_together();
        let groups = waves[..plane * this.beams.len()].par_chunks_mut(plane * together);
        groups.zip(this.beams.par_chunks(together)).try_for_each_init(
            || this.workspace(),
            |w, (kept, beams)| {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                this.propagate_group(kept, beams, &section, view, w);
                progress.advance(beams.len() as u64);
                Ok(())
            },
        )
    }

    fn workspace(&self) -> PrismWorkspace {
        PrismWorkspace {
            waves: vec![self.stepper.fft().buffer(); self.stepper.waves_together()],
            step: self.stepper.workspace(),
            exit: self.exit_fft.scratch(),
        }
    }

    /// Propagates some beams through a section; `kept` holds their exit waves.
    fn propagate_group(
        &self,
        kept: &mut [Complex32],
        beams: &[[i64; 2]],
        section: &PrismSection,
        view: TransmissionView<'_>,
        PrismWorkspace { waves, step, exit }: &mut PrismWorkspace,
    ) {
        let plane = self.exit_plane();
        let waves = &mut waves[..beams.len()];
        for ((wave, kept), beam) in waves.iter_mut().zip(kept.chunks_exact_mut(plane)).zip(beams) {
            match section.first {
                true => self.plane_wave(wave, *beam),
                false => self.expand(wave, kept, step, exit),
            }
        }
        for slice_step in &section.steps {
            self.stepper.propagate(waves, *slice_step, view, step);
        }
        for (wave, kept) in waves.iter_mut().zip(kept.chunks_exact_mut(plane)) {
            self.compress(wave, kept, &section.to_exit, step, exit);
        }
    }

    /// The propagator `exp(-i pi lambda dz k^2 - 2 pi i k.s)` over the number of pixels, in the order of [`crop_spectrum`]; s is the
    /// way of the tilted beam.
    fn fresnel(&self, distance: f64) -> Vec<Complex32> {
        let wavelength = self.plan.settings.optics.wavelength_angstrom();
        let slope = self.plan.settings.optics.slope();
        let [nx, ny] = self.plan.wave_grid.points;
        let mut factors = Vec::new();
        crop_spectrum(&self.plan.wave_grid, self.exit.points, self.plan.band_limit, |_, _, k| {
            let along = k[0] * slope[0] + k[1] * slope[1];
            let phase = -PI * wavelength * distance * (k[0] * k[0] + k[1] * k[1])
                - 2.0 * PI * distance * along;
            let c = Complex64::from_polar(1.0 / (nx * ny) as f64, phase);
            factors.push(Complex32::new(c.re as f32, c.im as f32));
        });
        factors
    }

    /// Sets a wave to `exp(2 pi i k.r)` in the form that steps need: one column is not zero.
    fn plane_wave(&self, wave: &mut [Complex32], beam: [i64; 2]) {
        let [nx, ny] = self.plan.wave_grid.points;
        let column = beam[0].rem_euclid(nx as i64) as usize;
        wave.fill(Complex32::ZERO);
        let stride = self.stepper.fft().stride();
        for (y, row) in wave.chunks_exact_mut(stride).take(ny).enumerate() {
            let turns = (beam[1] * y as i64).rem_euclid(ny as i64) as f64 / ny as f64;
            row[column] = single(Complex64::from_polar(nx as f64, 2.0 * PI * turns));
        }
    }

    /// Propagates a wave between steps to the exit boundary and stores it in real space on the exit grid.
    fn compress(
        &self,
        wave: &mut [Complex32],
        kept: &mut [Complex32],
        fresnel: &[Complex32],
        w: &mut StepWorkspace,
        exit: &mut Scratch,
    ) {
        self.stepper.transform_columns(wave, false, &mut w.fft);
        let (from, to) = (self.stepper.fft().stride(), self.exit_fft.stride());
        kept.fill(Complex32::ZERO);
        let mut factors = fresnel.iter();
        crop_spectrum(&self.plan.wave_grid, self.exit.points, self.plan.band_limit, |a, b, _| {
            if let Some(factor) = factors.next() {
                kept[b.0 * to + b.1] = wave[a.0 * from + a.1] * factor;
            }
        });
        self.exit_fft.inverse(kept, exit);
    }

    /// Inverts [`Prism::compress`], except for the propagation, so that the wave can pass further slices.
    fn expand(
        &self,
        wave: &mut [Complex32],
        kept: &mut [Complex32],
        w: &mut StepWorkspace,
        exit: &mut Scratch,
    ) {
        self.exit_fft.forward(kept, exit);
        let (from, to) = (self.exit_fft.stride(), self.stepper.fft().stride());
        let [nx, ny] = self.exit.points;
        let scale = 1.0 / (nx * ny) as f32;
        wave.fill(Complex32::ZERO);
        crop_spectrum(&self.exit, self.plan.wave_grid.points, self.plan.band_limit, |a, b, _| {
            wave[b.0 * to + b.1] = kept[a.0 * from + a.1] * scale;
        });
        self.stepper.start(wave, self.stepper.band(), &mut w.fft);
    }
}

/// Calls `copy((iy, ix) on grid, (iy, ix) on the other grid, k)` for every frequency below `limit` (1/Angstrom). The
/// other grid, of `points` (x, y) over the same extent, must hold them all.
fn crop_spectrum(
    grid: &Grid,
    points: [usize; 2],
    limit: f64,
    mut copy: impl FnMut((usize, usize), (usize, usize), [f64; 2]),
) {
    let dk = grid.dk();
    let reach = grid.common_reach(points, limit).map(|n| n as i64);
    // Frequencies are below n / 2 in modulus, so adding n once is enough.
    let bin = |f: i64, n: usize| (if f < 0 { f + n as i64 } else { f }) as usize;
    for fy in -reach[1]..=reach[1] {
        for fx in -reach[0]..=reach[0] {
            let k = [fx as f64 * dk[0], fy as f64 * dk[1]];
            if k[0] * k[0] + k[1] * k[1] < limit * limit {
                let a = (bin(fy, grid.points[1]), bin(fx, grid.points[0]));
                let b = (bin(fy, points[1]), bin(fx, points[0]));
                copy(a, b, k);
            }
        }
    }
}
