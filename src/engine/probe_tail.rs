//! Scattering of the part of a probe outside its window onto the detectors.
//!
//! One or two per cent of the probe lie outside its window. This tail, far from the probe's axis, comes from the edge of the aperture. It
//! does not channel, and each atom scatters it independently: `I_tail = sum_a P(r_a) s_a`. P is the intensity of the tail (1/Angstrom^2)
//! after half the thickness of free space, s_a the cross section of the atom for the detector. Without this correction, windows of 7.8 A
//! are too dark everywhere by 0.8 % of the mean image, which is 3-5 % between columns.

use super::grid::Grid;
use super::plan::Plan;
use super::probe::{Lens, aperture, probe_in_box, repeated};
use super::probe_patches::{ProbePatches, window_centre};
use super::probe_scan::ProbePlaces;
use super::settings::sees_tail;
use super::single_precision::single;
use crate::constants::interaction_parameter;
use crate::detect::Detector;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, Scratch, frequency, good_size};
use crate::made_once::KeptWithin;
use crate::plane;
use crate::potential::cores::cross_section;
use crate::potential::scattering::ScatteringFactor;
use crate::structure::Site;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// Whether the detector begins at angles large enough to see only electrons of the tail that atoms scatter, not the tail directly.
fn applies(detector: &Detector, plan: &Plan) -> bool {
    !sees_tail(detector, &plan.settings.optics)
}

/// The tails of a plan's probes.
pub(super) struct ProbeTail<'a> {
    plan: &'a Plan,
    /// The aperture at each focus in the box `around`, with the weight of the focus.
    foci: Vec<(f64, Lens)>,
    /// The cell.
    cell: TailGrid,
    /// The box in which probes are made: the cell, repeated.
    around: TailGrid,
    /// Transforms of the intensities of tails at half of each recorded thickness, by the probe's distance from the middle of its window
    /// and the number of the thickness. All library images of a family have the same.
    kept: KeptWithin<([u64; 2], usize), Buffer>,
}

/// Largest pixel of the grid of tails in Angstrom: their intensity holds no detail below 0.3 A.
const PIXEL_ANGSTROM: f64 = 0.15;
/// Probes share one tail if their positions in their windows differ by less than this distance along an axis, in Angstrom.
const ALIKE_ANGSTROM: f64 = 1.2;
/// Intensities of tails are kept up to this many bytes.
const ROOM_BYTES: usize = 64 << 20;

impl<'a> ProbeTail<'a> {
    /// Prepares the tails; `None` if no part of the probes lies outside, or the correction is off.
    pub fn new(plan: &'a Plan) -> Option<Self> {
        let all = !plan.has_windows() && !plan.settings.large_probe_box();
        if all || !plan.settings.tail_correction {
            return None;
        }
        let extent_angstrom = plan.transmission_grid.extent_angstrom;
        let points = extent_angstrom.map(|l| good_size((l / PIXEL_ANGSTROM).ceil() as usize, 1));
        let grid = Grid { points, extent_angstrom };
        let (cell, around) = (TailGrid::new(grid), TailGrid::new(repeated(plan, &grid)));
        let lens = |(weight, plan): (f64, Plan)| (weight, aperture(&plan, &around.grid));
        let foci = plan.at_foci().into_iter().map(lens).collect();
        Some(ProbeTail { plan, foci, cell, around, kept: KeptWithin::new(ROOM_BYTES) })
    }

