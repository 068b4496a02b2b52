//! Plain multislice of probes, on the full grid or in windows.

mod lent_waves;
mod patch_waves;

use super::basis::Basis;
use super::bright_detectors::{BrightDetectors, BrightWorkspace, TailThere, window_map};
use super::coherent_tail::mean_transmissions;
use super::plan::Plan;
use super::probe::{CroppedProbe, Probe};
use super::probe_patches::{Patch, ProbePatches, amplitude_nyquist, waves_of_patch};
use super::probe_scan::{ProbePlaces, Scan};
use super::slice_coverage::LocalSlice;
use super::stepper::{SliceStep, StepWorkspace, Stepper, TransmissionView};
use super::transmission::Transmission;
use super::workspace_pool::WorkspacePool;
use crate::detect::DetectorMap;
use crate::error::{Error, Result};
use crate::fft::{Buffer, frequency};
use crate::matrix::{gram, multiply};
use crate::progress::Progress;
use ndarray::Array4;
use num_complex::Complex32;
use rayon::prelude::*;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;
use std::sync::Arc;

use patch_waves::{Coefficients, PatchProbes, PatchWaves, WavesIn};

/// Propagates probes through given transmission functions.
pub(super) struct Multislice<'a> {
    plan: &'a Plan,
    stepper: Stepper,
    map: DetectorMap,
    /// The detectors that read the coherent tail; `None` without windows, and where waves are only lent.
    bright: Option<BrightDetectors<'a>>,
    /// The probe at each focus, with its weight. Without focal spread there is one.
    probes: Vec<(f64, Probe)>,
    /// Columns that contain the spectrum of the probe.
    probe_columns: Vec<Range<usize>>,
    /// The last waves of patches, with the largest distance (x, y) in Angstrom of their probes from the middle of their window.
    waves: Option<([f64; 2], Arc<PatchWaves>)>,
}

/// One thread's arrays.
pub(super) struct MultisliceWorkspace {
    waves: Vec<Buffer>,
    copy: Buffer,
    step: StepWorkspace,
    /// Amplitudes of the waves on each detector.
    amplitudes: Vec<Vec<Complex32>>,
    /// Transmission functions of the next steps.
    transmissions: Vec<Buffer>,
    bright: Option<BrightWorkspace>,
}

/// Number of steps that all waves of a patch pass before the next ones. The steps' transmission functions are then arranged once for all
/// waves, and stay in a cache.
const STEPS_TOGETHER: usize = 16;

/// The path to a recorded thickness from the one before it.
pub(super) struct PathPart {
    pub steps: Vec<SliceStep>,
    /// Height of the waves after the last step, in Angstrom.
    pub height_angstrom: f64,
    /// Pixels (x, y) by which windows have moved there.
    pub moved: [i64; 2],
}

/// The path through the specimen, with a part for each recorded thickness.
type SlicePath = Vec<PathPart>;

impl<'a> Multislice<'a> {
    /// Waves and detectors of a plan.
    pub fn new(plan: &'a Plan) -> Self {
        let mut this = Self::lending(plan);
        let stride = this.stepper.fft().stride();
        this.map = window_map(plan, stride);
        this.bright = BrightDetectors::new(plan, &this.probes[0].1.bins, stride);
        this
    }

    /// The share of the beam on detectors that read the coherent tail, without a specimen; `None` if there are no such detectors.
    pub fn seen_without_specimen(&self) -> Option<Vec<f64>> {
        let bright = self.bright.as_ref()?;
        Some(bright.without_specimen(&self.probes[0].1.bins, self.stride()))
    }

    /// The waves of a plan alone, for those who read them.
    pub fn lending(plan: &'a Plan) -> Self {
        let stepper = Stepper::new(plan);
        let grid = plan.wave_grid;
        let probes: Vec<(f64, Probe)> =
            plan.at_foci().iter().map(|(weight, at)| (*weight, Probe::new(at))).collect();
        let nx = grid.points[0];
        let column = |b: &(usize, usize)| frequency(b.1, nx).unsigned_abs() as usize;
        // Aberrations do not change the probe's bins.
        let reach = probes[0].1.bins.iter().map(column).max().unwrap_or(0);
        let probe_columns = stepper.fft().band_columns(reach);
        let (map, bright, waves) = (DetectorMap::default(), None, None);
        Multislice { plan, stepper, map, bright, probes, probe_columns, waves }
    }

