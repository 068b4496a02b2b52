//! Projected potentials of slices by structure factors.
//!
//! `V(k) = (h^2 / 2 pi m e) / area  sum_species f(k) sum_atoms exp(-2 pi i k.r)`: atoms keep their exact positions and are not
//! spread over pixels. The sum over atoms separates into cosines and sines of `2 pi kx x` and `2 pi ky y`, whose
//! products are one real matrix product for a quarter of the plane.

use super::scattering::{Parametrization, ScatteringFactor};
use super::slices::Slices;
use crate::constants::POTENTIAL_PER_SCATTERING_FACTOR;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, Scratch, frequency};
use crate::matrix::multiply;
use crate::simd::vectorised;
use num_complex::{Complex32, Complex64};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// How an atom is distributed over slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Projection {
    /// The whole atom goes into the slice that holds its nucleus.
    #[default]
    Infinite,
    /// Each slice gets the part of the atom between its boundaries.
    Finite,
}

/// Reach of an atom along the beam with finite projection, in Angstrom. The slices at this distance get the rest of the
/// atom, so that nothing is lost.
const FINITE_REACH_ANGSTROM: f64 = 8.0;
/// Points of the radial table of one atom's part in one slice.
const RADIAL_POINTS: usize = 4096;

/// An atom at its position in one phonon configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlacedAtom {
    /// Position in Angstrom.
    pub position: [f64; 3],
    /// Atomic number.
    pub number: u8,
}

/// The filter for the potentials of atoms in Fourier space (infinite projection only).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PotentialFilter {
    /// No filter.
    AsIs,
    /// Multiplied by `exp(-q^2 / 2 cutoff^2)` in Fourier space.
    Smoothed {
        /// 1/Angstrom
        cutoff: f64,
    },
    /// The placement of [`crate::engine::Settings::abtem_placement`].
    AbtemPlacement,
}

/// Computes projected potentials on one grid.
pub(crate) struct Projector {
    fft: Fft2,
    extent: [f64; 2],
    /// Whether atoms are spread over grid points ([`PotentialFilter::AbtemPlacement`]).
    spread: bool,
    species: Vec<Species>,
}

struct Species {
    number: u8,
    factor: ScatteringFactor,
    /// `V(k)` of one atom in V Angstrom on the quarter plane kx, ky >= 0: ny / 2 + 1 rows of nx / 2 + 1 elements.
    quarter_plane: Vec<f32>,
}

/// Work space of one thread.
pub(crate) struct ProjectorScratch {
    fft: Scratch,
    /// Rows of cosines and of sines along y, columns of cosines and of sines along x.
    products: Vec<f32>,
}

impl Projector {
    /// Prepares a grid of `ny` rows and `nx` columns over a cell of `extent` (x, y) Angstrom, and the given elements.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`] for an element that the table lacks.
    pub(crate) fn new(
        (ny, nx): (usize, usize),
        extent: [f64; 2],
        parametrization: Parametrization,
        elements: &[u8],
        shape: PotentialFilter,
    ) -> Result<Self> {
        let reshaped = |iy, ix, q2: f64| match shape {
            PotentialFilter::AsIs => 1.0,
            PotentialFilter::Smoothed { cutoff } => (-0.5 * q2 / (cutoff * cutoff)).exp(),
            PotentialFilter::AbtemPlacement => {
                let part = |i, n| frequency(i, n) as f64 / n as f64;
                let u = part(iy, ny).hypot(part(ix, nx));
                if u > 0.0 { u / u.sin() } else { 1.0 }
            }
        };
        let (high, wide) = (ny / 2 + 1, nx / 2 + 1);
        let unit = POTENTIAL_PER_SCATTERING_FACTOR / (extent[0] * extent[1]);
        let species = elements.iter().map(|&number| {
            let factor = ScatteringFactor::new(parametrization, number)?;
            let mut quarter_plane = Vec::with_capacity(high * wide);
            for iy in 0..high {
                let q2: Vec<f64> = (0..wide).map(|ix| k2(iy, ix, (ny, nx), extent)).collect();
                let values = factor.at_each(&q2);
                let row = (0..wide).map(|ix| unit * values[ix] * reshaped(iy, ix, q2[ix]));
                quarter_plane.extend(row.map(|v| v as f32));
            }
            Ok(Species { number, factor, quarter_plane })
        });
        let species = species.collect::<Result<_>>()?;
        let spread = shape == PotentialFilter::AbtemPlacement;
        Ok(Projector { fft: Fft2::new(ny, nx), extent, spread, species })
    }