    /// The intensities that the tails add, as fractions of the beam: (probe, recorded thickness, detector), row-major.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`] for an element that the tables lack.
    pub fn values(&self, sites: &[Site], places: ProbePlaces<'_>) -> Result<Vec<f64>> {
        let plan = self.plan;
        let detectors = &plan.settings.detectors;
        let thicknesses = plan.thicknesses_angstrom();
        let mut out = vec![0.0; places.len() * thicknesses.len() * detectors.len()];
        let alike = self.alike(places);
        let seen = detectors.iter().enumerate().filter(|(_, d)| applies(d, plan));
        let atoms = seen.map(|(d, detector)| Ok((d, self.atoms(sites, detector)?)));
        let atoms: Vec<(usize, Vec<Buffer>)> = atoms.collect::<Result<_>>()?;
        let bytes = size_of::<Complex32>() * self.cell.fft.stride() * self.cell.fft.shape().0;
        let values = alike.par_iter().map(|(offset, probes)| {
            let mut scratch = (self.cell.fft.scratch(), self.around.fft.scratch());
            let mut outside = None;
            let mut values = Vec::new();
            for (r, thickness) in thicknesses.iter().enumerate() {
                let tail = self.kept.get((offset.map(f64::to_bits), r), bytes, || {
                    let outside =
                        outside.get_or_insert_with(|| self.at_foci(*offset, &mut scratch.1));
                    self.intensity(outside, 0.5 * thickness, &mut scratch)
                });
                for (d, atoms) in &atoms {
                    let map = self.cell.correlate(&tail, &atoms[r], &mut scratch.0);
                    let at = |i: usize| (i * thicknesses.len() + r) * detectors.len() + d;
                    let value = |&i: &usize| (at(i), self.cell.value(&map, places.position(i)));
                    values.extend(probes.iter().map(value));
                }
            }
            values
        });
        let values: Vec<Vec<(usize, f64)>> = values.collect();
        values.into_iter().flatten().for_each(|(at, value)| out[at] = value);
        Ok(out)
    }

    /// The tail's Fourier coefficients at the entrance, for each focus with its weight.
    fn at_foci(&self, offset: [f64; 2], scratch: &mut Scratch) -> Vec<(f64, Buffer)> {
        let at = |(weight, lens): &(f64, Lens)| (*weight, self.outside(lens, offset, scratch));
        self.foci.iter().map(at).collect()
    }

    /// Transforms of the cross sections of all atoms up to each recorded thickness.
    fn atoms(&self, sites: &[Site], detector: &Detector) -> Result<Vec<Buffer>> {
        let slices = &self.plan.slices;
        let sections = cross_sections(self.plan, sites, detector)?;
        let up_to = |&slice: &usize| {
            let last = slices.boundaries[slice + 1];
            let inside = sites.iter().filter(|s| slices.wrap(s.position[2]) < last);
            self.cell.atoms(inside.map(|s| (s.position, sections.get(&s.number).copied())))
        };
        Ok(self.plan.record_after.iter().map(up_to).collect())
    }

    /// Transform of the intensity of a tail after `distance` (Angstrom) of free space, folded into the cell. `outside` holds the tail's
    /// Fourier coefficients at the entrance, for each focus with its weight.
    fn intensity(
        &self,
        outside: &[(f64, Buffer)],
        distance: f64,
        scratch: &mut (Scratch, Scratch),
    ) -> Buffer {
        let mut sum = self.cell.fft.buffer();
        for (weight, outside) in outside {
            let mut tail = outside.clone();
            self.around.propagate(&mut tail, distance, self.plan, &mut scratch.1);
            let tail = self.cell.folded(&tail, &self.around);
            sum.iter_mut().zip(&*tail).for_each(|(s, t)| *s += t * *weight as f32);
        }
        self.cell.fft.forward(&mut sum, &mut scratch.0);
        sum
    }

    /// Groups of probes at nearly the same position in their windows: their distance (x, y) in Angstrom from the middle, and
    /// their indices.
    fn alike(&self, places: ProbePlaces<'_>) -> Vec<([f64; 2], Vec<usize>)> {
        let plan = self.plan;
        if !plan.has_windows() {
            // The probe is cropped to the cell once, and its tail moves with it.
            return vec![([0.0; 2], (0..places.len()).collect())];
        }
        let patches = ProbePatches::new(plan, places);
        let (centre, half) = (window_centre(plan), patches.half(plan));
        let number = half.map(|h| (2.0 * h / ALIKE_ANGSTROM).ceil().max(1.0));
        let width = plane::per_axis(half, number, |half, n| 2.0 * half / n);
        let mut classes: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
        for (i, position) in patches.patches.iter().flat_map(|p| &p.probes) {
            let class = [0, 1].map(|k| {
                let from_edge = position[k] - centre[k] + half[k];
                (from_edge / width[k].max(1e-9)).floor().clamp(0.0, number[k] - 1.0) as i64
            });
            classes.entry(class).or_default().push(*i);
        }
        let offset = |c: [i64; 2]| plane::sub(plane::mul(c.map(|n| n as f64 + 0.5), width), half);
        classes.into_iter().map(|(class, probes)| (offset(class), probes)).collect()
    }