    /// Intensities as fractions of the beam: (probe, recorded thickness, detector), row-major.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn run(
        &mut self,
        transmission: &Transmission,
        places: ProbePlaces<'_>,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let groups = self.groups(places);
        self.run_groups(transmission, places.len(), groups, false, progress)
    }

    /// Computes the bytes of [`Multislice::run`] for the wanted probes only. Some of the others are zero.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn run_some(
        &mut self,
        transmission: &Transmission,
        places: ProbePlaces<'_>,
        wanted: &[bool],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let (mut groups, waves) = self.groups(places);
        if waves.is_none() {
            // Waves of a group do not depend on each other, so unwanted ones are left out.
            groups.iter_mut().for_each(|g| g.probes.retain(|(i, _)| wanted[*i]));
        }
        groups.retain(|g| g.probes.iter().any(|(i, _)| wanted[*i]));
        self.run_groups(transmission, places.len(), (groups, waves), false, progress)
    }

    /// Computes what [`Multislice::run`] computes for the wanted probes, up to rounding. The others are zero. Where a patch has few wanted
    /// probes, each is propagated as the sum of waves that its expansion is, in place of all waves. Few probes for detectors that read the
    /// coherent tail are propagated as they are, since the choice of their waves takes seconds.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub fn run_few(
        &mut self,
        transmission: &Transmission,
        places: ProbePlaces<'_>,
        wanted: &[bool],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let few = wanted.iter().filter(|w| **w).count() * self.probes.len();
        let (mut groups, waves) = match self.bright.is_some() && few < waves_of_patch(self.plan) {
            true => (self.together(ProbePatches::new(self.plan, places)), None),
            false => self.groups(places),
        };
        groups.iter_mut().for_each(|g| g.probes.retain(|(i, _)| wanted[*i]));
        groups.retain(|g| !g.probes.is_empty());
        self.run_groups(transmission, places.len(), (groups, waves), true, progress)
    }

    /// With `one_by_one`, the probes of a patch are propagated as sums of its waves where they are fewer than the waves.
    fn run_groups(
        &mut self,
        transmission: &Transmission,
        probes: usize,
        (groups, waves): (Vec<Patch>, Option<Arc<PatchWaves>>),
        one_by_one: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let (paths, path_of) = self.paths(transmission, &groups);
        let this = &*self;
        let waves = waves.as_deref();
        let foci = this.probes.len();
        let all_waves = |group: &Patch| {
            waves.filter(|waves| !one_by_one || group.probes.len() * foci >= waves.len())
        };
        let workspaces = WorkspacePool::new();
        let values = groups.par_iter().zip(path_of).map(|(group, path)| {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let view = TransmissionView { transmission, origin: group.origin };
            let values = workspaces.with(
                || this.workspace(),
                |w| match all_waves(group) {
                    Some(waves) => this.expanded(w, &paths[path], view, group, waves),
                    None => this.each_probe(w, &paths[path], view, (group, waves)),
                },
            );
            progress.advance(group.probes.len() as u64);
            Ok(values)
        });
        let values = values.collect::<Result<Vec<_>>>()?;
        let per_probe = self.plan.settings.detectors.len() * self.plan.record_after.len();
        let mut out = vec![0.0; probes * per_probe];
        for (group, values) in groups.iter().zip(&values) {
            for ((i, _), values) in group.probes.iter().zip(values.chunks_exact(per_probe)) {
                out[i * per_probe..][..per_probe].copy_from_slice(values);
            }
        }
        Ok(out)
    }

    pub fn workspace(&self) -> MultisliceWorkspace {
        MultisliceWorkspace {
            waves: Vec::new(),
            copy: self.stepper.fft().buffer(),
            step: self.stepper.workspace(),
            amplitudes: vec![Vec::new(); self.plan.settings.detectors.len()],
            transmissions: Vec::new(),
            bright: self.bright.as_ref().map(BrightDetectors::workspace),
        }
    }

    /// The patches of probes. If probes are expanded, patches are whole, with the waves of their probes. Otherwise they are divided into
    /// parts whose waves step together.
    fn groups(&mut self, places: ProbePlaces<'_>) -> (Vec<Patch>, Option<Arc<PatchWaves>>) {
        let patches = ProbePatches::new(self.plan, places);
        match self.patch_waves(&patches) {
            Some(waves) => (patches.patches, Some(waves)),
            None => (self.together(patches), None),
        }
    }

    /// Divides patches into parts whose probes step together.
    fn together(&self, patches: ProbePatches) -> Vec<Patch> {
        let most = self.stepper.waves_together();
        patches.patches.into_iter().flat_map(|patch| patch.split(most)).collect()
    }

    /// The waves for the probes of these patches, if they are expanded. Scans of equal shape share them.
    fn patch_waves(&mut self, patches: &ProbePatches) -> Option<Arc<PatchWaves>> {
        let error = patches.error?;
        let probes: Vec<&CroppedProbe> =
            self.probes.iter().map(|(_, probe)| probe.cropped()).collect::<Option<_>>()?;
        let half = patches.half(self.plan);
        if let Some((_, waves)) = self.waves.as_ref().filter(|known| known.0 == half) {
            return Some(waves.clone());
        }
        let waves = Arc::new(PatchWaves::new(match &self.bright {
            Some(bright) => WavesIn::Box(bright.tail.shared(bright.padded(), half, error)),
            None => {
                let nyquist = amplitude_nyquist(self.plan);
                WavesIn::Window(Basis::new(&probes, half, nyquist, error))
            }
        }));
        self.waves = Some((half, waves.clone()));
        Some(waves)
    }

    /// The coefficients of probes on the waves of their patch.
    fn coefficients(&self, waves: &PatchWaves, probes: &PatchProbes) -> Arc<Coefficients> {
        waves.coefficients(probes, self.probes.len(), |made_in| match (made_in, &self.bright) {
            (WavesIn::Box(shared), Some(bright)) => bright.tail.coefficients(shared, probes),
            (WavesIn::Window(basis), _) => {
                let at_foci = self
                    .probes
                    .iter()
                    .filter_map(|(weight, probe)| Some((*weight, probe.cropped()?)));
                at_foci.map(|(weight, probe)| (weight, basis.coefficients(probe, probes))).collect()
            }
            (WavesIn::Box(_), None) => Vec::new(),
        })
    }

    /// The tail at each recorded thickness on the path of a group, for detectors that read it.
    fn tails_there(&self, path: &[PathPart], view: TransmissionView<'_>) -> Vec<TailThere> {
        let Some(bright) = &self.bright else { return Vec::new() };
        let means = mean_transmissions(self.plan, view);
        path.iter().zip(means).map(|(part, mean)| bright.tail_at(part, mean)).collect()
    }

    /// Intensities of a group's probes, each propagated as a wave: (probe, recorded thickness, detector). With `waves`, each probe is what
    /// its expansion in them gives.
    fn each_probe(
        &self,
        w: &mut MultisliceWorkspace,
        path: &[PathPart],
        view: TransmissionView<'_>,
        (group, waves): (&Patch, Option<&PatchWaves>),
    ) -> Vec<f64> {
        let detectors = self.plan.settings.detectors.len();
        let per_probe = detectors * path.len();
        let mut values = vec![0.0; group.probes.len() * per_probe];
        let mut one = vec![0.0; detectors];
        let there = self.tails_there(path, view);
        let summed = waves.map(|waves| (waves, self.coefficients(waves, &group.probes)));
        for focus in 0..self.probes.len() {
            let (inside, outside) = match &summed {
                Some((waves, coefficients)) => {
                    waves.sums(&coefficients[focus].1, group.probes.len())
                }
                None => self.starts(w, (&group.probes, focus)),
            };
            let mut bright_w = w.bright.take();
            self.propagate(w, path, view, (&inside, focus), |probe, r, psi, scale| {
                let at = probe * per_probe + r * detectors;
                let values = &mut values[at..at + detectors];
                self.map.collect(psi, scale, &mut one);
                values.iter_mut().zip(&one).for_each(|(v, o)| *v += o);
                if let (Some(bright), Some(w)) = (&self.bright, &mut bright_w) {
                    let weight = self.probes[focus].0;
                    let tail = (outside[probe].as_slice(), &there[r]);
                    bright.add(psi, tail, (w, &mut one), (weight, values));
                }
            });
            w.bright = bright_w;
        }
        values
    }

    /// The coefficients of probes on the window's bins, and, for detectors that read the tail, the tail of each.
    fn starts(
        &self,
        w: &mut MultisliceWorkspace,
        (probes, focus): (&[(usize, [f64; 2])], usize),
    ) -> (Vec<Vec<Complex32>>, Vec<Vec<Complex32>>) {
        let places = probes.iter().map(|(_, position)| (*position, focus));
        match (&self.bright, &mut w.bright) {
            (Some(bright), Some(w)) => {
                places.map(|at| bright.tail.probe(bright.padded(), at, &mut w.split)).unzip()
            }
            _ => (places.map(|(at, _)| self.probes[focus].1.at(self.plan, at)).collect(), vec![]),
        }
    }

    /// Intensities of a group's probes from the waves of its patch; only these waves are propagated.
    fn expanded(
        &self,
        w: &mut MultisliceWorkspace,
        path: &[PathPart],
        view: TransmissionView<'_>,
        group: &Patch,
        patch_waves: &PatchWaves,
    ) -> Vec<f64> {
        let MultisliceWorkspace { waves, copy, step, amplitudes, transmissions, bright: w } = w;
        let (probes, detectors) = (group.probes.len(), self.plan.settings.detectors.len());
        let per_probe = detectors * path.len();
        let coefficients = self.coefficients(patch_waves, &group.probes);
        let waves = self.at_least(waves, patch_waves.len());
        for (j, wave) in waves.iter_mut().enumerate() {
            self.begin(wave, patch_waves.inside(j).iter().copied(), step);
        }
        let there = self.tails_there(path, view);
        let mut values = vec![0.0; probes * per_probe];
        let scale = self.scale();
        for (r, part) in path.iter().enumerate() {
            amplitudes.iter_mut().for_each(Vec::clear);
            self.step_waves(waves, &part.steps, view, (transmissions, step));
            for (j, wave) in waves.iter().enumerate() {
                copy.copy_from_slice(wave);
                self.stepper.transform_columns(copy, false, &mut step.fft);
                self.map.gather(copy, |d, psi| amplitudes[d].extend_from_slice(psi));
                if let (Some(bright), Some(w), Some(outside)) =
                    (&self.bright, &mut *w, patch_waves.outside(j))
                {
                    let tail = (outside, &there[r]);
                    bright.gather(copy, tail, w, |d, psi| amplitudes[d].extend_from_slice(psi));
                }
            }
            for (d, amplitudes) in amplitudes.iter().enumerate() {
                let matrix = detected(amplitudes, patch_waves.len());
                for (weight, coefficients) in &*coefficients {
                    let sums = intensities(&matrix, coefficients, probes, weight * scale);
                    for (probe, intensity) in sums.into_iter().enumerate() {
                        values[probe * per_probe + r * detectors + d] += intensity;
                    }
                }
            }
        }
        values
    }

    /// Passes all waves through some steps. The steps' transmission functions are arranged once for all waves.
    fn step_waves(
        &self,
        waves: &mut [Buffer],
        steps: &[SliceStep],
        view: TransmissionView<'_>,
        (transmissions, w): (&mut Vec<Buffer>, &mut StepWorkspace),
    ) {
        for steps in steps.chunks(STEPS_TOGETHER) {
            self.stepper.arrange(steps, view, transmissions, w);
            for waves in waves.chunks_mut(self.stepper.waves_together()) {
                for (slice_step, t) in steps.iter().zip(&*transmissions) {
                    self.stepper.propagate_through(waves, *slice_step, t, w);
                }
            }
        }
    }

    /// The first `n` of a thread's waves.
    fn at_least<'w>(&self, waves: &'w mut Vec<Buffer>, n: usize) -> &'w mut [Buffer] {
        if waves.len() < n {
            waves.resize_with(n, || self.stepper.fft().buffer());
        }
        &mut waves[..n]
    }

    /// The factor from squared moduli of Fourier coefficients to fractions of the beam.
    fn scale(&self) -> f64 {
        let (ny, nx) = self.stepper.fft().shape();
        1.0 / ((nx * ny) as f64).powi(2)
    }

    /// Sets a wave to these coefficients, in the order of the probe's bins, in the form that steps need.
    fn begin(
        &self,
        wave: &mut [Complex32],
        coefficients: impl Iterator<Item = Complex32>,
        w: &mut StepWorkspace,
    ) {
        let stride = self.stepper.fft().stride();
        wave.fill(Complex32::ZERO);
        for (&(iy, ix), c) in self.probes[0].1.bins.iter().zip(coefficients) {
            wave[iy * stride + ix] = c;
        }
        self.stepper.start(wave, &self.probe_columns, &mut w.fft);
    }

    /// The distinct paths of groups of probes, and the index of each group's path.
    pub(super) fn paths(
        &mut self,
        t: &Transmission,
        groups: &[Patch],
    ) -> (Vec<SlicePath>, Vec<usize>) {
        let within: Vec<Vec<LocalSlice>> =
            groups.par_iter().map(|g| t.coverage.within(g.origin)).collect();
        let mut paths = Vec::new();
        let mut known = HashMap::new();
        let mut path_of = Vec::with_capacity(groups.len());
        for slices in within {
            let key: Vec<_> = slices.iter().map(LocalSlice::key).collect();
            path_of.push(match known.entry(key) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(new) => {
                    paths.push(self.path(&slices));
                    *new.insert(paths.len() - 1)
                }
            });
        }
        (paths, path_of)
    }

    /// The steps through these slices up to each recorded thickness.
    fn path(&mut self, slices: &[LocalSlice]) -> SlicePath {
        let mut at = (self.plan.slices.entrance(), [0; 2]);
        let mut rest = slices;
        let mut path = Vec::new();
        for last in &self.plan.record_after {
            let (passed, others) = rest.split_at(rest.partition_point(|step| step.last <= *last));
            let (steps, end) = self.stepper.path(at, passed.iter().copied());
            path.push(PathPart { steps, height_angstrom: end.0, moved: end.1 });
            (at, rest) = (end, others);
        }
        path
    }

    /// Propagates probes of a focus, given by their coefficients, along a path; `record(probe, r, psi, scale)` receives the Fourier
    /// coefficients at the r-th recorded thickness, whose squared moduli times `scale` are fractions of the beam, weighted by the focus.
    fn propagate(
        &self,
        MultisliceWorkspace { waves, copy, step, .. }: &mut MultisliceWorkspace,
        path: &[PathPart],
        view: TransmissionView<'_>,
        (probes, focus): (&[Vec<Complex32>], usize),
        mut record: impl FnMut(usize, usize, &[Complex32], f64),
    ) {
        let waves = self.at_least(waves, probes.len());
        for (wave, coefficients) in waves.iter_mut().zip(probes) {
            self.begin(wave, coefficients.iter().copied(), step);
        }
        for (r, part) in path.iter().enumerate() {
            for slice_step in &part.steps {
                self.stepper.propagate(waves, *slice_step, view, step);
            }
            for (probe, wave) in waves.iter().enumerate() {
                copy.copy_from_slice(wave);
                self.stepper.transform_columns(copy, false, &mut step.fft);
                record(probe, r, copy, self.probes[focus].0 * self.scale());
            }
        }
    }

    /// Diffraction patterns of one probe, one for each recorded thickness: fractions of the beam per pixel of the wave
    /// grid, rows = ky, columns = kx in FFT order, without padding; zero beyond the band limit.
    pub fn diffraction(
        &mut self,
        transmission: &Transmission,
        position: [f64; 2],
    ) -> Vec<Vec<f32>> {
        let grid = self.plan.wave_grid;
        let (ny, nx) = grid.shape();
        let row_stride = self.stepper.fft().stride();
        let mut out = vec![vec![0.0; nx * ny]; self.plan.record_after.len()];
        let scan = Scan { origin_angstrom: position, step_angstrom: [0.0; 2], shape: [1, 1] };
        let group = ProbePatches::new(self.plan, &scan).patches.remove(0);
        let slices = transmission.coverage.within(group.origin);
        let path = self.path(&slices);
        let mut w = self.workspace();
        let view = TransmissionView { transmission, origin: group.origin };
        for focus in 0..self.probes.len() {
            let inside = vec![self.probe(focus, group.probes[0].1)];
            self.propagate(&mut w, &path, view, (&inside, focus), |_, r, psi, scale| {
                for iy in 0..ny {
                    for ix in 0..nx {
                        let [kx, ky] = grid.k(iy, ix);
                        if kx.hypot(ky) < self.plan.band_limit {
                            let p = f64::from(psi[iy * row_stride + ix].norm_sqr());
                            out[r][iy * nx + ix] += (p * scale) as f32;
                        }
                    }
                }
            });
        }
        out
    }
}