    /// The transform of this grid.
    pub(crate) fn fft(&self) -> &Fft2 {
        &self.fft
    }

    /// Work space for one thread.
    pub(crate) fn scratch(&self) -> ProjectorScratch {
        let (ny, nx) = self.fft.shape();
        let (high, wide) = (ny / 2 + 1, nx / 2 + 1);
        ProjectorScratch { fft: self.fft.scratch(), products: vec![0.0; 4 * high * wide] }
    }

    /// The projected potential, in V Angstrom, of a slice to which all of `atoms` belong. `out` is an array of
    /// [`Projector::fft`] (rows = y, columns = x); it holds pairs of rows as [`Fft2::inverse_real`] leaves them.
    pub(crate) fn infinite(
        &self,
        atoms: &[PlacedAtom],
        out: &mut Buffer,
        scratch: &mut ProjectorScratch,
    ) {
        out.fill(Complex32::ZERO);
        for species in &self.species {
            let mine = atoms.iter().filter(|a| a.number == species.number).map(|a| a.position);
            self.add_species(species, mine, out, &mut scratch.products);
        }
        self.fft.inverse_real(out, &mut scratch.fft);
    }

    /// The projected potential of slice `index` with finite projection; `atoms` holds the atoms of the whole specimen. `out` has the layout
    /// of [`Projector::infinite`].
    pub(crate) fn finite(
        &self,
        atoms: &[PlacedAtom],
        slices: &Slices,
        index: usize,
        out: &mut Buffer,
        scratch: &mut ProjectorScratch,
    ) {
        out.fill(Complex32::ZERO);
        for atom in atoms {
            let reach =
                atom.position[2] - FINITE_REACH_ANGSTROM..atom.position[2] + FINITE_REACH_ANGSTROM;
            let (first, last) = (slices.index(reach.start), slices.index(reach.end));
            if !(first..=last).contains(&index) {
                continue;
            }
            let far = 1e3;
            let below =
                if index == first { -far } else { slices.boundaries[index] - atom.position[2] };
            let above =
                if index == last { far } else { slices.boundaries[index + 1] - atom.position[2] };
            if let Some(s) = self.species.iter().find(|s| s.number == atom.number) {
                self.add_part(s, atom.position, [below, above], out);
            }
        }
        self.fft.inverse_real(out, &mut scratch.fft);
    }

    /// Adds the part of one atom between the heights `z[0]` and `z[1]` in Angstrom from its nucleus.
    fn add_part(&self, species: &Species, at: [f64; 3], z: [f64; 2], sum: &mut [Complex32]) {
        let (ny, nx) = self.fft.shape();
        let half = nx / 2 + 1;
        let shape = (ny, nx);
        let top = k2(ny / 2, nx / 2, shape, self.extent).sqrt() * 1.001;
        let unit = POTENTIAL_PER_SCATTERING_FACTOR / (self.extent[0] * self.extent[1]);
        let step = top / (RADIAL_POINTS - 2) as f64;
        let table: Vec<f32> = (0..RADIAL_POINTS)
            .map(|i| {
                let q = i as f64 * step;
                (unit * species.factor.between(q * q, z[0], z[1])) as f32
            })
            .collect();
        let x = phases(at[0] / self.extent[0], nx, 0..half);
        let y = phases(at[1] / self.extent[1], ny, 0..ny);
        for iy in 0..ny {
            let row = &mut sum[iy * self.fft.stride()..][..half];
            for (ix, s) in row.iter_mut().enumerate() {
                let q = (k2(iy, ix, shape, self.extent).sqrt() / step) as f32;
                let (i, t) = (q as usize, q.fract());
                let f = table[i] + t * (table[i + 1] - table[i]);
                *s += x[ix] * y[iy] * f;
            }
        }
    }

