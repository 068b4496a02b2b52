//! Images in single scattering: every atom scatters the probe independently. Used for thin films of light atoms, and for the scattering of
//! the probe's far tail.
//!
//! Each atom adds `s (P_z * v)(r)` to the image: P_z is the intensity of the probe in free space at the depth of the atom, s
//! the cross section of the atom for the detector, and v the blur of its scattering, with integral 1. Three things are
//! neglected. Interference between different atoms: it is random in an amorphous film and averages out over phonon
//! configurations. Multiple scattering. The curvature of the probe's phase within an atom.
//!
//! For 50 A of amorphous carbon (2.0 g/cm3, 68-200 mrad, 200 kV) the error of the mean is 1 %. Pixels deviate by 5 % rms of the film's mean
//! intensity in one configuration, by 3.0 % in the mean of 4 and by 2.5 % in the mean of 7 (tests/worlds/film.rs). The film is 1 % as
//! bright as a Pt column.

use super::settings::Settings;
use crate::constants::interaction_parameter;
use crate::detect::Detector;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, frequency, good_size};
use crate::optics::{Focus, foci};
use crate::potential::cores::amplitudes;
use crate::potential::scattering::ScatteringFactor;
use crate::resample::{Kernel, image_band_limit};
use ndarray::Array2;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Distance in Angstrom of the depths at which the probe's intensity is computed. Between them it is interpolated linearly.
const LAYER_ANGSTROM: f64 = 5.0;
/// Points of the integrals over the detector and the aperture.
const RADII: usize = 96;
const SPOKES: usize = 24;
const DIRECTIONS: usize = 17;
/// Points of the blur's transfer function.
const TRANSFER_POINTS: usize = 12;

/// A periodic raster of samples on which images in single scattering are made.
pub struct SingleScattering<'a> {
    settings: &'a Settings,
    fft: Fft2,
    kernel: Kernel,
    /// Distance of samples in Angstrom.
    step: f64,
}

/// The positions of the atoms of one element: their density on the raster at several depths.
pub struct ScatteringMap<'a> {
    raster: &'a SingleScattering<'a>,
    atom: Scatterer,
    /// Depths in Angstrom, ascending.
    depths: Vec<f64>,
    /// The density at each depth: rows = y, columns = x, row-major.
    layers: Vec<Vec<f64>>,
}

/// Scattering of an atom of an element onto the detector.
struct Scatterer {
    /// Cross section in Angstrom^2, mean over the directions of the probe.
    section: f64,
    /// Transfer function of the blur, at even steps up to twice the aperture.
    transfer: [f64; TRANSFER_POINTS + 1],
}

impl<'a> SingleScattering<'a> {
    /// Makes a raster of at least `least` (rows, columns) samples, `step` Angstrom apart.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a step that is too coarse for images.
    pub fn new(settings: &'a Settings, step: f64, least: [usize; 2]) -> Result<Self> {
        let kernel = Kernel::new(step, image_band_limit(&settings.optics))?;
        let [ny, nx] = least.map(|n| good_size(n, 1));
        Ok(SingleScattering { settings, fft: Fft2::new(ny, nx), kernel, step })
    }

