//! Patches of probes that share a window. They decide the window's place, and whether the probes are expanded in fewer waves.

use super::plan::Plan;
use super::probe_scan::{ProbePlaces, Scan};
use super::settings::Expansion;
use crate::plane;
use crate::resample::image_band_limit;
use std::ops::Range;

/// Distance in Angstrom within which probes that are propagated one by one share a window (four probes along each axis). Transmission
/// functions are then read from memory once for all of them. 0.9 A takes 20 % less time than 0.4 A, and 1.2 A takes 8 % less than 0.9 A.
/// Errors hardly change (SrTiO3, 39 A, rms / mean: 7.8 A windows 0.70 % with 0.4 A, 0.72 % with 0.6, 0.9 and 1.2 A; 5.9 A windows 0.96,
/// 0.71, 0.76 and 0.80 %).
const TOGETHER_ANGSTROM: f64 = 1.2;
/// Largest width in Angstrom of a patch of expanded probes, at 200 kV and 21 mrad, and largest share of the window's width. Wider patches
/// need fewer waves, but come nearer to the window's edge.
const PATCH: (f64, f64) = (3.6, 0.5);
/// The Nyquist distance of the amplitude in Angstrom at 200 kV and 21 mrad.
const USUAL_NYQUIST_ANGSTROM: f64 = 0.597;
/// Error of the amplitudes of expanded probes, as a share, in a window of this width (Angstrom), and the power of the
/// width by which it falls in wider ones.
const USUAL_ERROR: (f64, f64, i32) = (0.01, 7.8, 3);
/// Estimates the number of waves of a patch along an axis: a constant, and a number for each Nyquist distance of the amplitude. Accurate to
/// 2 % for errors of 1 % and square patches of 2 to 4 A.
const WAVES: (f64, f64) = (2.8, 0.96);
/// Probes are expanded if this needs less than this share of the waves, since the expansion takes time too.
const WORTH: f64 = 0.9;

/// Probes that are propagated through the same part of the specimen.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Patch {
    /// Pixel (row, column) of the cell's grid under the window's first pixel.
    pub origin: (usize, usize),
    /// Index of each probe in the scan, and its position within the window in Angstrom.
    pub probes: Vec<(usize, [f64; 2])>,
}

impl Patch {
    /// Divides a patch into even parts of at most `most` probes; all keep the window.
    pub fn split(self, most: usize) -> impl Iterator<Item = Patch> {
        let Patch { origin, probes } = self;
        let even = probes.len().div_ceil(probes.len().div_ceil(most).max(1)).max(1);
        let parts: Vec<Patch> =
            probes.chunks(even).map(|part| Patch { origin, probes: part.to_vec() }).collect();
        parts.into_iter()
    }
}

/// The patches of a scan.
pub(super) struct ProbePatches {
    pub patches: Vec<Patch>,
    /// Error in amplitude, as a share, with which the probes of a patch are expanded in fewer waves; `None` if each is propagated.
    pub error: Option<f64>,
}

impl ProbePatches {
    /// Divides the probes into patches. The result depends on the plan and the positions only, not on the number of threads.
    pub fn new<'a>(plan: &Plan, places: impl Into<ProbePlaces<'a>>) -> Self {
        let scan = match places.into() {
            ProbePlaces::Raster(scan) => scan,
            ProbePlaces::Each(positions) => {
                return ProbePatches { patches: single_patches(plan, positions), error: None };
            }
        };
        let error = expansion_error(plan).filter(|_| expanded_waves(plan, scan).is_some());
        let most = error.map_or(TOGETHER_ANGSTROM, |_| patch_angstrom(plan));
        ProbePatches { patches: patches(plan, scan, most), error }
    }

    /// The largest distance (x, y) in Angstrom of a probe from the middle of its window.
    pub fn half(&self, plan: &Plan) -> [f64; 2] {
        let centre = window_centre(plan);
        let positions =
            || self.patches.iter().flat_map(|p| &p.probes).map(|(_, position)| position);
        [0, 1].map(|k| positions().map(|p| (p[k] - centre[k]).abs()).fold(0.0, f64::max))
    }
}

/// Approximate number of waves in which the probes of a scan are expanded; `None` if each is propagated.
pub(super) fn expanded_waves(plan: &Plan, scan: &Scan) -> Option<usize> {
    expansion_error(plan)?;
    let most = patch_angstrom(plan);
    let nyquist = amplitude_nyquist(plan);
    let along = |k: usize| {
        let blocks = blocks(scan.shape[1 - k], scan.step_angstrom[k], most);
        let of = |lines: &Range<usize>| {
            let length = (lines.len() - 1) as f64 * scan.step_angstrom[k].abs();
            (WAVES.0 + WAVES.1 * length / nyquist).min(lines.len() as f64)
        };
        blocks.iter().filter(|b| !b.is_empty()).map(of).sum::<f64>()
    };
    let waves = along(0) * along(1);
    (waves < WORTH * scan.len() as f64).then_some(waves as usize)
}

/// Approximate largest number of waves in which the probes of one patch are expanded; 0 if each is propagated.
pub(super) fn waves_of_patch(plan: &Plan) -> usize {
    let along = WAVES.0 + WAVES.1 * patch_angstrom(plan) / amplitude_nyquist(plan);
    expansion_error(plan).map_or(0, |_| (along * along) as usize)
}

/// The Nyquist distance, in Angstrom, of amplitudes as a function of the probe's position.
pub(super) fn amplitude_nyquist(plan: &Plan) -> f64 {
    1.0 / image_band_limit(&plan.settings.optics)
}

