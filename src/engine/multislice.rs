//! Plain multislice of probes, on the full grid or in windows.

use super::Scan;
use super::plan::{Grid, Plan};
use super::prism::single;
use super::settings::Algorithm;
use super::spare::Spare;
use super::stepper::{self, Leg, Specimen, Stepper};
use super::transmission::Transmission;
use crate::detect::DetectorMap;
use crate::error::{Error, Result};
use crate::fft::{Buffer, Fft2, Scratch, frequency};
use crate::progress::Progress;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::PI;
use std::ops::Range;

/// Propagates probes through given transmission functions.
pub(super) struct Multislice<'a> {
    plan: &'a Plan,
    stepper: Stepper,
    map: DetectorMap,
    probe: Spectrum,
    /// Columns that hold the probe's spectrum.
    probe_columns: Vec<Range<usize>>,
}

/// The probe in Fourier space, for a position at `centre`.
struct Spectrum {
    /// (iy, ix, amplitude); squared amplitudes sum to the fraction of the beam inside the grid.
    entries: Vec<(usize, usize, Complex64)>,
    centre: [f64; 2],
}

/// One thread's arrays.
pub(super) struct Workspace {
    waves: Vec<Buffer>,
    copy: Buffer,
    step: stepper::Workspace,
}

/// Legs up to each recorded thickness.
type Route = Vec<Vec<Leg>>;

/// Probes that are propagated together, on the same part of the specimen.
#[derive(Debug, PartialEq)]
struct Group {
    /// Pixel (row, column) of the transmission grid under the waves' first pixel.
    origin: (usize, usize),
    /// Index in the scan, and position within the wave in Angstrom.
    probes: Vec<(usize, [f64; 2])>,
}

/// Windows begin at multiples of about this, so that neighbouring probes share one and what is read of the specimen
/// serves them all: four probes along each axis. 0.9 A takes 20 % less time than 0.4 A, and 1.2 A 8 % less than
/// that. Errors hardly change (SrTiO3, 39 A, rms / mean: 7.8 A windows 0.70 % with steps of 0.4 A, 0.72 % with 0.6, 0.9
/// and 1.2 A; 5.9 A 0.96, 0.71, 0.76 and 0.80 %).
const WINDOW_STEP_ANGSTROM: f64 = 1.2;