    /// An empty map for atoms of element `number` at depths from `first` to `last` Angstrom.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`] for an element that the tables lack.
    pub fn map(&'a self, number: u8, [first, last]: [f64; 2]) -> Result<ScatteringMap<'a>> {
        let count = ((last - first) / LAYER_ANGSTROM).ceil().max(1.0) as usize;
        let depth = |i| first + (last - first) * i as f64 / count as f64;
        let (ny, nx) = self.fft.shape();
        Ok(ScatteringMap {
            raster: self,
            atom: Scatterer::new(self.settings, &self.settings.detectors[0], number)?,
            depths: (0..=count).map(depth).collect(),
            layers: vec![vec![0.0; ny * nx]; count + 1],
        })
    }

    /// Fourier coefficients of the probe's intensity at a depth (Angstrom), further than `beyond` (Angstrom, along x or y)
    /// from its middle: the mean over the focal spread. The intensity sums to its share of the beam.
    fn probe(&self, depth: f64, beyond: f64) -> Buffer {
        let foci = foci(&self.settings.optics).unwrap_or_default();
        let mut sum = self.fft.buffer();
        for Focus { offset_angstrom, weight } in foci {
            // Underfocus moves the focus deeper by this distance, which acts as a smaller depth.
            let probe = self.probe_in_focus(depth - offset_angstrom, beyond);
            sum.iter_mut().zip(&*probe).for_each(|(s, p)| *s += p * weight as f32);
        }
        self.move_by(&mut sum, self.settings.optics.slope().map(|s| s * depth));
        sum
    }

    /// Multiplies Fourier coefficients by the phases that move their image by `way` Angstrom (x, y).
    fn move_by(&self, spectrum: &mut [Complex32], way: [f64; 2]) {
        if way == [0.0; 2] {
            return;
        }
        let (ny, nx) = self.fft.shape();
        for iy in 0..ny {
            let ky = frequency(iy, ny) as f64 / (ny as f64 * self.step);
            for ix in 0..nx {
                let kx = frequency(ix, nx) as f64 / (nx as f64 * self.step);
                let turn = Complex64::from_polar(1.0, -TAU * (kx * way[0] + ky * way[1]));
                let turn = Complex32::new(turn.re as f32, turn.im as f32);
                spectrum[iy * self.fft.stride() + ix] *= turn;
            }
        }
    }

    /// As [`SingleScattering::probe`], at one focus and without mistilt.
    fn probe_in_focus(&self, depth: f64, beyond: f64) -> Buffer {
        let (ny, nx) = self.fft.shape();
        let (mut wave, norm) = self.probe_spectrum(depth);
        let mut scratch = self.fft.scratch();
        self.fft.inverse(&mut wave, &mut scratch);
        let scale = 1.0 / (norm * (nx * ny) as f64);
        let near = (beyond / self.step).round() as i64;
        for iy in 0..ny {
            for ix in 0..nx {
                let inside = frequency(ix, nx).abs() < near && frequency(iy, ny).abs() < near;
                let v = &mut wave[iy * self.fft.stride() + ix];
                let share = if inside { 0.0 } else { f64::from(v.norm_sqr()) * scale };
                *v = Complex32::new(share as f32, 0.0);
            }
        }
        self.fft.forward(&mut wave, &mut scratch);
        wave
    }

    /// Fourier coefficients of the probe at a depth (Angstrom), and the area of the aperture, which is its squared norm in a
    /// large box.
    fn probe_spectrum(&self, depth: f64) -> (Buffer, f64) {
        let optics = &self.settings.optics;
        let (ny, nx) = self.fft.shape();
        let dk = [nx, ny].map(|n| 1.0 / (n as f64 * self.step));
        let mut wave = self.fft.buffer();
        let mut norm = 0.0;
        for iy in 0..ny {
            let ky = frequency(iy, ny) as f64 * dk[1];
            for ix in 0..nx {
                let kx = frequency(ix, nx) as f64 * dk[0];
                let amplitude = optics.transfer([kx, ky], dk);
                if amplitude == Complex64::ZERO {
                    continue;
                }
                // The edge of the aperture is soft; its area is the sum of amplitudes.
                norm += amplitude.norm();
                let phase = -PI * optics.wavelength_angstrom() * depth * (kx * kx + ky * ky);
                let c = amplitude * Complex64::from_polar(1.0, phase);
                wave[iy * self.fft.stride() + ix] = Complex32::new(c.re as f32, c.im as f32);
            }
        }
        (wave, norm)
    }
}

impl ScatteringMap<'_> {
    /// Adds atoms at `positions` (x and y from the first sample, and depth, in Angstrom), each counted `weight` times.
    pub fn add(&mut self, positions: &[[f64; 3]], weight: f64) {
        let ScatteringMap { raster, depths, layers, .. } = self;
        let ((ny, nx), kernel, step) = (raster.fft.shape(), &raster.kernel, raster.step);
        let (first, spacing) = (depths[0], (depths[1] - depths[0]).max(1e-9));
        let last = (depths.len() - 1) as f64;
        layers.par_iter_mut().enumerate().for_each(|(n, layer)| {
            for [x, y, z] in positions {
                let at = ((z - first) / spacing).clamp(0.0, last);
                let share = 1.0 - (at - n as f64).abs();
                if share <= 0.0 {
                    continue;
                }
                // Atoms are added by the transpose of interpolation, since images are interpolated from the samples.
                let (across, down) = (kernel.weights(x / step), kernel.weights(y / step));
                for (i, wy) in down.values.iter().enumerate() {
                    let row = (down.first + i as i64).rem_euclid(ny as i64) as usize;
                    let line = &mut layer[row * nx..][..nx];
                    let factor = weight * share * wy;
                    for (j, wx) in across.values.iter().enumerate() {
                        let column = (across.first + j as i64).rem_euclid(nx as i64) as usize;
                        line[column] += factor * wx;
                    }
                }
            }
        });
    }