    /// Fourier coefficients of the tail of a probe at the origin: the part outside a window whose middle is at a distance of `offset`
    /// (Angstrom) from the probe.
    fn outside(&self, lens: &Lens, offset: [f64; 2], scratch: &mut Scratch) -> Buffer {
        let around = &self.around;
        let (window, centre) = (&self.plan.wave_grid, window_centre(self.plan));
        // The window begins at the origin of the box.
        let position = plane::add(centre, offset);
        let mut wave = probe_in_box(lens, &around.grid, position, &around.fft, scratch);
        let (columns, rows) = (around.share_within(window, 0), around.share_within(window, 1));
        for (row, y) in wave.chunks_exact_mut(around.fft.stride()).zip(&rows) {
            row.iter_mut().zip(&columns).for_each(|(v, x)| *v *= 1.0 - x * y);
        }
        around.fft.forward(&mut wave, scratch);
        around.shift(&mut wave, position);
        wave
    }
}

/// Cross section in Angstrom^2 of each element of the sites for scattering onto the detector.
fn cross_sections(plan: &Plan, sites: &[Site], detector: &Detector) -> Result<BTreeMap<u8, f64>> {
    let optics = &plan.settings.optics;
    let per_mrad = 1e-3 / optics.wavelength_angstrom();
    let annuli = detector.annuli(plan.cutoff_mrad());
    let sigma = interaction_parameter(optics.energy_ev());
    let elements: BTreeSet<u8> = sites.iter().map(|s| s.number).collect();
    let section = |number: u8| {
        let factor = ScatteringFactor::new(plan.settings.parametrization, number)?;
        let parts = annuli.iter().map(|(range, share)| {
            let [inner, outer] = range.map(|angle| angle * per_mrad);
            share * cross_section(&factor, sigma, inner, outer)
        });
        Ok((number, detector.azimuth_share() * parts.sum::<f64>()))
    };
    elements.into_iter().map(section).collect()
}

/// A grid of the whole cell, or of several cells.
struct TailGrid {
    grid: Grid,
    fft: Fft2,
}

impl TailGrid {
    fn new(grid: Grid) -> Self {
        let (ny, nx) = grid.shape();
        TailGrid { grid, fft: Fft2::new(ny, nx) }
    }

    /// The share of each column (axis 0) or row (axis 1) of pixels that lies in a window beginning at the origin. Pixels are centred on
    /// their points.
    fn share_within(&self, window: &Grid, axis: usize) -> Vec<f32> {
        let (n, extent) = (self.grid.points[axis], self.grid.extent_angstrom[axis]);
        let pixel = self.grid.sampling_angstrom()[axis];
        let half = 0.5 * window.sampling_angstrom()[axis];
        let (low, high) = (-half, window.extent_angstrom[axis] - half);
        let share = |i: usize| {
            let x = frequency(i, n) as f64 * pixel;
            let x = if x < -0.5 * (extent - high) { x + extent } else { x };
            let (from, to) = (x - 0.5 * pixel, x + 0.5 * pixel);
            ((to.min(high) - from.max(low)) / pixel).clamp(0.0, 1.0) as f32
        };
        (0..n).map(share).collect()
    }

    /// Multiplies Fourier coefficients by `f(k_y) f(k_x)`; `factor` takes the axis and the frequency in 1/Angstrom.
    fn multiply(&self, wave: &mut [Complex32], factor: impl Fn(usize, f64) -> Complex64) {
        let dk = self.grid.dk();
        let axis = |k: usize| -> Vec<Complex32> {
            let n = self.grid.points[k];
            (0..n).map(|i| single(factor(k, frequency(i, n) as f64 * dk[k]))).collect()
        };
        let (along_x, along_y) = (axis(0), axis(1));
        for (row, fy) in wave.chunks_exact_mut(self.fft.stride()).zip(&along_y) {
            row.iter_mut().zip(&along_x).for_each(|(v, fx)| *v *= fx * fy);
        }
    }

