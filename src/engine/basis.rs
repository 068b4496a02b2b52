//! Probes that share a window, expanded in fewer waves.
//!
//! The aperture limits the spectrum of a probe, so probes less than `wavelength / (2 semiangle)` apart (0.6 A) are nearly
//! linear combinations of each other. All probes of a patch are expanded in their principal components: orthonormal waves, as
//! many as leave no probe an error above a given share of its amplitude. Only these waves are propagated. With
//! their Fourier coefficients `phi_j(k)` behind the specimen, a probe with the coefficients `c_j` has the intensity
//! `sum_ij c_i* c_j M_ij` on a detector D, `M_ij = sum_k D(k) phi_i*(k) phi_j(k)`. The error of the expansion is the only
//! approximation. With focal spread the waves hold the probes of all foci.

use super::probe::CroppedProbe;
use super::single_precision::single;
use crate::matrix::multiply;
use nalgebra::{DMatrix, SymmetricEigen};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;

/// The waves in which the probes of a patch are expanded.
pub(super) struct Basis {
    /// (wave, bin of the window), row-major.
    waves: Vec<Complex32>,
    /// Matrix (wave, bin of the surroundings), row-major. Its product with the coefficients of a probe in the surroundings gives the
    /// coefficients on the waves.
    project: Vec<Complex32>,
    /// Number of bins of the window.
    bins: usize,
}

/// Candidate positions in a patch, along an axis for each Nyquist distance of the amplitude (0.6 A).
const CANDIDATES_PER_NYQUIST: f64 = 3.0;
/// The first reduction of the candidates has this share of the allowed error.
const REDUCED: f64 = 0.3;

impl Basis {
    /// Chooses the waves for probes with different foci, at most `half` (Angstrom, along x and y) from the middle of a window. Each probe
    /// has at most the error `error`, as a share of its amplitude. `nyquist` is the Nyquist distance of the amplitude in Angstrom.
    pub fn new(probes: &[&CroppedProbe], half: [f64; 2], nyquist: f64, error: f64) -> Self {
        let candidates = Candidates::new(probes, half, nyquist / CANDIDATES_PER_NYQUIST);
        let allowed: Vec<f64> = candidates.norms.iter().map(|n| error * error * n).collect();
        let (span, of) = candidates.reduced(error * REDUCED);
        let n = candidates.len();
        let waves = of.len() / n;
        let bins = span.len() / waves;
        let mut moments = vec![Complex64::ZERO; waves * waves];
        let conjugate: Vec<Complex64> = of.iter().map(Complex64::conj).collect();
        multiply((waves, waves, n), (&mut moments, waves), (&of, [1, waves]), (&conjugate, waves));
        let eigen = SymmetricEigen::new(DMatrix::from_row_slice(waves, waves, &moments));
        let mut order: Vec<usize> = (0..waves).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        // (wave of the span, component)
        let at = |j: usize| order.iter().map(move |&l| (j, l));
        let components: Vec<Complex64> =
            (0..waves).flat_map(at).map(|at| eigen.eigenvectors[at]).collect();
        let conjugate: Vec<Complex64> = components.iter().map(Complex64::conj).collect();
        let mut on = vec![Complex64::ZERO; n * waves];
        multiply((n, waves, waves), (&mut on, waves), (&of, [waves, 1]), (&conjugate, waves));
        let kept = fewest(&on, waves, &candidates.norms, &allowed);
        let mut chosen = vec![Complex64::ZERO; kept * bins];
        multiply(
            (kept, bins, waves),
            (&mut chosen, bins),
            (&components, [1, waves]),
            (&span, bins),
        );
        let back = |wave: &[Complex64]| -> Vec<Complex32> {
            probes[0].pad_window(wave).into_iter().map(|v| single(v.conj())).collect()
        };
        let project: Vec<Vec<Complex32>> = chosen.par_chunks_exact(bins).map(back).collect();
        let project = project.concat();
        Basis { waves: chosen.into_iter().map(single).collect(), project, bins }
    }

    /// Number of waves.
    pub fn len(&self) -> usize {
        self.waves.len() / self.bins
    }

    /// Fourier coefficients of wave `j` on the bins of the window.
    pub fn wave(&self, j: usize) -> &[Complex32] {
        &self.waves[j * self.bins..][..self.bins]
    }