    /// The image: the fraction of the beam on the detector for a probe at each sample, rows = y and columns = x of the raster.
    /// Atoms within `beyond` Angstrom of the probe, along x and y, are left out.
    pub fn image(&self, beyond: f64) -> Array2<f64> {
        let SingleScattering { fft, step, settings, .. } = self.raster;
        let (ny, nx) = fft.shape();
        let optics = &settings.optics;
        let reach = 2e-3 * optics.semiangle_mrad / optics.wavelength_angstrom();
        let terms = self.layers.par_iter().zip(&self.depths).map(|(layer, depth)| {
            let probe = self.raster.probe(*depth, beyond);
            let mut sum = fft.buffer();
            for (row, line) in sum.chunks_exact_mut(fft.stride()).zip(layer.chunks_exact(nx)) {
                row.iter_mut().zip(line).for_each(|(to, v)| *to = Complex32::new(*v as f32, 0.0));
            }
            fft.forward(&mut sum, &mut fft.scratch());
            // A probe at r0 meets an atom at r with the intensity P(r - r0): a correlation.
            sum.iter_mut().zip(&*probe).for_each(|(s, p)| *s *= p.conj());
            sum
        });
        let terms: Vec<_> = terms.collect();
        let mut sum = fft.buffer();
        for term in &terms {
            sum.iter_mut().zip(&**term).for_each(|(s, t)| *s += t);
        }
        for iy in 0..ny {
            let ky = frequency(iy, ny) as f64 / (ny as f64 * step);
            for ix in 0..nx {
                let kx = frequency(ix, nx) as f64 / (nx as f64 * step);
                sum[iy * fft.stride() + ix] *= self.atom.at(kx.hypot(ky) / reach) as f32;
            }
        }
        fft.inverse(&mut sum, &mut fft.scratch());
        // The probe's intensity sums to its share of the beam over samples of step^2 each.
        let scale = self.atom.section / (step * step * (nx * ny) as f64);
        Array2::from_shape_fn((ny, nx), |(i, j)| f64::from(sum[i * fft.stride() + j].re) * scale)
    }
}

/// The cross section of an atom of an element for the first detector, in square Angstrom, averaged over the directions of the probe.
///
/// # Errors
/// [`crate::Error::UnknownElement`] for an element that the tables lack.
pub(crate) fn cross_section_angstrom2(settings: &Settings, number: u8) -> Result<f64> {
    Ok(Integrals::new(settings, &settings.detectors[0], number)?.over_detector(0.0))
}

/// The scattering amplitudes of an atom, and the detector over which they are integrated; angles are in 1/Angstrom.
struct Integrals<'a> {
    detector: &'a Detector,
    per_mrad: f64,
    aperture: f64,
    /// Scattering amplitudes at even steps from `low`.
    amplitudes: Vec<Complex64>,
    low: f64,
    step: f64,
}

