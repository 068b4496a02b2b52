//! Detectors that begin within two semiangles, in windows: they see the tail of the probe itself, so they read the wave of the window and its
//! coherent tail (`coherent_tail`).
//!
//! Angles beyond the reach of the tail are read from the window's own frequencies. Other detectors see only electrons of the tail that atoms
//! scattered (`probe_tail`).

use super::coherent_tail::{CoherentTail, full_k, least_full_k};
use super::grid::Grid;
use super::multislice::PathPart;
use super::padded_box::{
    PaddedBox, PaddedWorkspace, SplitWorkspace, box_extent_angstrom, low_pass,
};
use super::plan::Plan;
use super::probe::highest_k;
use super::probe_patches::window_centre;
use crate::detect::{Detector, DetectorMap};
use num_complex::Complex32;

/// Least width of the box, in units of the wavelength over the semiangle (62 A at 200 kV and 21 mrad). The edge of the aperture is as wide as
/// a step of frequency.
const LEAST_WIDTH: f64 = 51.8;

/// The detectors of a plan that read the coherent tail.
pub(super) struct BrightDetectors<'a> {
    plan: &'a Plan,
    pub tail: CoherentTail<'a>,
    padded: PaddedBox,
    /// The detectors on the kept frequencies of the box.
    map: DetectorMap,
    /// The factor from fractions of the beam's amplitude to Fourier coefficients of the window times its pixels.
    pixels: f32,
}

/// One thread's arrays.
pub(super) struct BrightWorkspace {
    pub split: SplitWorkspace,
    padded: PaddedWorkspace,
    fine: Vec<Complex32>,
}

/// What is added to waves at a recorded thickness.
pub(super) struct TailThere {
    phases: [Vec<Complex32>; 2],
    transmission: Complex32,
}

/// Whether a detector reads the coherent tail.
fn reads_tail(detector: &Detector, plan: &Plan) -> bool {
    plan.has_windows() && plan.settings.reads_tail(detector)
}

/// The largest frequency (1/Angstrom) of the detectors that read the tail; `None` if there are none.
fn outermost_k(plan: &Plan) -> Option<f64> {
    let detectors = plan.settings.detectors.iter().filter(|d| reads_tail(d, plan));
    let outer = detectors.map(|d| d.outer_mrad).reduce(f64::max)?;
    let [dx, dy] = plan.wave_grid.dk();
    Some(1e-3 * outer / plan.settings.optics.wavelength_angstrom() + dx.max(dy))
}

/// Number of frequencies of a probe in the box around a window; 0 if no detector reads the tail.
pub(super) fn bright_box_bins(plan: &Plan) -> usize {
    if !plan.settings.detectors.iter().any(|d| reads_tail(d, plan)) {
        return 0;
    }
    let [x, y] = box_extent_angstrom(plan, LEAST_WIDTH);
    (std::f64::consts::PI * x * y * highest_k(plan).powi(2)) as usize
}

/// The frequency (1/Angstrom) up to which the tail is added in full: in thin specimens it would reach far beyond the detectors, at the cost
/// of a fine box.
fn reach_k(plan: &Plan) -> f64 {
    let needed = outermost_k(plan).unwrap_or(0.0).max(least_full_k(plan));
    full_k(plan).min(needed)
}

/// The detectors of a plan on the frequencies of its wave grid, with `stride` elements from row to row: whole, or without the angles that
/// [`BrightDetectors`] read from the box.
pub(super) fn window_map(plan: &Plan, stride: usize) -> DetectorMap {
    let per_k = 1e3 * plan.settings.optics.wavelength_angstrom();
    let full_k = reach_k(plan);
    let share = |detector: &Detector, theta_mrad: f64| match reads_tail(detector, plan) {
        true => 1.0 - low_pass(theta_mrad / per_k, full_k).powi(2),
        false => 1.0,
    };
    let grid = plan.wave_grid;
    let k = |iy, ix| grid.k(iy, ix);
    plan.detector_map_of(&grid, stride, plan.detector_ramp_mrad(), share, k)
}

