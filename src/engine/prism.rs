//! PRISM: probes put together from plane waves.
//!
//! C. Ophus, "A fast image simulation algorithm for scanning transmission electron microscopy",
//! Adv. Struct. Chem. Imaging 3 (2017) 13. Exit waves are kept on a grid that just holds the band
//! limit, which loses nothing and makes the reduction 2.25 times cheaper than on the full grid.

use super::Scan;
use super::multislice::shift_phases;
use super::plan::{Grid, Plan};
use super::settings::Algorithm;
use super::stepper::{Specimen, Stepper};
use super::transmission::crop_spectrum;
use crate::detect::{DetectorMap, Pattern};
use crate::error::{Error, Result};
use crate::fft::{Buffer, Fft2, Scratch};
use crate::progress::Progress;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Probes reduced together share one matrix product, over the union of their windows.
const PROBES_PER_BLOCK: usize = 48;
/// Probes whose windows start within this many pixels of each other may form a block.
const BLOCK_PIXELS: i64 = 24;

/// Propagates plane waves through given transmission functions and reduces them to images.
pub(super) struct Prism<'a> {
    plan: &'a Plan,
    stepper: Stepper,
    beams: Vec<[i64; 2]>,
    /// Amplitudes of the beams in a probe at the origin; squared moduli sum to 1.
    amplitudes: Vec<Complex64>,
    exit: Grid,
    exit_fft: Fft2,
    window: Grid,
    window_fft: Fft2,
    map: DetectorMap,
}

struct Workspace {
    wave: Buffer,
    scratch: Scratch,
    exit_scratch: Scratch,
}

