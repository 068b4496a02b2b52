//! What the part of a probe outside its window would have scattered onto the detectors.
//!
//! A window holds all but a per cent or two of the probe. The rest, far from the probe's axis, comes from
//! the edge of the aperture; it does not channel, and scatters from each atom as if that were alone:
//! `I_tail = sum_a P(r_a) s_a`, P the intensity of the tail (1/Angstrom^2), carried by free space to half the
//! thickness, s_a the atom's cross section for the detector. Without it windows of 7.8 A read 0.8 % of the
//! mean image too low everywhere, which between columns is 3-5 %.

use super::accuracy::LEAST_INNER_SEMIANGLES;
use super::multislice::{probe_grid, probe_in_box, window_centre};
use super::plan::{Grid, Plan};
use super::prism::single;
use super::{Scan, Site};
use crate::constants::interaction_parameter;
use crate::detect::Detector;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, Scratch, frequency};
use crate::potential::cores::cross_section;
use crate::potential::scattering::ScatteringFactor;
use num_complex::{Complex32, Complex64};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// Whether a detector sees the scattering of the tail only.
fn applies(detector: &Detector, plan: &Plan) -> bool {
    detector.inner_mrad >= LEAST_INNER_SEMIANGLES * plan.settings.optics.semiangle_mrad
}

/// The tails of a plan's probes.
pub(super) struct Tail<'a> {
    plan: &'a Plan,
    cell: Cell,
    /// Transform of the tail's intensity at half of each recorded thickness, folded into the cell.
    intensities: Vec<Buffer>,
}

impl<'a> Tail<'a> {
    /// `None` where the plan has no windows.
    pub fn new(plan: &'a Plan) -> Option<Self> {
        let all = plan.wave_grid == plan.transmission_grid && !plan.settings.large_probe_box();
        if all || !plan.settings.tail_correction {
            return None;
        }
        let (cell, around) =
            (Cell::new(plan, &plan.transmission_grid), Cell::new(plan, &probe_grid(plan)));
        let mut scratch = cell.fft.scratch();
        let mut larger = around.fft.scratch();
        let outside = around.outside(plan, &mut larger);
        let intensity = |thickness: f64| {
            let mut tail = outside.clone();
            around.travel(&mut tail, 0.5 * thickness, plan, &mut larger);
            let mut tail = cell.folded(&tail, &around);
            cell.fft.forward(&mut tail, &mut scratch);
            tail
        };
        let intensities = plan.thicknesses_angstrom().into_iter().map(intensity).collect();
        Some(Tail { plan, cell, intensities })
    }

    /// Fractions of the beam as (probe, recorded thickness, detector), row-major.
    ///
    /// # Errors
    /// An element that the tables lack.
    pub fn values(&self, sites: &[Site], scan: &Scan) -> Result<Vec<f64>> {
        let Tail { plan, cell, intensities } = self;
        let detectors = &plan.settings.detectors;
        let mut scratch = cell.fft.scratch();
        let mut out = vec![0.0; scan.len() * intensities.len() * detectors.len()];
        for (d, detector) in detectors.iter().enumerate().filter(|(_, d)| applies(d, plan)) {
            let sections = cross_sections(plan, sites, detector)?;
            for (r, tail) in intensities.iter().enumerate() {
                let last = plan.slices.boundaries[plan.record_after[r] + 1];
                let inside = sites.iter().filter(|s| plan.slices.wrap(s.position[2]) < last);
                let atoms = inside.map(|s| (s.position, sections.get(&s.number).copied()));
                let map = cell.correlate(tail, atoms, &mut scratch);
                for probe in 0..scan.len() {
                    let at = (probe * intensities.len() + r) * detectors.len() + d;
                    out[at] = cell.value(&map, scan.position(probe));
                }
            }
        }
        Ok(out)
    }
}

/// Cross section of each element in Angstrom^2.
fn cross_sections(plan: &Plan, sites: &[Site], detector: &Detector) -> Result<BTreeMap<u8, f64>> {
    let optics = &plan.settings.optics;
    let per_mrad = 1e-3 / optics.wavelength_angstrom();
    let outer = detector.outer_mrad.min(plan.cutoff_mrad());
    let sigma = interaction_parameter(optics.energy_ev);
    let range = [detector.inner_mrad, outer].map(|angle| angle * per_mrad);
    let elements: BTreeSet<u8> = sites.iter().map(|s| s.number).collect();
    let section = |number: u8| {
        let factor = ScatteringFactor::new(plan.settings.parametrization, number)?;
        Ok((number, cross_section(&factor, sigma, range[0], range[1])))
    };
    elements.into_iter().map(section).collect()
}

