//! PRISM: probes put together from plane waves.
//!
//! C. Ophus, "A fast image simulation algorithm for scanning transmission electron microscopy",
//! Adv. Struct. Chem. Imaging 3 (2017) 13. Exit waves are kept on a grid that just holds the band
//! limit, which makes the reduction 2.25 times cheaper than on the full grid, and without interpolation loses nothing (see
//! `full_exit_grid` in [`super::settings::Settings`]).

use super::Scan;
use super::plan::{Grid, Plan};
use super::settings::Algorithm;
use super::stepper::{self, Specimen, Stepper};
use super::transmission::{Transmission, disk_reach};
use crate::detect::DetectorMap;
use crate::error::{Error, Result};
use crate::fft::{Buffer, Fft2, Scratch};
use crate::progress::Progress;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Propagates plane waves through given transmission functions and reduces them to images.
pub(super) struct Prism<'a> {
    pub(super) plan: &'a Plan,
    stepper: Stepper,
    /// Sorted by ky, then kx: indices on the Fourier grid of the cell.
    pub(super) beams: Vec<[i64; 2]>,
    /// Amplitudes of the beams in a probe at the origin; squared moduli sum to 1.
    pub(super) amplitudes: Vec<Complex64>,
    pub(super) exit: Grid,
    pub(super) exit_fft: Fft2,
    pub(super) window: Grid,
    pub(super) window_fft: Fft2,
    pub(super) map: DetectorMap,
}

struct Workspace {
    waves: Vec<Buffer>,
    step: stepper::Workspace,
    exit: Scratch,
}