impl Multislice<'_> {
    /// The waves of probes at these places (x, y) in Angstrom at each recorded thickness, (place, thickness, y, x), on the grid of a plan
    /// without windows. The squared moduli of a wave add to the fraction of the beam.
    pub fn exit_waves(
        &mut self,
        transmission: &Transmission,
        places: &[[f64; 2]],
        progress: &dyn Progress,
    ) -> Result<Array4<Complex32>> {
        let plan = self.plan;
        let (ny, nx) = self.stepper.fft().shape();
        let slices = transmission.coverage.within((0, 0));
        let path = self.path(&slices);
        let ends = plan.record_after.iter().map(|last| plan.slices.boundaries[last + 1]);
        let to_end: Vec<_> = ends
            .zip(&path)
            .map(|(end, part)| {
                self.stepper.propagator(end - part.height_angstrom, part.moved.map(|p| -p))
            })
            .collect();
        let view = TransmissionView { transmission, origin: (0, 0) };
        let this = &*self;
        let scale = ((nx * ny) as f32).sqrt().recip();
        let workspaces = WorkspacePool::new();
        let of_place = |place: &[f64; 2]| {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let made = workspaces.with(
                || this.workspace(),
                |MultisliceWorkspace { waves, step, .. }| {
                    let waves = this.at_least(waves, 1);
                    this.begin(&mut waves[0], this.probe(0, *place).into_iter(), step);
                    let mut made = Vec::with_capacity(path.len() * nx * ny);
                    for (part, to_end) in path.iter().zip(&to_end) {
                        for slice_step in &part.steps {
                            this.stepper.propagate(waves, *slice_step, view, step);
                        }
                        let wave = this.stepper.leaving(&waves[0], to_end, &mut step.fft);
                        let rows = wave.chunks_exact(this.stride()).take(ny);
                        made.extend(rows.flat_map(|row| row[..nx].iter().map(|v| v * scale)));
                    }
                    made
                },
            );
            progress.advance(1);
            Ok(made)
        };
        let waves = places.par_iter().map(of_place).collect::<Result<Vec<_>>>()?;
        let shape = (places.len(), path.len(), ny, nx);
        Ok(Array4::from_shape_vec(shape, waves.concat()).unwrap_or_default())
    }
}

