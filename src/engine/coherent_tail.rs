//! The coherent tail: the part of a probe outside its window, whose wave is added to the wave of the window behind the specimen.
//!
//! A window lacks 1 to 5 % of its probe. Electrons of that part pass the specimen at low angles, where they interfere with the wave of the
//! window. The tail is propagated through free space, multiplied by the mean transmission of the slices around the window, and added in a
//! box twice as wide or wider (`padded_box`). Patterns (`patterns`) and detectors that begin within two semiangles (`bright_detectors`) read the sum.

use super::basis::Basis;
use super::multislice::PathPart;
use super::padded_box::{PaddedBox, ProbeSplit, SplitWorkspace};
use super::plan::Plan;
use super::probe::{CroppedProbe, low_bins};
use super::probe_patches::amplitude_nyquist;
use super::single_precision::single;
use super::stepper::TransmissionView;
use super::transmission::TransmissionLayout;
use super::workspace_pool::WorkspacePool;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;

/// The tail is added up to the angle at which electrons move by this share of the window's width inside the specimen.
const TAIL_REACH: f64 = 0.4;

/// The probes of a plan with windows, each in the box around its window.
pub(super) struct CoherentTail<'a> {
    plan: &'a Plan,
    split: ProbeSplit,
    /// The probe at each focus, with its weight.
    probes: Vec<(f64, CroppedProbe)>,
}

/// Waves that are propagated in place of the probes of a patch; all patches share them.
pub(super) struct SharedWaves {
    /// Coefficients on the bins of the window's probes.
    pub inside: Vec<Vec<Complex32>>,
    /// Kept frequencies in the box of the waves' part outside the window.
    pub outside: Vec<Vec<Complex32>>,
    basis: Basis,
}

impl SharedWaves {
    /// Number of waves.
    pub fn len(&self) -> usize {
        self.inside.len()
    }
}

impl<'a> CoherentTail<'a> {
    /// Prepares the probes. `bins` (row, column) of the window's grid contain probes.
    pub fn new(plan: &'a Plan, padded: &PaddedBox, bins: &[(usize, usize)]) -> Self {
        let grid = ProbeSplit::grid_around(padded);
        let box_bins = low_bins(plan, &grid);
        let split = ProbeSplit::new(padded, box_bins.clone(), bins.to_vec());
        let probe = |(weight, at): (f64, Plan)| {
            let boxed = Plan { wave_grid: grid, ..at };
            (weight, CroppedProbe::new(&boxed, &box_bins))
        };
        let probes = plan.at_foci().into_iter().map(probe).collect();
        CoherentTail { plan, split, probes }
    }

    pub fn workspace(&self) -> SplitWorkspace {
        self.split.workspace()
    }

    /// Converts a position in the window (Angstrom) to a position in the box.
    fn in_box(&self, position: [f64; 2]) -> [f64; 2] {
        let pixel = self.split.grid.sampling_angstrom();
        [0, 1].map(|k| position[k] + self.split.lead[k] as f64 * pixel[k])
    }

    /// The probe of a focus at a position in the window (Angstrom): coefficients on the window's bins, and the kept frequencies in the box
    /// of the part outside.
    pub fn probe(
        &self,
        padded: &PaddedBox,
        (position, focus): ([f64; 2], usize),
        w: &mut SplitWorkspace,
    ) -> (Vec<Complex32>, Vec<Complex32>) {
        let wave = self.probes[focus].1.at(self.in_box(position));
        let wave: Vec<Complex32> = wave.into_iter().map(single).collect();
        self.split.split(padded, &wave, w)
    }

    /// The waves for probes at most `half` (Angstrom, x and y) from the middle of the window. `error` is each probe's error as share of its
    /// amplitude.
    pub fn shared(&self, padded: &PaddedBox, half: [f64; 2], error: f64) -> SharedWaves {
        let probes: Vec<&CroppedProbe> = self.probes.iter().map(|(_, probe)| probe).collect();
        let basis = Basis::new(&probes, half, amplitude_nyquist(self.plan), error);
        let workspaces = WorkspacePool::new();
        let split = |j: usize| {
            let wave = basis.wave(j);
            workspaces.with(|| self.workspace(), |w| self.split.split(padded, wave, w))
        };
        let (inside, outside) = (0..basis.len()).into_par_iter().map(split).unzip();
        SharedWaves { inside, outside, basis }
    }