impl<'a> Integrals<'a> {
    fn new(settings: &Settings, detector: &'a Detector, number: u8) -> Result<Self> {
        let optics = &settings.optics;
        let factor = ScatteringFactor::new(settings.parametrization, number)?;
        let per_mrad = 1e-3 / optics.wavelength_angstrom();
        let aperture = optics.semiangle_mrad * per_mrad;
        let [inner, outer] = [detector.inner_mrad, detector.outer_mrad].map(|a| a * per_mrad);
        // The blur shifts momenta by up to the aperture to either side.
        let low = (inner - 2.0 * aperture).max(0.0);
        let step = (outer + 2.0 * aperture - low) / (2 * RADII) as f64;
        let ks: Vec<f64> = (0..=2 * RADII).map(|i| low + i as f64 * step).collect();
        let amplitudes = amplitudes(&factor, interaction_parameter(optics.energy_ev()), &ks);
        Ok(Integrals { detector, per_mrad, aperture, amplitudes, low, step })
    }

    fn amplitude(&self, k: f64) -> Complex64 {
        let at = ((k - self.low) / self.step).clamp(0.0, (2 * RADII) as f64 - 1e-9);
        let (i, t) = (at as usize, at.fract());
        self.amplitudes[i] * (1.0 - t) + self.amplitudes[i + 1] * t
    }

    /// The product of the waves that are scattered from two directions of the probe, `2 half` apart, integrated over the detector and
    /// averaged over pairs of directions. With `half` = 0 this is the cross section in square Angstrom.
    fn over_detector(&self, half: f64) -> f64 {
        let Integrals { detector, per_mrad, aperture, .. } = *self;
        let [inner, outer] = [detector.inner_mrad, detector.outer_mrad].map(|a| a * per_mrad);
        let range = [(inner - aperture).max(0.0), outer + aperture];
        let width = (range[1] - range[0]) / RADII as f64;
        let directions = directions(aperture, half);
        let ring = |i: usize| {
            let p = range[0] + (i as f64 + 0.5) * width;
            let term = |spoke: usize| {
                let (sine, cosine) = libm::sincos(PI * (spoke as f64 + 0.5) / SPOKES as f64);
                let (along, across) = (p * cosine, p * sine);
                let [a, b] = [along - half, along + half].map(|v| self.amplitude(across.hypot(v)));
                (a * b.conj()).re * seen([along, across], &directions, detector, per_mrad)
            };
            (0..SPOKES).map(term).sum::<f64>() / SPOKES as f64 * TAU * p * width
        };
        (0..RADII).map(ring).sum()
    }
}

impl Scatterer {
    fn new(settings: &Settings, detector: &Detector, number: u8) -> Result<Self> {
        let integrals = Integrals::new(settings, detector, number)?;
        let half = |n: usize| integrals.aperture * n as f64 / TRANSFER_POINTS as f64;
        let transfer: [f64; TRANSFER_POINTS + 1] =
            std::array::from_fn(|n| integrals.over_detector(half(n)));
        let section = transfer[0];
        Ok(Scatterer { section, transfer: transfer.map(|t| t / section) })
    }

    /// The transfer function at a frequency in units of twice the aperture.
    fn at(&self, frequency: f64) -> f64 {
        let at = (frequency * TRANSFER_POINTS as f64).min(TRANSFER_POINTS as f64 - 1e-9);
        let (i, t) = (at as usize, at.fract());
        self.transfer[i] * (1.0 - t) + self.transfer[i + 1] * t
    }
}