    /// Coefficients on the waves, (wave, probe) row-major, of probes at these positions in the window (Angstrom).
    pub fn coefficients(
        &self,
        probe: &CroppedProbe,
        positions: &[(usize, [f64; 2])],
    ) -> Vec<Complex32> {
        let (n, around) = (positions.len(), probe.around.len());
        let mut spectra = vec![Complex32::ZERO; around * n];
        for (block, positions) in positions.chunks(TOGETHER).enumerate() {
            let [x, y] = phases_together(probe, positions);
            for (row, ((iy, ix), a)) in spectra.chunks_exact_mut(n).zip(&probe.around) {
                let (a, x, y) = (single(*a), &x[*ix], &y[*iy]);
                let row = &mut row[block * TOGETHER..][..positions.len()];
                row.iter_mut().zip(x.iter().zip(y)).for_each(|(to, (x, y))| *to = a * x * y);
            }
        }
        let mut out = vec![Complex32::ZERO; self.len() * n];
        let shape = (self.len(), n, around);
        multiply(shape, (&mut out, n), (&self.project, [around, 1]), (&spectra, n));
        out
    }
}

/// Number of probes whose spectra are written together: their values fill a cache line.
const TOGETHER: usize = 8;

/// Phases along x and y of at most [`TOGETHER`] probes: for each frequency, the value of each probe.
fn phases_together(
    probe: &CroppedProbe,
    positions: &[(usize, [f64; 2])],
) -> [Vec<[Complex32; TOGETHER]>; 2] {
    let mut together = [Vec::new(), Vec::new()];
    for (i, (_, position)) in positions.iter().enumerate() {
        for (to, phases) in together.iter_mut().zip(probe.phases(probe.offset(*position))) {
            to.resize(phases.len(), [Complex32::ZERO; TOGETHER]);
            to.iter_mut().zip(phases).for_each(|(to, phase)| to[i] = single(phase));
        }
    }
    together
}

/// The smallest number of leading components with which no candidate lacks more than `allowed` of its squared norm. `on` holds the
/// coefficients, (candidate, wave) row-major.
fn fewest(on: &[Complex64], waves: usize, norms: &[f64], allowed: &[f64]) -> usize {
    let needed = |(row, (norm, allowed)): (&[Complex64], (&f64, &f64))| {
        let mut left = *norm;
        let enough = row.iter().position(|c| {
            left -= c.norm_sqr();
            left <= *allowed
        });
        enough.map_or(waves, |i| i + 1)
    };
    let rows = on.chunks_exact(waves).zip(norms.iter().zip(allowed));
    rows.map(needed).max().unwrap_or(1)
}

/// Probes on a raster over a patch, denser towards its edges. The waves are chosen to represent them.
struct Candidates<'a> {
    /// The probe at each focus; all have equal bins.
    probes: &'a [&'a CroppedProbe],
    /// Phases along x and y, at the frequencies of the surroundings, for each position.
    phases: [Vec<Vec<Complex64>>; 2],
    /// Squared norms of the candidates in the window.
    norms: Vec<f64>,
}