/// A grid of the whole cell or more, with the middle of the window.
struct Cell {
    fft: Fft2,
    pixel: [f64; 2],
    centre: [f64; 2],
    dk: [f64; 2],
}

impl Cell {
    fn new(plan: &Plan, grid: &Grid) -> Self {
        let (ny, nx) = grid.shape();
        let (pixel, centre) = (grid.sampling_angstrom(), window_centre(plan));
        Cell { fft: Fft2::new(ny, nx), pixel, centre, dk: grid.dk() }
    }

    /// Fourier coefficients of the probe outside the window.
    fn outside(&self, plan: &Plan, scratch: &mut Scratch) -> Buffer {
        let mut wave = probe_in_box(plan, &self.fft, scratch);
        let [wx, wy] = plan.wave_grid.points;
        for row in wave.chunks_exact_mut(self.fft.stride()).take(wy) {
            row[..wx].fill(Complex32::ZERO);
        }
        self.fft.forward(&mut wave, scratch);
        wave
    }

    /// Takes a wave (Fourier coefficients times pixels) through free space and leaves its intensity, which sums
    /// to its share of the beam.
    fn travel(&self, wave: &mut [Complex32], distance: f64, plan: &Plan, scratch: &mut Scratch) {
        let (ny, nx) = self.fft.shape();
        let wavelength = plan.settings.optics.wavelength_angstrom();
        let axis = |n: usize, dk: f64| -> Vec<Complex32> {
            let phase = |i| -PI * wavelength * distance * (frequency(i, n) as f64 * dk).powi(2);
            let factor = |i| Complex64::from_polar(1.0, phase(i));
            (0..n).map(factor).map(single).collect()
        };
        let (along_x, along_y) = (axis(nx, self.dk[0]), axis(ny, self.dk[1]));
        for (row, fy) in wave.chunks_exact_mut(self.fft.stride()).zip(&along_y) {
            row.iter_mut().zip(&along_x).for_each(|(v, fx)| *v *= fx * fy);
        }
        self.fft.inverse(wave, scratch);
        // entries have norm 1 as coefficients; the inverse of a forward transform multiplies by the pixels
        let pixels = (nx * ny) as f32;
        let scale = 1.0 / (pixels * pixels * pixels);
        wave.iter_mut().for_each(|v| *v = Complex32::new(v.norm_sqr() * scale, 0.0));
    }

    /// The sum over this cell's places of what a larger box of several cells holds.
    fn folded(&self, large: &[Complex32], of: &Cell) -> Buffer {
        let mut out = self.fft.buffer();
        let ((ny, nx), (my, mx)) = (self.fft.shape(), of.fft.shape());
        for y in 0..my {
            let row = &large[y * of.fft.stride()..][..mx];
            let line = &mut out[y % ny * self.fft.stride()..][..nx];
            for part in row.chunks_exact(nx) {
                line.iter_mut().zip(part).for_each(|(to, from)| *to += from);
            }
        }
        out
    }

    /// `sum_a s_a P(r_a - shift)` for every shift of the tail's intensity P, of which `tail` is the transform.
    fn correlate(
        &self,
        tail: &[Complex32],
        atoms: impl Iterator<Item = ([f64; 3], Option<f64>)>,
        scratch: &mut Scratch,
    ) -> Buffer {
        let (ny, nx) = self.fft.shape();
        let stride = self.fft.stride();
        let mut map = self.fft.buffer();
        let per_pixel = 1.0 / (self.pixel[0] * self.pixel[1]);
        for (position, section) in atoms {
            let bin = |i: usize, n: usize| {
                ((position[i] / self.pixel[i]).round() as i64).rem_euclid(n as i64) as usize
            };
            map[bin(1, ny) * stride + bin(0, nx)].re += (section.unwrap_or(0.0) * per_pixel) as f32;
        }
        self.fft.forward(&mut map, scratch);
        map.iter_mut().zip(tail).for_each(|(m, p)| *m *= p.conj());
        self.fft.inverse(&mut map, scratch);
        map
    }

    /// For a probe at `position` (Angstrom).
    fn value(&self, map: &[Complex32], position: [f64; 2]) -> f64 {
        let (ny, nx) = self.fft.shape();
        let bin = |i: usize, n: usize| {
            let pixel = ((position[i] - self.centre[i]) / self.pixel[i]).round() as i64;
            pixel.rem_euclid(n as i64) as usize
        };
        let sum = f64::from(map[bin(1, ny) * self.fft.stride() + bin(0, nx)].re);
        (sum / (nx * ny) as f64).max(0.0)
    }
}