/// Midpoints of two directions within the aperture that are `2 half` apart along x: evenly distributed over the overlap of the two shifted
/// apertures.
fn directions(aperture: f64, half: f64) -> Vec<[f64; 2]> {
    let edge = |i: usize| ((i as f64 + 0.5) / DIRECTIONS as f64 * 2.0 - 1.0) * aperture;
    let all = (0..DIRECTIONS * DIRECTIONS).map(|i| [edge(i % DIRECTIONS), edge(i / DIRECTIONS)]);
    let inside = |k: &[f64; 2]| (k[0].abs() + half).hypot(k[1]) <= aperture;
    let found: Vec<[f64; 2]> = all.filter(inside).collect();
    if found.is_empty() { vec![[0.0; 2]] } else { found }
}

/// The share of the directions from which scattering by `p` reaches the detector.
fn seen(p: [f64; 2], directions: &[[f64; 2]], detector: &Detector, per_mrad: f64) -> f64 {
    let [inner, outer] = [detector.inner_mrad, detector.outer_mrad].map(|a| a * per_mrad);
    let square = |k: &[f64; 2]| (p[0] + k[0]).powi(2) + (p[1] + k[1]).powi(2);
    let hit = |square: &f64| inner * inner <= *square && *square < outer * outer;
    let hits = directions.iter().map(square).filter(hit);
    let counted = match detector.response.is_empty() {
        true => hits.count() as f64,
        false => hits.map(|square| detector.response_at(square.sqrt() / per_mrad)).sum(),
    };
    counted / directions.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{Algorithm, Plan, ProbeBox, ProbeStep, Scan, Site, simulate};
    use crate::progress::Silent;

    /// One atom, against multislice: measured 0.1 %, 0.5 % and 0.9 % of the maximum.
    #[test]
    fn an_atom_is_seen_as_by_multislice() {
        let settings = Settings {
            algorithm: Algorithm::Multislice,
            probe_box: Some(ProbeBox::Large),
            probe_step: ProbeStep::Scan,
            ..Settings::default()
        };
        let (cell, step) = (16.0, 0.25);
        for (number, depth, tolerance) in [(6, 0.5, 0.002), (6, 40.0, 0.007), (78, 20.0, 0.012)] {
            let position = [8.1, 7.95, depth];
            let site = Site { position, number, sigma_angstrom: 0.0, anisotropy: None, key: 0 };
            let plan = Plan::new(&settings, [cell, cell, depth + 1.0], &[depth]).unwrap();
            let scan =
                Scan { origin_angstrom: [4.0, 8.0], step_angstrom: [step; 2], shape: [1, 32] };
            let exact = simulate(&plan, &[site], &scan, &Silent).unwrap();
            let exact = exact.image(0, 0);
            let raster = SingleScattering::new(&settings, step, [300, 300]).unwrap();
            let mut map = raster.map(number, [0.0, 50.0]).unwrap();
            map.add(&[[position[0] + 20.0, position[1] + 20.0, depth]], 1.0);
            let ours = map.image(0.0);
            let most = exact.iter().fold(0.0, |m: f64, v| m.max(f64::from(*v)));
            for j in 0..32 {
                let (a, b) = (ours[[112, 96 + j]], f64::from(exact[[0, j]]));
                assert!((a - b).abs() < tolerance * most, "{number} at {depth}: {j} {a} {b}");
            }
        }
    }

    /// Atoms within `beyond` of the probe are left out, and the others kept.
    #[test]
    fn near_and_far_add_to_all() {
        let settings = Settings::default();
        let raster = SingleScattering::new(&settings, 0.25, [200, 200]).unwrap();
        let image = |beyond: f64| {
            let mut map = raster.map(6, [0.0, 10.0]).unwrap();
            map.add(&[[25.0, 25.0, 5.0]], 1.0);
            map.image(beyond)
        };
        let (all, far) = (image(0.0), image(3.0));
        assert!((far[[100, 130]] / all[[100, 130]] - 1.0).abs() < 0.05);
        assert!(far[[100, 100]].abs() < 1e-3 * all[[100, 100]]);
        let share = far.sum() / all.sum();
        // The encircled energy of the Airy pattern outside 3 A, J0^2 + J1^2 at 15.8, is 4.1 %, less the corners.
        assert!((0.025..0.05).contains(&share), "{share}");
    }
}