    /// Adds `V(k) sum_atoms exp(-2 pi i k.r)` on the half plane.
    fn add_species(
        &self,
        species: &Species,
        positions: impl Iterator<Item = [f64; 3]>,
        sum: &mut [Complex32],
        products: &mut [f32],
    ) {
        let (ny, nx) = self.fft.shape();
        let (high, wide) = (ny / 2 + 1, nx / 2 + 1);
        let (mut along_y, mut along_x) = (Vec::new(), Vec::new());
        for p in positions {
            let push = if self.spread { push_spread } else { push_cosines_and_sines };
            push(p[1] / self.extent[1], ny, high, &mut along_y);
            push(p[0] / self.extent[0], nx, wide, &mut along_x);
        }
        let atoms = along_x.len() / (2 * wide);
        if atoms == 0 {
            return;
        }
        let (y, x) = ((&along_y[..], [1, 2 * high]), (&along_x[..], 2 * wide));
        multiply((2 * high, 2 * wide, atoms), (products, 2 * wide), y, x);
        let (cosines, sines) = products.split_at(2 * high * wide);
        for iy in 0..ny {
            let fy = frequency(iy, ny);
            let row = fy.unsigned_abs() as usize;
            let at = row * 2 * wide;
            let (cos_cos, cos_sin) = cosines[at..][..2 * wide].split_at(wide);
            let (sin_cos, sin_sin) = sines[at..][..2 * wide].split_at(wide);
            let sign = if fy < 0 { -1.0 } else { 1.0 };
            let sum = &mut sum[iy * self.fft.stride()..][..wide];
            let factors = &species.quarter_plane[row * wide..][..wide];
            vectorised(
                #[inline(always)]
                || {
                    for ix in 0..wide {
                        sum[ix].re += factors[ix] * (cos_cos[ix] - sign * sin_sin[ix]);
                        sum[ix].im -= factors[ix] * (cos_sin[ix] + sign * sin_cos[ix]);
                    }
                },
            );
        }
    }
}

/// Squared spatial frequency of bin (iy, ix) in 1/Angstrom^2.
fn k2(iy: usize, ix: usize, (ny, nx): (usize, usize), extent: [f64; 2]) -> f64 {
    let ky = frequency(iy, ny) as f64 / extent[1];
    let kx = frequency(ix, nx) as f64 / extent[0];
    kx * kx + ky * ky
}

/// `exp(-2 pi i f u)` for the frequencies f of the given bins of a grid of `n`, `u` the position in
/// units of the period.
fn phases(u: f64, n: usize, bins: std::ops::Range<usize>) -> Vec<Complex32> {
    let count = n / 2 + 1;
    let mut positive = Vec::new();
    push_cosines_and_sines(u, n, count, &mut positive);
    bins.map(|i| {
        let f = frequency(i, n);
        let at = f.unsigned_abs() as usize;
        let sine = positive[count + at];
        Complex32::new(positive[at], if f < 0 { sine } else { -sine })
    })
    .collect()
}

/// Appends `cos(2 pi f u)` for the frequencies f below `count` of a grid of `n`, then the sines; `u` is the position
/// in units of the period.
fn push_cosines_and_sines(u: f64, n: usize, count: usize, out: &mut Vec<f32>) {
    let start = out.len();
    push_powers(Complex64::ONE, u, count, out);
    // The Nyquist bin of an even grid stands for both signs, so that its sine vanishes.
    if n.is_multiple_of(2) && count > n / 2 {
        out[start + count + n / 2] = 0.0;
    }
}

/// As [`push_cosines_and_sines`], for an atom that is spread linearly over the two grid points around it.
fn push_spread(u: f64, n: usize, count: usize, out: &mut Vec<f32>) {
    let start = out.len();
    let below = (u * n as f64).floor();
    let share = (u * n as f64 - below) as f32;
    push_cosines_and_sines(below / n as f64, n, count, out);
    let mut above = Vec::with_capacity(2 * count);
    push_cosines_and_sines((below + 1.0) / n as f64, n, count, &mut above);
    for (v, above) in out[start..].iter_mut().zip(above) {
        *v += share * (above - *v);
    }
}