    /// Moves the point at `position` (Angstrom) to the origin.
    fn shift(&self, wave: &mut [Complex32], position: [f64; 2]) {
        self.multiply(wave, |axis, k| Complex64::from_polar(1.0, 2.0 * PI * k * position[axis]));
    }

    /// Propagates a wave, given as Fourier coefficients times the number of pixels, through free space. Leaves its intensity in real space,
    /// which sums to the wave's share of the beam.
    fn propagate(&self, wave: &mut [Complex32], distance: f64, plan: &Plan, scratch: &mut Scratch) {
        let (ny, nx) = self.fft.shape();
        let wavelength = plan.settings.optics.wavelength_angstrom();
        let slope = plan.settings.optics.slope();
        self.multiply(wave, |axis, k| {
            let phase = -PI * wavelength * distance * k * k - 2.0 * PI * distance * slope[axis] * k;
            Complex64::from_polar(1.0, phase)
        });
        self.fft.inverse(wave, scratch);
        // Coefficients of a whole probe have norm 1, and a forward and an inverse transform multiply by the pixels.
        let pixels = (nx * ny) as f32;
        let scale = 1.0 / (pixels * pixels * pixels);
        wave.iter_mut().for_each(|v| *v = Complex32::new(v.norm_sqr() * scale, 0.0));
    }

    /// Folds an array of a box of several cells into this cell: the sum over the cells.
    fn folded(&self, large: &[Complex32], of: &TailGrid) -> Buffer {
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

    /// Transform of the map of the atoms' cross sections per area; `atoms` are positions in Angstrom and cross sections in
    /// Angstrom^2.
    fn atoms(&self, atoms: impl Iterator<Item = ([f64; 3], Option<f64>)>) -> Buffer {
        let stride = self.fft.stride();
        let pixel = self.grid.sampling_angstrom();
        let per_pixel = 1.0 / (pixel[0] * pixel[1]);
        let mut map = self.fft.buffer();
        for ([x, y, _], section) in atoms {
            let value = section.unwrap_or(0.0) * per_pixel;
            for (row, column, weight) in self.between([x, y]) {
                map[row * stride + column].re += (value * weight) as f32;
            }
        }
        self.fft.forward(&mut map, &mut self.fft.scratch());
        map
    }

    /// `sum_a s_a P(r_a - shift)` for every shift of the tail's intensity P; `tail` and `atoms` are transforms.
    fn correlate(&self, tail: &[Complex32], atoms: &Buffer, scratch: &mut Scratch) -> Buffer {
        let mut map = atoms.clone();
        map.iter_mut().zip(tail).for_each(|(a, t)| *a *= t.conj());
        self.fft.inverse(&mut map, scratch);
        map
    }

    /// The value of a correlation for a probe at `position` (Angstrom).
    fn value(&self, map: &[Complex32], position: [f64; 2]) -> f64 {
        let (ny, nx) = self.fft.shape();
        let part = |(row, column, weight): (usize, usize, f64)| {
            f64::from(map[row * self.fft.stride() + column].re) * weight
        };
        let sum: f64 = self.between(position).map(part).sum();
        (sum / (nx * ny) as f64).max(0.0)
    }

    /// The grid points (row, column) around a position in Angstrom, with their weights in linear interpolation.
    fn between(&self, position: [f64; 2]) -> impl Iterator<Item = (usize, usize, f64)> {
        let pixel = self.grid.sampling_angstrom();
        let place = plane::div(position, pixel);
        let axis = |k: usize| {
            let (first, rest) = (place[k].floor(), place[k] - place[k].floor());
            let n = self.grid.points[k] as i64;
            let at = |i: i64| (first as i64 + i).rem_euclid(n) as usize;
            [(at(0), 1.0 - rest), (at(1), rest)]
        };
        let (columns, rows) = (axis(0), axis(1));
        rows.into_iter()
            .flat_map(move |(row, wy)| columns.map(|(column, wx)| (row, column, wx * wy)))
    }
}