impl<'a> Multislice<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        let stepper = Stepper::new(plan);
        let grid = plan.wave_grid;
        let map = plan.detector_map(&grid, stepper.fft().stride(), plan.detector_ramp_mrad());
        let cropped = plan.settings.large_probe_box()
            || matches!(plan.settings.algorithm, Algorithm::Window { .. });
        let probe = if cropped { Spectrum::windowed(plan) } else { Spectrum::full(plan, &grid) };
        let nx = grid.points[0];
        let column = |e: &(usize, usize, Complex64)| frequency(e.1, nx).unsigned_abs() as usize;
        let reach = probe.entries.iter().map(column).max().unwrap_or(0);
        let probe_columns = stepper.fft().band_columns(reach);
        Multislice { plan, stepper, map, probe, probe_columns }
    }

    /// Intensities as (probe, recorded thickness, detector), row-major.
    pub fn run(
        &mut self,
        transmission: &Transmission,
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let detectors = self.plan.settings.detectors.len();
        let per_probe = detectors * self.plan.record_after.len();
        let groups = self.groups((0..scan.len()).map(|i| scan.position(i)));
        let (routes, of_group) = self.routes(transmission, &groups);
        let this = &*self;
        let spare = Spare::new();
        let values = groups.par_iter().zip(of_group).map(|(group, route)| {
            if progress.interrupted() {
                return Err(Error::Interrupted);
            }
            let mut values = vec![0.0; group.probes.len() * per_probe];
            let specimen = Specimen { transmission, origin: group.origin };
            let record = |probe: usize, r: usize, psi: &[Complex32], scale: f64| {
                let at = probe * per_probe + r * detectors;
                this.map.collect(psi, scale, &mut values[at..at + detectors]);
            };
            spare.with(
                || this.workspace(),
                |w| this.through(w, &routes[route], specimen, &group.probes, record),
            );
            progress.advance(group.probes.len() as u64);
            Ok(values)
        });
        let values = values.collect::<Result<Vec<_>>>()?;
        let mut out = vec![0.0; scan.len() * per_probe];
        for (group, values) in groups.iter().zip(&values) {
            for ((i, _), values) in group.probes.iter().zip(values.chunks_exact(per_probe)) {
                out[i * per_probe..][..per_probe].copy_from_slice(values);
            }
        }
        Ok(out)
    }

    pub fn workspace(&self) -> Workspace {
        let fft = self.stepper.fft();
        let waves = vec![fft.buffer(); self.stepper.group()];
        Workspace { waves, copy: fft.buffer(), step: self.stepper.workspace() }
    }

    /// Sorts probes by their window, in a way that depends on the positions only.
    fn groups(&self, positions: impl Iterator<Item = [f64; 2]>) -> Vec<Group> {
        let (cell, grid) = (&self.plan.transmission_grid, &self.plan.wave_grid);
        let pixel = grid.sampling_angstrom();
        let mut by_window: BTreeMap<[i64; 2], Vec<(usize, [f64; 2])>> = BTreeMap::new();
        for (i, position) in positions.enumerate() {
            let first = window_start(self.plan, position);
            let local = [0, 1].map(|k| position[k] - first[k] as f64 * pixel[k]);
            by_window.entry([first[1], first[0]]).or_default().push((i, local));
        }
        let wrap = |i: i64, axis: usize| i.rem_euclid(cell.points[axis] as i64) as usize;
        let most = self.stepper.group();
        let split = |([y, x], probes): ([i64; 2], Vec<_>)| {
            let origin = (wrap(y, 1), wrap(x, 0));
            let group = move |part: &[_]| Group { origin, probes: part.to_vec() };
            let even = probes.len().div_ceil(probes.len().div_ceil(most));
            probes.chunks(even).map(group).collect::<Vec<_>>()
        };
        by_window.into_iter().flat_map(split).collect()
    }

    /// Puts a probe at `position` (Angstrom, within the wave) into a wave.
    fn start(&self, wave: &mut [Complex32], position: [f64; 2], w: &mut stepper::Workspace) {
        let grid = &self.plan.wave_grid;
        let shift = [0, 1].map(|i| (position[i] - self.probe.centre[i]) / grid.extent_angstrom[i]);
        let phases = [0, 1].map(|i| shift_phases(shift[i], grid.points[i]));
        let stride = self.stepper.fft().stride();
        wave.fill(Complex32::ZERO);
        for &(iy, ix, amplitude) in &self.probe.entries {
            let c = amplitude * phases[0][ix] * phases[1][iy];
            wave[iy * stride + ix] = Complex32::new(c.re as f32, c.im as f32);
        }
        self.stepper.start(wave, &self.probe_columns, &mut w.fft);
    }

    /// The distinct routes of groups of probes, and which of them each group takes.
    fn routes(&mut self, t: &Transmission, groups: &[Group]) -> (Vec<Route>, Vec<usize>) {
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
        Workspace { waves, copy, step }: &mut Workspace,
        route: &Route,
        specimen: Specimen<'_>,
        probes: &[(usize, [f64; 2])],
        mut record: impl FnMut(usize, usize, &[Complex32], f64),
    ) {
        let (ny, nx) = self.stepper.fft().shape();
        let scale = 1.0 / ((nx * ny) as f64).powi(2);
        let waves = &mut waves[..probes.len()];
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
                record(probe, r, copy, scale);
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
        let group = self.groups(std::iter::once(position)).remove(0);
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

impl Spectrum {
    /// The probe on `grid`, at the origin and the entrance surface, with the norm that the settings ask for.
    fn full(plan: &Plan, grid: &Grid) -> Self {
        let optics = &plan.settings.optics;
        let (ny, nx) = grid.shape();
        let mut entries = Vec::new();
        for iy in 0..ny {
            for ix in 0..nx {
                let k = grid.k(iy, ix);
                let amplitude = optics.transfer(k, grid.dk());
                if amplitude != Complex64::ZERO {
                    entries.push((iy, ix, amplitude));
                }
            }
        }
        // The edge of the aperture is soft: its amplitudes add to the area of the aperture, their squares to less.
        let large = plan.settings.large_probe_box();
        let share = |a: Complex64| if large { a.norm() } else { a.norm_sqr() };
        let norm = entries.iter().map(|e| share(e.2)).sum::<f64>().sqrt();
        entries.iter_mut().for_each(|e| e.2 /= norm);
        Spectrum { entries, centre: [0.0; 2] }
    }

    /// The probe of plain multislice in a large box, with norm 1, cropped to the window and limited
    /// to low angles; not renormalised, since what is cropped never meets the atoms in the window.
    fn windowed(plan: &Plan) -> Self {
        let window = plan.wave_grid;
        let (my, mx) = probe_grid(plan).shape();
        let (ny, nx) = window.shape();
        let fft = Fft2::new(my, mx);
        let wave = probe_in_box(plan, &fft, &mut fft.scratch());
        let small = Fft2::new(ny, nx);
        let mut cropped = small.buffer();
        for y in 0..ny {
            cropped[y * small.stride()..][..nx].copy_from_slice(&wave[y * fft.stride()..][..nx]);
        }
        small.forward(&mut cropped, &mut small.scratch());
        let optics = &plan.settings.optics;
        let keep = (optics.semiangle_mrad * 2.0).max(optics.semiangle_mrad + 20.0) * 1e-3
            / optics.wavelength_angstrom();
        let keep = keep.min(plan.band_limit);
        // Fourier coefficients on the window, times n / m: intensities then are fractions of the beam
        let scale = 1.0 / ((nx * ny) as f64 * (mx * my) as f64).sqrt();
        let mut entries = Vec::new();
        for iy in 0..ny {
            for ix in 0..nx {
                let [kx, ky] = window.k(iy, ix);
                if kx.hypot(ky) < keep {
                    let v = cropped[iy * small.stride() + ix];
                    let v = Complex64::new(f64::from(v.re), f64::from(v.im));
                    entries.push((iy, ix, v * scale));
                }
            }
        }
        Spectrum { entries, centre: window_centre(plan) }
    }
}

/// First pixel (x, y) of the window of a probe; windows may reach over the edges of the cell.
pub(super) fn window_start(plan: &Plan, position: [f64; 2]) -> [i64; 2] {
    let (cell, grid) = (&plan.transmission_grid, &plan.wave_grid);
    let pixel = grid.sampling_angstrom();
    let mut first = [0; 2];
    for k in [0, 1].into_iter().filter(|&k| grid.points[k] < cell.points[k]) {
        let step = (WINDOW_STEP_ANGSTROM / pixel[k]).round().max(1.0);
        let centre = (position[k] / pixel[k] / step).round() * step;
        first[k] = centre as i64 - grid.points[k] as i64 / 2;
    }
    first
}

/// The middle of the window in Angstrom, from its first pixel.
pub(super) fn window_centre(plan: &Plan) -> [f64; 2] {
    let pixel = plan.wave_grid.sampling_angstrom();
    [0, 1].map(|i| (plan.wave_grid.points[i] / 2) as f64 * pixel[i])
}

/// Width in Angstrom of the large box of [`super::settings::ProbeBox`].
const PROBE_BOX_ANGSTROM: f64 = 75.0;

/// The pixels of the cell, over several cells where one is small.
pub(super) fn probe_grid(plan: &Plan) -> Grid {
    let cell = plan.transmission_grid;
    if !plan.settings.large_probe_box() {
        return cell;
    }
    let times = cell.extent_angstrom.map(|l| {
        // lengths that transforms like
        let cells = [1usize, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16, 20];
        cells.into_iter().find(|n| *n as f64 * l >= PROBE_BOX_ANGSTROM).unwrap_or(20)
    });
    Grid {
        points: [0, 1].map(|k| cell.points[k] * times[k]),
        extent_angstrom: [0, 1].map(|k| cell.extent_angstrom[k] * times[k] as f64),
    }
}

/// The probe in real space on [`probe_grid`] at the middle of a window that begins at pixel (0, 0);
/// `fft` is that of the grid.
pub(super) fn probe_in_box(plan: &Plan, fft: &Fft2, scratch: &mut Scratch) -> Buffer {
    let (grid, centre) = (probe_grid(plan), window_centre(plan));
    let phases = [0, 1].map(|i| shift_phases(centre[i] / grid.extent_angstrom[i], grid.points[i]));
    let mut wave = fft.buffer();
    for (iy, ix, a) in Spectrum::full(plan, &grid).entries {
        wave[iy * fft.stride() + ix] = single(a * phases[0][ix] * phases[1][iy]);
    }
    fft.inverse(&mut wave, scratch);
    wave
}

/// `exp(-2 pi i f u)` for all FFT frequencies f of n bins.
fn shift_phases(u: f64, n: usize) -> Vec<Complex64> {
    (0..n).map(|i| Complex64::from_polar(1.0, -2.0 * PI * u * frequency(i, n) as f64)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::transmission::TransmissionBuilder;
    use super::super::{ProbeStep, Settings, Site};
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