    /// The coefficients of probes on the shared waves, (wave, probe) row-major, for each focus with its weight.
    pub fn coefficients(
        &self,
        shared: &SharedWaves,
        probes: &[(usize, [f64; 2])],
    ) -> Vec<(f64, Vec<Complex32>)> {
        let places: Vec<(usize, [f64; 2])> =
            probes.iter().map(|(i, p)| (*i, self.in_box(*p))).collect();
        let of = |(weight, probe): &(f64, CroppedProbe)| {
            (*weight, shared.basis.coefficients(probe, &places))
        };
        self.probes.iter().map(of).collect()
    }
}

impl PaddedBox {
    /// The phases of the tail after free-space propagation to the end of a part of a path.
    pub fn tail_phases(&self, plan: &Plan, part: &PathPart) -> [Vec<Complex32>; 2] {
        let distance = part.height_angstrom - plan.slices.entrance();
        let (way, pixel) =
            (plan.beam_shift(part.height_angstrom), plan.wave_grid.sampling_angstrom());
        let way = [0, 1].map(|k| way[k] - part.moved[k] as f64 * pixel[k]);
        self.phases(way, plan.settings.optics.wavelength_angstrom() * distance)
    }
}

/// The frequency in 1/Angstrom up to which the coherent tail of a plan's windows is added in full.
pub(super) fn full_k(plan: &Plan) -> f64 {
    let [x, y] = plan.wave_grid.extent_angstrom;
    let thickness = plan.thicknesses_angstrom().into_iter().fold(0.0, f64::max);
    let angle = TAIL_REACH * x.min(y) / thickness.max(1e-3);
    (angle / plan.settings.optics.wavelength_angstrom())
        .max(least_full_k(plan))
        .min(plan.band_limit)
}

/// The tail is added in full at least up to 1.5 semiangles, here in 1/Angstrom.
pub(super) fn least_full_k(plan: &Plan) -> f64 {
    let optics = &plan.settings.optics;
    1.5e-3 * optics.semiangle_mrad / optics.wavelength_angstrom()
}

/// The product of the slices' mean transmissions around a window, up to each recorded thickness.
pub(super) fn mean_transmissions(plan: &Plan, view: TransmissionView<'_>) -> Vec<Complex32> {
    let TransmissionLayout::Padded { stride } = view.transmission.layout else {
        return vec![Complex32::ONE; plan.record_after.len()];
    };
    let cell = plan.transmission_grid.points;
    let window = plan.wave_grid.points;
    // The mean covers the box around the window, but no part of the cell twice.
    let lines = |k: usize, origin: usize| {
        let first = origin as i64 - window[k] as i64 / 2;
        let n = (2 * window[k]).min(cell[k]);
        (0..n).map(move |i| (first + i as i64).rem_euclid(cell[k] as i64) as usize)
    };
    let (row, column) = view.origin;
    let columns: Vec<usize> = lines(0, column).collect();
    let mean = |t: &[Complex32]| {
        let of_row = |y: usize| {
            let line = &t[y * stride..][..cell[0]];
            columns.iter().map(|x| line[*x]).sum::<Complex32>()
        };
        let sum: Complex64 = lines(1, row).map(of_row).map(wide).sum();
        sum / (columns.len() * lines(1, row).count()) as f64
    };
    let mut product = Complex64::ONE;
    let mut first = 0;
    let mut means = Vec::new();
    for last in &plan.record_after {
        for slice in &view.transmission.slices[first..=*last] {
            product *= slice.as_deref().map_or(Complex64::ONE, mean);
        }
        first = last + 1;
        means.push(single(product));
    }
    means
}

fn wide(c: Complex32) -> Complex64 {
    Complex64::new(f64::from(c.re), f64::from(c.im))
}