/// Probes with nearby windows.
struct Block {
    probes: Vec<usize>,
    /// First pixel (x, y) of the union of windows on the exit grid, not wrapped.
    first: [i64; 2],
    /// Its size (x, y).
    size: [usize; 2],
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
        let wavelength = optics.wavelength_angstrom();
        let map = DetectorMap::new(
            &plan.settings.detectors,
            Pattern {
                shape: (wy, wx),
                stride: window_fft.stride(),
                limit_mrad: plan.band_limit_mrad,
                ramp_mrad: 0.0,
            },
            |iy, ix| {
                let [kx, ky] = window.k(iy, ix);
                kx.hypot(ky) * wavelength * 1e3
            },
        );
        let exit_fft = Fft2::new(ny, nx);
        Prism { plan, stepper, beams, amplitudes, exit, exit_fft, window, window_fft, map }
    }

    /// Intensities as (probe, recorded thickness, detector), row-major.
    pub fn run(
        &self,
        transmission: &[Buffer],
        stride: usize,
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let detectors = self.plan.settings.detectors.len();
        let records = self.plan.record_after.len();
        let plane = self.exit_fft.stride() * self.exit.points[1];
        let mut waves = Buffer::zeros(plane * self.beams.len());
        let mut out = vec![0.0; scan.len() * detectors * records];
        let blocks = self.blocks(scan);
        let mut next_slice = 0;
        for (r, &last) in self.plan.record_after.iter().enumerate() {
            let from = next_slice..last + 1;
            self.propagate(&mut waves, transmission, stride, from, progress)?;
            next_slice = last + 1;
            for (probe, values) in self.reduce(&waves, &blocks, scan, progress)? {
                let at = (probe * records + r) * detectors;
                out[at..at + detectors].copy_from_slice(&values);
            }
        }
        Ok(out)
    }

    /// Carries all beams through the given slices to the exit boundary of the last.
    fn propagate(
        &self,
        waves: &mut [Complex32],
        transmission: &[Buffer],
        stride: usize,
        slices: std::ops::Range<usize>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let s = &self.plan.slices;
        let shape = self.plan.wave_grid.shape();
        let plane = self.exit_fft.stride() * self.exit.points[1];
        let to_exit = s.boundaries[slices.end] - s.planes[slices.end - 1];
        let to_plane = s.planes[slices.start] - s.boundaries[slices.start];
        let fft = self.stepper.fft();
        let workspace = || Workspace {
            wave: fft.buffer(),
            scratch: fft.scratch(),
            exit_scratch: self.exit_fft.scratch(),
        };
        waves[..plane * self.beams.len()].par_chunks_mut(plane).enumerate().try_for_each_init(
            workspace,
            |w, (b, kept)| {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                if slices.start == 0 {
                    self.plane_wave(w, self.beams[b], to_plane);
                } else {
                    self.expand(w, kept, to_plane);
                }
                for i in slices.clone() {
                    let specimen =
                        Specimen { data: &transmission[i], stride, shape, origin: (0, 0) };
                    self.stepper.transmit(&mut w.wave, specimen, &mut w.scratch);
                    if i + 1 < slices.end {
                        self.stepper.propagate(&mut w.wave, i, &mut w.scratch);
                    }
                }
                self.compress(w, kept, to_exit);
                progress.advance(1);
                Ok(())
            },
        )
    }

    fn fresnel(&self, distance: f64, k: [f64; 2], scale: f64) -> Complex32 {
        let wavelength = self.plan.settings.optics.wavelength_angstrom();
        let c =
            Complex64::from_polar(scale, -PI * wavelength * distance * (k[0] * k[0] + k[1] * k[1]));
        Complex32::new(c.re as f32, c.im as f32)
    }

    /// `exp(2 pi i k.r)` at the first plane, in the stepper's representation.
    fn plane_wave(&self, w: &mut Workspace, beam: [i64; 2], distance: f64) {
        let [nx, ny] = self.plan.wave_grid.points;
        let dk = self.plan.wave_grid.dk();
        let k = [0, 1].map(|i| beam[i] as f64 * dk[i]);
        let at = (beam[1].rem_euclid(ny as i64) as usize, beam[0].rem_euclid(nx as i64) as usize);
        w.wave.fill(Complex32::ZERO);
        w.wave[at.0 * self.stepper.fft().stride() + at.1] = self.fresnel(distance, k, 1.0);
        self.stepper.columns(&mut w.wave, true, &mut w.scratch);
    }

    /// From the stepper's wave (rows transformed) to the exit grid in real space.
    fn compress(&self, w: &mut Workspace, kept: &mut [Complex32], distance: f64) {
        self.stepper.columns(&mut w.wave, false, &mut w.scratch);
        let (from, to) = (self.stepper.fft().stride(), self.exit_fft.stride());
        let [nx, ny] = self.plan.wave_grid.points;
        let scale = 1.0 / (nx * ny) as f64;
        kept.fill(Complex32::ZERO);
        crop_spectrum(&self.plan.wave_grid, self.exit.points, self.plan.band_limit, |a, b, k| {
            kept[b.0 * to + b.1] = w.wave[a.0 * from + a.1] * self.fresnel(distance, k, scale);
        });
        self.exit_fft.inverse(kept, &mut w.exit_scratch);
    }

    /// The reverse of [`Prism::compress`], to go on with further slices.
    fn expand(&self, w: &mut Workspace, kept: &mut [Complex32], distance: f64) {
        self.exit_fft.forward(kept, &mut w.exit_scratch);
        let (from, to) = (self.exit_fft.stride(), self.stepper.fft().stride());
        let [nx, ny] = self.exit.points;
        let scale = 1.0 / (nx * ny) as f64;
        w.wave.fill(Complex32::ZERO);
        crop_spectrum(&self.exit, self.plan.wave_grid.points, self.plan.band_limit, |a, b, k| {
            w.wave[b.0 * to + b.1] = kept[a.0 * from + a.1] * self.fresnel(distance, k, scale);
        });
        self.stepper.columns(&mut w.wave, true, &mut w.scratch);
    }

    /// Window start (x, y) on the exit grid for a probe.
    fn window_start(&self, position: [f64; 2]) -> [i64; 2] {
        let pixel = self.exit.sampling_angstrom();
        [0, 1].map(|i| {
            if self.window.points[i] == self.exit.points[i] {
                return 0;
            }
            (position[i] / pixel[i]).round() as i64 - self.window.points[i] as i64 / 2
        })
    }

    /// Groups probes with nearby windows, in an order that depends on the scan only.
    fn blocks(&self, scan: &Scan) -> Vec<Block> {
        let mut groups = std::collections::BTreeMap::<[i64; 2], Vec<usize>>::new();
        for i in 0..scan.len() {
            let start = self.window_start(scan.position(i));
            let cell = [1, 0].map(|a| start[a].div_euclid(BLOCK_PIXELS));
            groups.entry(cell).or_default().push(i);
        }
        let chunks = groups.values().flat_map(|g| g.chunks(PROBES_PER_BLOCK));
        chunks
            .map(|probes| {
                let starts: Vec<[i64; 2]> =
                    probes.iter().map(|&i| self.window_start(scan.position(i))).collect();
                let low = [0, 1].map(|a| starts.iter().map(|s| s[a]).min().unwrap_or(0));
                let high = [0, 1].map(|a| starts.iter().map(|s| s[a]).max().unwrap_or(0));
                let size = [0, 1].map(|a| (high[a] - low[a]) as usize + self.window.points[a]);
                Block { probes: probes.to_vec(), first: low, size }
            })
            .collect()
    }

    /// Images from exit waves: (probe, intensities on the detectors).
    fn reduce(
        &self,
        waves: &[Complex32],
        blocks: &[Block],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<(usize, Vec<f64>)>> {
        let per_block: Result<Vec<Vec<(usize, Vec<f64>)>>> = blocks
            .par_iter()
            .map(|block| {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                let values = self.reduce_block(waves, block, scan);
                progress.advance(block.probes.len() as u64);
                Ok(block.probes.iter().copied().zip(values).collect())
            })
            .collect();
        Ok(per_block?.into_iter().flatten().collect())
    }

    fn reduce_block(&self, waves: &[Complex32], block: &Block, scan: &Scan) -> Vec<Vec<f64>> {
        let coefficients = self.coefficients(block, scan);
        let region = self.superpose(waves, block, &coefficients);
        let [wx, wy] = self.window.points;
        let area = block.size[0] * block.size[1];
        let (mut wave, mut scratch) = (self.window_fft.buffer(), self.window_fft.scratch());
        let scale = 1.0 / ((wx * wy) as f64).powi(2);
        let reduce_one = |(p, &probe): (usize, &usize)| {
            let start = self.window_start(scan.position(probe));
            let offset = [0, 1].map(|a| (start[a] - block.first[a]) as usize);
            for y in 0..wy {
                let from = p * area + (offset[1] + y) * block.size[0] + offset[0];
                wave[y * self.window_fft.stride()..][..wx]
                    .copy_from_slice(&region[from..from + wx]);
            }
            self.window_fft.forward(&mut wave, &mut scratch);
            let mut values = vec![0.0; self.plan.settings.detectors.len()];
            self.map.collect(&wave, scale, &mut values);
            values
        };
        block.probes.iter().enumerate().map(reduce_one).collect()
    }

    /// Coefficient of each beam (fast) in each probe (slow).
    fn coefficients(&self, block: &Block, scan: &Scan) -> Vec<Complex32> {
        let mut out = Vec::with_capacity(block.probes.len() * self.beams.len());
        let points = self.exit.points;
        for &probe in &block.probes {
            let position = scan.position(probe);
            let phases =
                [0, 1].map(|i| shift_phases(position[i] / self.exit.extent_angstrom[i], points[i]));
            for (beam, amplitude) in self.beams.iter().zip(&self.amplitudes) {
                let bin = [0, 1].map(|i| beam[i].rem_euclid(points[i] as i64) as usize);
                let c = amplitude * phases[0][bin[0]] * phases[1][bin[1]];
                out.push(Complex32::new(c.re as f32, c.im as f32));
            }
        }
        out
    }

    /// The block's probes in real space on the union of their windows: (probe, y, x).
    fn superpose(&self, waves: &[Complex32], block: &Block, c: &[Complex32]) -> Vec<Complex32> {
        let (n, beams) = (block.probes.len(), self.beams.len());
        let [width, height] = block.size;
        let [nx, ny] = self.exit.points.map(|n| n as i64);
        let stride = self.exit_fft.stride();
        let plane = stride * self.exit.points[1];
        let mut out = vec![Complex32::ZERO; n * width * height];
        for y in 0..height {
            let row = (block.first[1] + y as i64).rem_euclid(ny) as usize * stride;
            let mut x = 0;
            while x < width {
                let column = (block.first[0] + x as i64).rem_euclid(nx) as usize;
                let run = (width - x).min(nx as usize - column);
                let source = &waves[row + column..(beams - 1) * plane + row + column + run];
                let target = &mut out[y * width + x..];
                assert!(c.len() == n * beams && target.len() > (n - 1) * width * height + run - 1);
                // target[p, x] = sum_b c[p, b] source[b, x]; lengths checked above.
                unsafe {
                    gemm::gemm(
                        n,
                        run,
                        beams,
                        target.as_mut_ptr(),
                        1,
                        (width * height) as isize,
                        false,
                        c.as_ptr(),
                        1,
                        beams as isize,
                        source.as_ptr(),
                        1,
                        plane as isize,
                        Complex32::ZERO,
                        Complex32::ONE,
                        false,
                        false,
                        false,
                        gemm::Parallelism::None,
                    );
                }
                x += run;
            }
        }
        out
    }
}