/// The matrix `M_ij` of `engine::basis` for `n` waves on a detector, from their amplitudes there, (wave, pixel) row-major.
fn detected(amplitudes: &[Complex32], n: usize) -> Vec<Complex32> {
    let mut matrix = vec![Complex32::ZERO; n * n];
    gram(n, amplitudes, &mut matrix);
    matrix
}

/// Intensities of probes on a detector, from the detector's matrix ([`detected`]) for the waves of a basis, and the probes' coefficients on
/// these waves, (wave, probe) row-major. `scale` turns squared moduli into fractions of the beam.
fn intensities(
    matrix: &[Complex32],
    coefficients: &[Complex32],
    probes: usize,
    scale: f64,
) -> Vec<f64> {
    let n = coefficients.len() / probes;
    let mut product = vec![Complex32::ZERO; n * probes];
    multiply((n, probes, n), (&mut product, probes), (matrix, [n, 1]), (coefficients, probes));
    let mut sums = vec![0.0; probes];
    for (c, y) in coefficients.chunks_exact(probes).zip(product.chunks_exact(probes)) {
        for (sum, (c, y)) in sums.iter_mut().zip(c.iter().zip(y)) {
            *sum += f64::from((c.conj() * y).re) * scale;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::super::transmission::TransmissionBuilder;
    use super::super::{Algorithm, ProbeStep, Settings, Site};
    use super::*;
    use crate::potential::slices::Slicing;
    use crate::progress::Silent;

    /// A tilted Pt crystal that reaches over an edge of the cell and leaves half of it empty.
    fn tilted_crystal(cell: f64) -> Vec<Site> {
        let a = 3.92;
        let mut sites = Vec::new();
        for n in 0..4 * 6 * 6 * 6 {
            let (i, j, k, b) = (n / 4 % 6, n / 24 % 6, n / 144, n % 4);
            let basis = [[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]][b];
            let [x, y, z] = [0, 1, 2].map(|d| a * ([i, j, k][d] as f64 - 3.0 + basis[d]));
            let turned = |u: f64, v: f64, by: f64| {
                (by.cos() * u - by.sin() * v, by.sin() * u + by.cos() * v)
            };
            let (y, z) = turned(y, z, 0.31);
            let (x, z) = turned(x, z, 0.47);
            if x * x + y * y + z * z < 81.0 {
                let position = [(x + 3.0).rem_euclid(cell), y + 10.0, z + 10.0];
                sites.push(Site {
                    position,
                    number: 78,
                    sigma_angstrom: 0.0,
                    anisotropy: None,
                    key: n as u64,
                });
            }
        }
        sites
    }

    /// Slices without atoms in a window are passed in one step there. Measured error: 0.0008 % of the maximum, and 0.05 % if atoms just
    /// outside the window are not counted.
    #[test]
    fn windows_skip_slices_without_atoms() {
        let settings = Settings {
            algorithm: Algorithm::Window { width_angstrom: 5.9 },
            probe_step: ProbeStep::Scan,
            thicknesses_angstrom: vec![8.0, 20.0],
            ..Settings::default()
        };
        let cell = 28.0;
        let sites = tilted_crystal(cell);
        let heights: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
        let plan = Plan::new(&settings, [cell, cell, 20.0], &heights).unwrap();
        let builder = TransmissionBuilder::new(&plan, &[78]).unwrap();
        let mut transmission = builder.build(&sites, 0, &Silent).unwrap();
        let scan = Scan { origin_angstrom: [0.3, 10.1], step_angstrom: [1.1, 0.6], shape: [2, 25] };
        let run =
            |t: &Transmission| Multislice::new(&plan).run(t, (&scan).into(), &Silent).unwrap();
        let skipping = run(&transmission);
        let filled = transmission.filled(0..plan.slices.len()).count();
        let within = |x: f64| {
            let pixel = plan.transmission_grid.sampling_angstrom();
            let [column, row] = [x / pixel[0], 10.0 / pixel[1]].map(|v| v as usize);
            transmission.coverage.within((row, column)).len()
        };
        // in the middle of the crystal, over the edge of the cell, and far from it
        assert!(within(2.0) > filled / 2 && within(2.0) < filled, "{} {filled}", within(2.0));
        assert!(within(26.0) > filled / 2, "{} {filled}", within(26.0));
        assert_eq!(within(15.5), 0);
        transmission.coverage.spread();
        let all = run(&transmission);
        let most = all.iter().copied().fold(0.0, f64::max);
        let off = skipping.iter().zip(&all).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 5e-5 * most, "{off} of {most}");
    }

    /// Slices act at the height of their atoms in a window, and join there, also where an image is recorded on the way. Measured: probes
    /// are 0.07 % off rms, and 0.13 % with slices at one height.
    #[test]
    fn local_slices_are_nearer_to_thin_ones_than_slices_at_one_height() {
        let cell = 28.0;
        let sites = tilted_crystal(cell);
        let heights: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
        let scan = Scan { origin_angstrom: [1.2, 5.1], step_angstrom: [0.5, 0.6], shape: [6, 6] };
        let run = |slicing: Slicing| {
            let settings = Settings {
                algorithm: Algorithm::Window { width_angstrom: 5.9 },
                probe_step: ProbeStep::Scan,
                thicknesses_angstrom: vec![10.0, 20.0],
                slicing,
                ..Settings::default()
            };
            let plan = Plan::new(&settings, [cell, cell, 20.0], &heights).unwrap();
            let builder = TransmissionBuilder::new(&plan, &[78]).unwrap();
            let transmission = builder.build(&sites, 0, &Silent).unwrap();
            let mut engine = Multislice::new(&plan);
            let steps = transmission.coverage.within((0, 0)).len();
            (engine.run(&transmission, (&scan).into(), &Silent).unwrap(), steps)
        };
        let (exact, thin) = run(Slicing::Grouped(0.02));
        let off = |values: &[f64]| {
            let relative = values.iter().zip(&exact).map(|(v, e)| (v / e - 1.0).powi(2));
            (relative.sum::<f64>() / exact.len() as f64).sqrt()
        };
        let (one_height, _) = run(Slicing::Grouped(0.35));
        let (local, few) = run(Slicing::Local(0.35));
        let (one_height, local) = (off(&one_height), off(&local));
        assert!(local < 0.002 && local < 0.6 * one_height, "{local} {one_height}");
        assert!(3 * few < 2 * thin, "{few} {thin}");
    }
}
