//! Plain multislice of probes, on the full grid or in windows.

use super::Scan;
use super::basis::Basis;
use super::plan::Plan;
use super::probe::{Cropped, Probe};
use super::spare::Spare;
use super::stepper::{self, Leg, Specimen, Stepper};
use super::transmission::Transmission;
use super::windows::{Division, Patch, amplitude_nyquist};
use crate::detect::DetectorMap;
use crate::error::{Error, Result};
use crate::fft::{Buffer, frequency};
use crate::matrix::{gram, multiply};
use crate::progress::Progress;
use num_complex::Complex32;
use rayon::prelude::*;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;
use std::sync::Arc;

/// Propagates probes through given transmission functions.
pub(super) struct Multislice<'a> {
    plan: &'a Plan,
    stepper: Stepper,
    map: DetectorMap,
    probe: Probe,
    /// Columns that hold the probe's spectrum.
    probe_columns: Vec<Range<usize>>,
    /// The last basis, and the largest distance (x, y) of its probes from the middle of their window.
    basis: Option<([f64; 2], Arc<Basis>)>,
}

/// One thread's arrays.
pub(super) struct Workspace {
    waves: Vec<Buffer>,
    copy: Buffer,
    step: stepper::Workspace,
    /// Amplitudes of waves on each detector.
    amplitudes: Vec<Vec<Complex32>>,
}

/// Legs up to each recorded thickness.
type Route = Vec<Vec<Leg>>;