/// Appends the real parts of `first exp(2 pi i f u)` for f below `count`, then the imaginary parts.
pub(super) fn push_powers(first: Complex64, u: f64, count: usize, out: &mut Vec<f32>) {
    const AT_ONCE: usize = 16;
    let turn = |f: f64| Complex64::from_polar(1.0, 2.0 * PI * u.rem_euclid(1.0) * f);
    let start = out.len();
    out.resize(start + 2 * count, 0.0);
    let (re, im) = out[start..].split_at_mut(count);
    let (mut x, mut y) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
    let (step, mut w) = (turn(1.0), first);
    for i in 0..AT_ONCE {
        (x[i], y[i]) = (w.re, w.im);
        w *= step;
    }
    let step = turn(AT_ONCE as f64);
    vectorised(
        #[inline(always)]
        || {
            for (re, im) in re.chunks_mut(AT_ONCE).zip(im.chunks_mut(AT_ONCE)) {
                for (i, (re, im)) in re.iter_mut().zip(im).enumerate() {
                    (*re, *im) = (x[i] as f32, y[i] as f32);
                }
                for (x, y) in x.iter_mut().zip(&mut y) {
                    (*x, *y) = (*x * step.re - *y * step.im, *x * step.im + *y * step.re);
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::potential::slices::Slicing;

    fn projector(n: usize) -> Projector {
        Projector::new((n, n), [6.0, 5.0], Parametrization::Lobato, &[8, 38], PotentialFilter::AsIs)
            .unwrap()
    }

    fn real(p: &Projector, b: &Buffer) -> Vec<f32> {
        let (ny, nx) = p.fft.shape();
        (0..ny * nx).map(|i| p.fft.of_pair(b, i / nx, i % nx)).collect()
    }

    #[test]
    fn mean_potential_is_the_forward_scattering_and_shifts_are_exact() {
        let p = projector(60);
        let mut out = p.fft.buffer();
        let mut scratch = p.scratch();
        let at = |x: f64, y: f64| [PlacedAtom { position: [x, y, 0.0], number: 38 }];
        p.infinite(&at(3.0, 2.5), &mut out, &mut scratch);
        let centred = real(&p, &out);
        let mean = centred.iter().sum::<f32>() / centred.len() as f32;
        let f0 = ScatteringFactor::new(Parametrization::Lobato, 38).unwrap().at(0.0);
        let expected = POTENTIAL_PER_SCATTERING_FACTOR * f0 / 30.0;
        assert!((f64::from(mean) / expected - 1.0).abs() < 1e-5);
        // one pixel further along x, with a wrap around the cell's edge along y
        p.infinite(&at(3.1, 2.5 - 5.0 * 3.0), &mut out, &mut scratch);
        let shifted = real(&p, &out);
        let top = centred.iter().fold(0.0, |a: f32, b| a.max(*b));
        for y in 0..60 {
            for x in 0..60 {
                let error = shifted[y * 60 + (x + 1) % 60] - centred[y * 60 + x];
                assert!(error.abs() < 2e-6 * top);
            }
        }
    }

    #[test]
    fn finite_slices_add_up_to_the_infinite_projection() {
        let p = projector(40);
        let atoms = [
            PlacedAtom { position: [1.23, 4.9, 2.1], number: 38 },
            PlacedAtom { position: [5.5, 0.4, 6.02], number: 8 },
        ];
        let slices = Slices::new(Slicing::Thickness(2.0), 24.0, &[2.1, 6.02]).unwrap();
        let (mut out, mut scratch) = (p.fft.buffer(), p.scratch());
        let mut sum = vec![0.0; 1600];
        for i in 0..slices.len() {
            p.finite(&atoms, &slices, i, &mut out, &mut scratch);
            sum.iter_mut().zip(real(&p, &out)).for_each(|(s, v)| *s += v);
        }
        p.infinite(&atoms, &mut out, &mut scratch);
        let whole = real(&p, &out);
        let top = whole.iter().fold(0.0, |a: f32, b| a.max(*b));
        for (s, w) in sum.iter().zip(&whole) {
            assert!((s - w).abs() < 1e-5 * top, "{s} {w}");
        }
    }
}