impl<'a> Candidates<'a> {
    fn new(probes: &'a [&'a CroppedProbe], half: [f64; 2], step: f64) -> Self {
        let places = half.map(|half| {
            let n = (2.0 * half / step).ceil() as usize + 1;
            // Chebyshev points make the errors at the edges as small as inside.
            let place = |i: usize| match n {
                1 => 0.0,
                _ => half * (PI * (i as f64 / (n - 1) as f64 - 0.5)).sin(),
            };
            (0..n).map(place).collect::<Vec<f64>>()
        });
        let phases = [0, 1].map(|k| {
            let at = |x: &f64| probes[0].phases([*x; 2])[k].clone();
            places[k].iter().map(at).collect()
        });
        let mut candidates = Candidates { probes, phases, norms: Vec::new() };
        let norm = |i| candidates.get(i).iter().map(Complex64::norm_sqr).sum();
        candidates.norms = (0..candidates.len()).into_par_iter().map(norm).collect();
        candidates
    }

    fn positions(&self) -> usize {
        self.phases[0].len() * self.phases[1].len()
    }

    fn len(&self) -> usize {
        self.probes.len() * self.positions()
    }

    /// Coefficients of candidate `i` on the bins of the window.
    fn get(&self, i: usize) -> Vec<Complex64> {
        let (columns, position) = (self.phases[0].len(), i % self.positions());
        let probe = self.probes[i / self.positions()];
        probe.moved(&self.phases[0][position % columns], &self.phases[1][position / columns])
    }

    /// The products `sum wave* v` in the window with all candidates v.
    fn project(&self, wave: &[Complex64]) -> Vec<Complex64> {
        let wave = self.probes[0].pad_window(wave);
        let columns = self.phases[0].len();
        let mut out = vec![Complex64::ZERO; self.len()];
        let mut sums = vec![Complex64::ZERO; columns];
        for (probe, out) in self.probes.iter().zip(out.chunks_exact_mut(self.positions())) {
            let mut wave = wave.iter();
            for row in probe.around.chunk_by(|a, b| a.0.0 == b.0.0) {
                let weighted: Vec<Complex64> =
                    row.iter().zip(wave.by_ref()).map(|(bin, w)| w.conj() * bin.1).collect();
                for (sum, phases) in sums.iter_mut().zip(&self.phases[0]) {
                    let at = row.iter().map(|bin| phases[bin.0.1]);
                    *sum = weighted.iter().zip(at).map(|(w, p)| w * p).sum();
                }
                for (line, phases) in out.chunks_exact_mut(columns).zip(&self.phases[1]) {
                    let phase = phases[row[0].0.0];
                    line.iter_mut().zip(&sums).for_each(|(to, sum)| *to += sum * phase);
                }
            }
        }
        out
    }

    /// Orthonormal waves, (wave, bin) row-major, that represent all candidates up to the share `error` of their amplitude, and the
    /// candidates' coefficients, (candidate, wave) row-major. Each wave is made from the candidate that the waves before it represent
    /// worst.
    fn reduced(&self, error: f64) -> (Vec<Complex64>, Vec<Complex64>) {
        let bins = self.get(0).len();
        let mut span: Vec<Complex64> = Vec::new();
        let mut of: Vec<Vec<Complex64>> = Vec::new();
        let mut left = vec![1.0; self.len()];
        while of.len() < bins.min(self.len()) {
            let worst = (0..left.len()).fold(0, |w, i| if left[i] > left[w] { i } else { w });
            if left[worst] <= error * error {
                break;
            }
            let mut wave = self.get(worst);
            // Orthogonalised twice, because of rounding.
            for q in span.chunks_exact(bins).chain(span.chunks_exact(bins)) {
                let c: Complex64 = q.iter().zip(&wave).map(|(q, w)| q.conj() * w).sum();
                wave.iter_mut().zip(q).for_each(|(w, q)| *w -= c * q);
            }
            let norm = wave.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
            wave.iter_mut().for_each(|w| *w /= norm);
            let on = self.project(&wave);
            let lost = on.iter().zip(&self.norms).map(|(c, norm)| c.norm_sqr() / norm);
            left.iter_mut().zip(lost).for_each(|(l, c)| *l -= c);
            span.extend(wave);
            of.push(on);
        }
        let by_candidate = (0..self.len()).flat_map(|c| of.iter().map(move |on| on[c])).collect();
        (span, by_candidate)
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::Plan;
    use super::super::probe::Probe;
    use super::super::{Algorithm, Settings};
    use super::*;

    /// Measures probes between the positions by which waves are chosen: at most 1.02 % where 1 % is allowed.
    #[test]
    fn probes_are_held_as_well_as_asked() {
        let algorithm = Algorithm::Window { width_angstrom: 7.8 };
        let settings = Settings { algorithm, ..Settings::default() };
        let plan = Plan::new(&settings, [31.2, 31.2, 2.0], &[1.0]).unwrap();
        let probe = Probe::new(&plan);
        let cropped = probe.cropped().unwrap();
        let (half, error) = ([1.6, 1.2], 0.01);
        let basis = Basis::new(&[cropped], half, 0.6, error);
        let middle = cropped.offset([0.0; 2]).map(|x| -x);
        let place =
            |i: usize| (i, [0, 1].map(|k| middle[k] + half[k] * (0.77 * (i + 9 * k) as f64).sin()));
        let positions: Vec<_> = (0..40).map(place).collect();
        let coefficients = basis.coefficients(cropped, &positions);
        let mut worst = 0.0_f32;
        for (i, position) in &positions {
            let mut left = probe.at(&plan, *position);
            let norm: f32 = left.iter().map(Complex32::norm_sqr).sum();
            for j in 0..basis.len() {
                let c = coefficients[j * positions.len() + i];
                left.iter_mut().zip(basis.wave(j)).for_each(|(l, w)| *l -= c * w);
            }
            let lacks: f32 = left.iter().map(Complex32::norm_sqr).sum();
            worst = worst.max((lacks / norm).sqrt());
        }
        assert!(worst > 0.3 * error as f32 && worst < 1.1 * error as f32, "{worst}");
        // 22 waves by the areas of patch and aperture, and more for the edges of the patch; 52 measured.
        assert!((45..58).contains(&basis.len()), "{}", basis.len());
    }
}