/// The amplitude error that the settings allow for expanded probes; `None` without windows or with expansion off.
fn expansion_error(plan: &Plan) -> Option<f64> {
    if !plan.has_windows() {
        return None;
    }
    let (error, at, power) = USUAL_ERROR;
    match plan.settings.expansion {
        Expansion::Off => None,
        Expansion::Error(error) => Some(error),
        Expansion::Auto => Some(error * (at / width(plan)).min(1.0).powi(power)),
    }
}

/// Largest width of patches of expanded probes in Angstrom.
fn patch_angstrom(plan: &Plan) -> f64 {
    let most = PATCH.0 * amplitude_nyquist(plan) / USUAL_NYQUIST_ANGSTROM;
    most.min(PATCH.1 * width(plan))
}

/// The largest distance (x, y) in Angstrom of a probe from the middle of its window, in any scan.
pub(super) fn largest_half(plan: &Plan) -> [f64; 2] {
    let most = patch_angstrom(plan).max(TOGETHER_ANGSTROM);
    // Windows begin at pixels.
    plan.wave_grid.sampling_angstrom().map(|pixel| 0.5 * most + pixel)
}

/// Width of the windows in Angstrom.
fn width(plan: &Plan) -> f64 {
    let [x, y] = plan.wave_grid.extent_angstrom;
    x.min(y)
}

/// A patch for each probe, with a window around it. Without windows there is one patch, and its window is the cell.
fn single_patches(plan: &Plan, positions: &[[f64; 2]]) -> Vec<Patch> {
    let probe = |(i, &position)| (i, position);
    if !plan.has_windows() {
        let probes = positions.iter().enumerate().map(probe).collect();
        return vec![Patch { origin: (0, 0), probes }];
    }
    let (cell, grid) = (&plan.transmission_grid, &plan.wave_grid);
    let pixel = grid.sampling_angstrom();
    let patch = |(i, position): (usize, [f64; 2])| {
        let first = plane::sub(
            plane::div(position, pixel).map(|n| n.round() as i64),
            grid.points.map(|n| n as i64 / 2),
        );
        let wrap = |k: usize| first[k].rem_euclid(cell.points[k] as i64) as usize;
        let local = plane::sub(position, plane::mul(first.map(|n| n as f64), pixel));
        Patch { origin: (wrap(1), wrap(0)), probes: vec![(i, local)] }
    };
    positions.iter().enumerate().map(probe).map(patch).collect()
}

/// Divides a scan into even patches of at most `most` Angstrom along each axis, each with a window around its middle.
/// Without windows there is one patch, and its window is the cell.
fn patches(plan: &Plan, scan: &Scan, most: f64) -> Vec<Patch> {
    let (cell, grid) = (&plan.transmission_grid, &plan.wave_grid);
    let pixel = grid.sampling_angstrom();
    let whole = !plan.has_windows();
    let most = if whole { f64::INFINITY } else { most };
    let blocks = [0, 1].map(|k| blocks(scan.shape[1 - k], scan.step_angstrom[k], most));
    let mut patches = Vec::with_capacity(blocks[0].len() * blocks[1].len());
    for rows in &blocks[1] {
        for columns in &blocks[0] {
            let block = [columns, rows];
            let first = [0, 1].map(|k| {
                let middle = 0.5 * (block[k].start + block[k].end - 1) as f64;
                let middle = scan.origin_angstrom[k] + middle * scan.step_angstrom[k];
                (middle / pixel[k]).round() as i64 - grid.points[k] as i64 / 2
            });
            let first = if whole { [0, 0] } else { first };
            let wrap = |k: usize| first[k].rem_euclid(cell.points[k] as i64) as usize;
            let indices = rows.clone().flat_map(|y| {
                let columns = columns.clone();
                columns.map(move |x| y * scan.shape[1] + x)
            });
            let local = |i: usize| {
                let position = scan.position(i);
                (i, plane::sub(position, plane::mul(first.map(|n| n as f64), pixel)))
            };
            patches
                .push(Patch { origin: (wrap(1), wrap(0)), probes: indices.map(local).collect() });
        }
    }
    patches
}

/// Divides lines with a distance `step` into even blocks narrower than `most`.
pub(super) fn blocks(lines: usize, step: f64, most: f64) -> Vec<Range<usize>> {
    let number = ((lines as f64 * step.abs() / most - 1e-9).ceil() as usize).clamp(1, lines.max(1));
    (0..number).map(|i| i * lines / number..(i + 1) * lines / number).collect()
}

/// The middle of a window in Angstrom, counted from its first pixel.
pub(super) fn window_centre(plan: &Plan) -> [f64; 2] {
    let pixel = plan.wave_grid.sampling_angstrom();
    plane::mul(plan.wave_grid.points.map(|n| (n / 2) as f64), pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_even_and_hold_all_lines() {
        let of = |lines, step, most| blocks(lines, step, most);
        assert_eq!(of(12, 0.3, 3.6), vec![0..12]);
        assert_eq!(of(13, 0.3, 3.6), vec![0..6, 6..13]);
        assert_eq!(of(3, 5.0, 3.6), vec![0..1, 1..2, 2..3]);
        assert_eq!(of(1, 0.0, 3.6), vec![0..1]);
        let all: usize = of(1001, 0.28, 3.6).iter().map(|b| b.len()).sum();
        assert_eq!(all, 1001);
    }
}