impl<'a> Multislice<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        let stepper = Stepper::new(plan);
        let grid = plan.wave_grid;
        let map = plan.detector_map(&grid, stepper.fft().stride(), plan.detector_ramp_mrad());
        let probe = Probe::new(plan);
        let nx = grid.points[0];
        let column = |b: &(usize, usize)| frequency(b.1, nx).unsigned_abs() as usize;
        let reach = probe.bins.iter().map(column).max().unwrap_or(0);
        let probe_columns = stepper.fft().band_columns(reach);
        Multislice { plan, stepper, map, probe, probe_columns, basis: None }
    }

    /// Intensities as (probe, recorded thickness, detector), row-major.
    pub fn run(
        &mut self,
        transmission: &Transmission,
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let (groups, basis) = self.groups(scan);
        let (routes, of_group) = self.routes(transmission, &groups);
        let this = &*self;
        let spare = Spare::new();
        let values = groups.par_iter().zip(of_group).map(|(group, route)| {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let specimen = Specimen { transmission, origin: group.origin };
            let values = spare.with(
                || this.workspace(),
                |w| match basis.as_deref().zip(this.probe.cropped()) {
                    Some(basis) => this.expanded(w, &routes[route], specimen, group, basis),
                    None => this.each(w, &routes[route], specimen, group),
                },
            );
            progress.advance(group.probes.len() as u64);
            Ok(values)
        });
        let values = values.collect::<Result<Vec<_>>>()?;
        let per_probe = self.plan.settings.detectors.len() * self.plan.record_after.len();
        let mut out = vec![0.0; scan.len() * per_probe];
        for (group, values) in groups.iter().zip(&values) {
            for ((i, _), values) in group.probes.iter().zip(values.chunks_exact(per_probe)) {
                out[i * per_probe..][..per_probe].copy_from_slice(values);
            }
        }
        Ok(out)
    }

    pub fn workspace(&self) -> Workspace {
        Workspace {
            waves: Vec::new(),
            copy: self.stepper.fft().buffer(),
            step: self.stepper.workspace(),
            amplitudes: vec![Vec::new(); self.plan.settings.detectors.len()],
        }
    }

    /// The patches of a scan, with the basis of their probes where they are expanded, and otherwise in parts that
    /// step together.
    fn groups(&mut self, scan: &Scan) -> (Vec<Patch>, Option<Arc<Basis>>) {
        let division = Division::new(self.plan, scan);
        if let Some(basis) = self.basis(&division) {
            return (division.patches, Some(basis));
        }
        let most = self.stepper.group();
        let split = |Patch { origin, probes }: Patch| {
            let even = probes.len().div_ceil(probes.len().div_ceil(most).max(1)).max(1);
            let part = move |part: &[_]| Patch { origin, probes: part.to_vec() };
            probes.chunks(even).map(part).collect::<Vec<_>>()
        };
        (division.patches.into_iter().flat_map(split).collect(), None)
    }

    /// The basis for the probes of a division, if they are expanded; scans of one shape share it.
    fn basis(&mut self, division: &Division) -> Option<Arc<Basis>> {
        let (error, probe) = (division.error?, self.probe.cropped()?);
        let half = division.half(self.plan);
        if let Some((_, basis)) = self.basis.as_ref().filter(|known| known.0 == half) {
            return Some(basis.clone());
        }
        let basis = Arc::new(Basis::new(probe, half, amplitude_nyquist(self.plan), error));
        self.basis = Some((half, basis.clone()));
        Some(basis)
    }

    /// Intensities of probes, each propagated: (probe, recorded thickness, detector).
    fn each(
        &self,
        w: &mut Workspace,
        route: &Route,
        specimen: Specimen<'_>,
        group: &Patch,
    ) -> Vec<f64> {
        let detectors = self.plan.settings.detectors.len();
        let per_probe = detectors * route.len();
        let mut values = vec![0.0; group.probes.len() * per_probe];
        self.through(w, route, specimen, &group.probes, |probe, r, psi, scale| {
            let at = probe * per_probe + r * detectors;
            self.map.collect(psi, scale, &mut values[at..at + detectors]);
        });
        values
    }

    /// The same from the waves of a basis.
    fn expanded(
        &self,
        Workspace { waves, copy, step, amplitudes }: &mut Workspace,
        route: &Route,
        specimen: Specimen<'_>,
        group: &Patch,
        (basis, probe): (&Basis, &Cropped),
    ) -> Vec<f64> {
        let (n, probes, detectors) =
            (basis.len(), group.probes.len(), self.plan.settings.detectors.len());
        let per_probe = detectors * route.len();
        let coefficients = basis.coefficients(probe, &group.probes);
        let waves = self.at_least(waves, n);
        for (j, wave) in waves.iter_mut().enumerate() {
            self.begin(wave, basis.wave(j).iter().copied(), step);
        }
        let mut values = vec![0.0; probes * per_probe];
        let mut matrix = vec![Complex32::ZERO; n * n];
        let mut product = vec![Complex32::ZERO; n * probes];
        let scale = self.scale();
        for (r, legs) in route.iter().enumerate() {
            amplitudes.iter_mut().for_each(Vec::clear);
            for waves in waves.chunks_mut(self.stepper.group()) {
                for leg in legs {
                    self.stepper.travel(waves, *leg, specimen, step);
                }
                for wave in waves {
                    copy.copy_from_slice(wave);
                    self.stepper.columns(copy, false, &mut step.fft);
                    self.map.gather(copy, |d, psi| amplitudes[d].extend_from_slice(psi));
                }
            }
            for (d, amplitudes) in amplitudes.iter().enumerate() {
                gram(n, amplitudes, &mut matrix);
                let shape = (n, probes, n);
                multiply(shape, (&mut product, probes), (&matrix, [n, 1]), (&coefficients, probes));
                for (c, y) in coefficients.chunks_exact(probes).zip(product.chunks_exact(probes)) {
                    for (probe, (c, y)) in c.iter().zip(y).enumerate() {
                        values[probe * per_probe + r * detectors + d] +=
                            f64::from((c.conj() * y).re) * scale;
                    }
                }
            }
        }
        values
    }

    /// The first `n` of a thread's waves.
    fn at_least<'w>(&self, waves: &'w mut Vec<Buffer>, n: usize) -> &'w mut [Buffer] {
        if waves.len() < n {
            waves.resize_with(n, || self.stepper.fft().buffer());
        }
        &mut waves[..n]
    }

    /// What squared moduli of Fourier coefficients are multiplied by to be fractions of the beam.
    fn scale(&self) -> f64 {
        let (ny, nx) = self.stepper.fft().shape();
        1.0 / ((nx * ny) as f64).powi(2)
    }

    /// Puts a probe at `position` (Angstrom, within the wave) into a wave.
    fn start(&self, wave: &mut [Complex32], position: [f64; 2], w: &mut stepper::Workspace) {
        self.begin(wave, self.probe.at(self.plan, position).into_iter(), w);
    }

    /// Puts a wave with these coefficients, in the order of the probe's bins, into the form that steps need.
    fn begin(
        &self,
        wave: &mut [Complex32],
        coefficients: impl Iterator<Item = Complex32>,
        w: &mut stepper::Workspace,
    ) {
        let stride = self.stepper.fft().stride();
        wave.fill(Complex32::ZERO);
        for (&(iy, ix), c) in self.probe.bins.iter().zip(coefficients) {
            wave[iy * stride + ix] = c;
        }
        self.stepper.start(wave, &self.probe_columns, &mut w.fft);
    }

    /// The distinct routes of groups of probes, and which of them each group takes.
    fn routes(&mut self, t: &Transmission, groups: &[Patch]) -> (Vec<Route>, Vec<usize>) {
        let within: Vec<Vec<usize>> =
            groups.par_iter().map(|g| t.occupancy.within(g.origin)).collect();
        let mut routes = Vec::new();
        let mut known = HashMap::new();
        let mut route_of = |slices: Vec<usize>| match known.entry(slices) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(new) => {
                routes.push(self.route(new.key()));
                *new.insert(routes.len() - 1)
            }
        };
        let of_group = within.into_iter().map(&mut route_of).collect();
        (routes, of_group)
    }

    /// The legs through some slices up to each recorded thickness.
    fn route(&mut self, slices: &[usize]) -> Route {
        let mut at = self.plan.slices.entrance();
        let mut rest = slices;
        let mut route = Vec::new();
        for last in &self.plan.record_after {
            let (passed, others) = rest.split_at(rest.partition_point(|slice| slice <= last));
            let (legs, end) = self.stepper.route(at, passed.iter().copied());
            route.push(legs);
            (at, rest) = (end, others);
        }
        route
    }

    /// Takes probes along the legs; `record(probe, r, psi, scale)` receives the Fourier coefficients at
    /// the r-th recorded thickness, whose squared moduli times `scale` are fractions of the beam.
    fn through(
        &self,
        Workspace { waves, copy, step, .. }: &mut Workspace,
        route: &Route,
        specimen: Specimen<'_>,
        probes: &[(usize, [f64; 2])],
        mut record: impl FnMut(usize, usize, &[Complex32], f64),
    ) {
        let waves = self.at_least(waves, probes.len());
        for (wave, (_, position)) in waves.iter_mut().zip(probes) {
            self.start(wave, *position, step);
        }
        for (r, legs) in route.iter().enumerate() {
            for leg in legs {
                self.stepper.travel(waves, *leg, specimen, step);
            }
            for (probe, wave) in waves.iter().enumerate() {
                copy.copy_from_slice(wave);
                self.stepper.columns(copy, false, &mut step.fft);
                record(probe, r, copy, self.scale());
            }
        }
    }

    /// Diffraction intensity of one probe per recorded thickness: fraction of the beam per pixel of
    /// the wave grid, FFT order, row-major without padding; zero beyond the band limit.
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
        let group = Division::new(self.plan, &scan).patches.remove(0);
        let slices = transmission.occupancy.within(group.origin);
        let route = self.route(&slices);
        let mut w = self.workspace();
        let specimen = Specimen { transmission, origin: group.origin };
        self.through(&mut w, &route, specimen, &group.probes, |_, r, psi, scale| {
            for iy in 0..ny {
                for ix in 0..nx {
                    let [kx, ky] = grid.k(iy, ix);
                    if kx.hypot(ky) < self.plan.band_limit {
                        let p = f64::from(psi[iy * row_stride + ix].norm_sqr());
                        out[r][iy * nx + ix] = (p * scale) as f32;
                    }
                }
            }
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::transmission::TransmissionBuilder;
    use super::super::{Algorithm, ProbeStep, Settings, Site};
    use super::*;
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
                sites.push(Site { position, number: 78, sigma_angstrom: 0.0, key: n as u64 });
            }
        }
        sites
    }

    /// Slices without atoms in a window are passed in one step there; measured 0.0008 % of the maximum, and 0.05 % where
    /// what is near does not count.
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
        let run = |t: &Transmission| Multislice::new(&plan).run(t, &scan, &Silent).unwrap();
        let skipping = run(&transmission);
        let filled = transmission.filled(0..plan.slices.len()).count();
        let within = |x: f64| {
            let pixel = plan.transmission_grid.sampling_angstrom();
            let [column, row] = [x / pixel[0], 10.0 / pixel[1]].map(|v| v as usize);
            transmission.occupancy.within((row, column)).len()
        };
        // in the middle of the crystal, over the edge of the cell, and far from it
        assert!(within(2.0) > filled / 2 && within(2.0) < filled, "{} {filled}", within(2.0));
        assert!(within(26.0) > filled / 2, "{} {filled}", within(26.0));
        assert_eq!(within(15.5), 0);
        transmission.occupancy.spread();
        let all = run(&transmission);
        let most = all.iter().copied().fold(0.0, f64::max);
        let off = skipping.iter().zip(&all).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 5e-5 * most, "{off} of {most}");
    }
}