impl<'a> Prism<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        let Algorithm::Prism { interpolation } = plan.settings.algorithm else {
            unreachable!("the engine starts PRISM for PRISM plans only")
        };
        let stepper = Stepper::new(plan);
        let exit = plan.exit_grid.unwrap_or(plan.wave_grid);
        let window = Grid {
            points: [0, 1].map(|i| exit.points[i] / interpolation[i]),
            extent_angstrom: [0, 1].map(|i| exit.extent_angstrom[i] / interpolation[i] as f64),
        };
        let optics = &plan.settings.optics;
        let dk = exit.dk();
        let beams = plan.prism_beams();
        let spacing = [0, 1].map(|i| dk[i] * interpolation[i] as f64);
        let amplitude =
            |b: &[i64; 2]| optics.transfer([0, 1].map(|i| b[i] as f64 * dk[i]), spacing);
        let mut amplitudes: Vec<Complex64> = beams.iter().map(amplitude).collect();
        let norm = amplitudes.iter().map(|a| a.norm_sqr()).sum::<f64>().sqrt();
        amplitudes.iter_mut().for_each(|a| *a /= norm);
        let (ny, nx) = exit.shape();
        let (wy, wx) = window.shape();
        let window_fft = Fft2::new(wy, wx);
        let map = plan.detector_map(&window, window_fft.stride(), 0.0);
        let exit_fft = Fft2::new(ny, nx);
        Prism { plan, stepper, beams, amplitudes, exit, exit_fft, window, window_fft, map }
    }

    /// Intensities as (probe, recorded thickness, detector), row-major.
    pub fn run(
        &mut self,
        transmission: &Transmission,
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let detectors = self.plan.settings.detectors.len();
        let records = self.plan.record_after.len();
        let mut waves = Buffer::zeros(self.exit_plane() * self.beams.len());
        let mut out = vec![0.0; scan.len() * detectors * records];
        let mut first = 0;
        let specimen = Specimen { transmission, origin: (0, 0) };
        for (r, &last) in self.plan.record_after.iter().enumerate() {
            self.propagate(&mut waves, specimen, first..last + 1, progress)?;
            first = last + 1;
            for (probe, values) in self.reduce(&waves, scan, progress)? {
                let at = (probe * records + r) * detectors;
                out[at..at + detectors].copy_from_slice(&values);
            }
        }
        Ok(out)
    }

    /// Elements of one exit wave.
    pub(super) fn exit_plane(&self) -> usize {
        self.exit_fft.stride() * self.exit.points[1]
    }

    /// Carries all beams through the given slices to the exit boundary of the last.
    fn propagate(
        &mut self,
        waves: &mut [Complex32],
        specimen: Specimen<'_>,
        slices: std::ops::Range<usize>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let edges = &self.plan.slices.boundaries;
        let (entrance, exit) = (edges[slices.start], edges[slices.end]);
        let (legs, end) =
            self.stepper.route(entrance, specimen.transmission.filled(slices.clone()));
        let this = &*self;
        let to_exit = this.fresnel(exit - end);
        let (plane, fft) = (this.exit_plane(), this.stepper.fft());
        let group = this.stepper.group();
        let workspace = || Workspace {
            waves: vec![fft.buffer(); group],
            step: this.stepper.workspace(),
            exit: this.exit_fft.scratch(),
        };
        let groups = waves[..plane * this.beams.len()].par_chunks_mut(plane * group);
        groups.zip(this.beams.par_chunks(group)).try_for_each_init(workspace, |w, (kept, beams)| {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let Workspace { waves, step, exit } = w;
            let waves = &mut waves[..beams.len()];
            for ((wave, kept), beam) in
                waves.iter_mut().zip(kept.chunks_exact_mut(plane)).zip(beams)
            {
                match slices.start {
                    0 => this.plane_wave(wave, *beam),
                    _ => this.expand(wave, kept, step, exit),
                }
            }
            for leg in &legs {
                this.stepper.travel(waves, *leg, specimen, step);
            }
            for (wave, kept) in waves.iter_mut().zip(kept.chunks_exact_mut(plane)) {
                this.compress(wave, kept, &to_exit, step, exit);
            }
            progress.advance(beams.len() as u64);
            Ok(())
        })
    }

    /// `exp(-i pi lambda dz k^2)` over the number of pixels, in the order of [`crop_spectrum`].
    fn fresnel(&self, distance: f64) -> Vec<Complex32> {
        let wavelength = self.plan.settings.optics.wavelength_angstrom();
        let [nx, ny] = self.plan.wave_grid.points;
        let mut factors = Vec::new();
        crop_spectrum(&self.plan.wave_grid, self.exit.points, self.plan.band_limit, |_, _, k| {
            let phase = -PI * wavelength * distance * (k[0] * k[0] + k[1] * k[1]);
            let c = Complex64::from_polar(1.0 / (nx * ny) as f64, phase);
            factors.push(Complex32::new(c.re as f32, c.im as f32));
        });
        factors
    }

    /// `exp(2 pi i k.r)` in the stepper's representation: one column.
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

    /// From the stepper's wave (rows transformed) to the exit grid in real space.
    fn compress(
        &self,
        wave: &mut [Complex32],
        kept: &mut [Complex32],
        fresnel: &[Complex32],
        w: &mut stepper::Workspace,
        exit: &mut Scratch,
    ) {
        self.stepper.columns(wave, false, &mut w.fft);
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

    /// The reverse of [`Prism::compress`], to go on with further slices.
    fn expand(
        &self,
        wave: &mut [Complex32],
        kept: &mut [Complex32],
        w: &mut stepper::Workspace,
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

pub(super) fn single(c: Complex64) -> Complex32 {
    Complex32::new(c.re as f32, c.im as f32)
}

/// Calls `copy((iy, ix) on grid, (iy, ix) on the other grid, k)` for every frequency inside the disk
/// of radius `limit` (1/Angstrom). The other grid, of `points` (x, y) over the same extent, must
/// hold the disk.
fn crop_spectrum(
    grid: &Grid,
    points: [usize; 2],
    limit: f64,
    mut copy: impl FnMut((usize, usize), (usize, usize), [f64; 2]),
) {
    let dk = grid.dk();
    let reach = disk_reach(grid, points, limit).map(|n| n as i64);
    // Frequencies are below n / 2: no division.
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