impl<'a> BrightDetectors<'a> {
    /// The detectors of a plan that read the tail; `None` if there are none. `bins` (row, column) of waves, with `stride` elements from row
    /// to row, contain probes.
    pub fn new(plan: &'a Plan, bins: &[(usize, usize)], stride: usize) -> Option<Self> {
        let most_k = outermost_k(plan)?;
        let window = plan.wave_grid;
        let padded = PaddedBox::new(plan, stride, [reach_k(plan), most_k], LEAST_WIDTH);
        let reach = padded.reach;
        let grid = Grid { points: padded.samples(), extent_angstrom: padded.extent_angstrom() };
        let share = |d: &Detector, _| f64::from(u8::from(reads_tail(d, plan)));
        // The box's frequencies rise from the most negative one; a grid has them in FFT order.
        let ascending = |i: usize, k: usize| (i + reach[k] + 1) % (2 * reach[k] + 1);
        // As on the full grid, each frequency counts wholly or not at all.
        let map = plan.detector_map_of(&grid, grid.points[0], 0.0, share, |iy, ix| {
            grid.k(ascending(iy, 1), ascending(ix, 0))
        });
        let tail = CoherentTail::new(plan, &padded, bins);
        let pixels = (window.points[0] * window.points[1]) as f32;
        Some(BrightDetectors { plan, tail, padded, map, pixels })
    }

    pub fn workspace(&self) -> BrightWorkspace {
        BrightWorkspace {
            split: self.tail.workspace(),
            padded: self.padded.workspace(),
            fine: vec![Complex32::ZERO; self.padded.len()],
        }
    }

    /// The share of the beam that falls on each detector without a specimen; for other detectors 0. `bins` and `stride` describe the waves, as
    /// in [`BrightDetectors::new`].
    pub fn without_specimen(&self, bins: &[(usize, usize)], stride: usize) -> Vec<f64> {
        let plan = self.plan;
        let mut w = self.workspace();
        let samples = self.padded.samples();
        let there = TailThere {
            phases: [0, 1].map(|k| vec![Complex32::ONE; samples[k]]),
            transmission: Complex32::ONE,
        };
        let mut found = vec![0.0; plan.settings.detectors.len()];
        let mut one = found.clone();
        for (focus, (weight, _)) in plan.at_foci().into_iter().enumerate() {
            let at = (window_centre(plan), focus);
            let (inside, outside) = self.tail.probe(&self.padded, at, &mut w.split);
            let mut psi = vec![Complex32::ZERO; stride * plan.wave_grid.points[1]];
            for (&(row, column), v) in bins.iter().zip(&inside) {
                psi[row * stride + column] = v * self.pixels;
            }
            self.add(&psi, (&outside, &there), (&mut w, &mut one), (weight, &mut found));
        }
        found
    }

    /// The box around a window.
    pub fn padded(&self) -> &PaddedBox {
        &self.padded
    }

    /// The tail behind a part of a path, where the slices' mean transmission is `transmission`.
    pub fn tail_at(&self, part: &PathPart, transmission: Complex32) -> TailThere {
        TailThere { phases: self.padded.tail_phases(self.plan, part), transmission }
    }

    /// Calls `put(detector, amplitudes)` for a wave with its tail `outside`, as [`DetectorMap::gather`] does for the wave alone, with the
    /// same scale. `psi` holds Fourier coefficients of the window times its pixels.
    pub fn gather(
        &self,
        psi: &[Complex32],
        (outside, there): (&[Complex32], &TailThere),
        w: &mut BrightWorkspace,
        put: impl FnMut(usize, &[Complex32]),
    ) {
        self.sample(psi, (outside, there), w);
        w.fine.iter_mut().for_each(|v| *v *= self.pixels);
        self.map.gather(&w.fine, put);
    }

    /// Adds to `out` the intensity on each detector, as a fraction of the beam times `weight`.
    pub fn add(
        &self,
        psi: &[Complex32],
        (outside, there): (&[Complex32], &TailThere),
        (w, one): (&mut BrightWorkspace, &mut [f64]),
        (weight, out): (f64, &mut [f64]),
    ) {
        self.sample(psi, (outside, there), w);
        self.map.collect(&w.fine, weight, one);
        out.iter_mut().zip(one).for_each(|(to, one)| *to += *one);
    }

    fn sample(
        &self,
        psi: &[Complex32],
        (outside, there): (&[Complex32], &TailThere),
        w: &mut BrightWorkspace,
    ) {
        self.padded.sample(psi, None, &mut w.padded, &mut w.fine);
        self.padded.add_tail(&mut w.fine, outside, there.transmission, &there.phases);
    }
}
