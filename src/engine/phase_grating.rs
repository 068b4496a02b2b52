//! The phase grating of a slice: Fourier coefficients of its band-limited `exp(i sigma V)`, from its atoms.

use super::grid::Grid;
use super::plan::Plan;
use crate::constants::interaction_parameter;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, Scratch};
use crate::potential::cores::{CoreScratch, Cores};
use crate::potential::projected::{PlacedAtom, PotentialFilter, Projector, ProjectorScratch};
use crate::simd::vectorised;
use num_complex::Complex32;

/// Makes phase gratings on one grid of potentials.
pub(super) struct PhaseGrating {
    projector: Projector,
    /// The cores that smoothing removes from the potentials; `None` if they are not smoothed.
    cores: Option<Cores>,
    sigma: f32,
    /// Frequencies `-reach..=reach` (x, y) contain the band limit.
    reach: [usize; 2],
    /// Weights of the anti-aliasing aperture at these frequencies: rows of ky, columns of kx, from the most negative frequency.
    weights: Vec<f32>,
}

/// One thread's arrays.
pub(super) struct GratingWorkspace {
    /// Holds the potential, then its exponential, then the exponential's transform.
    data: Buffer,
    projector: ProjectorScratch,
    fft: Scratch,
    cores: Vec<Complex32>,
    core_scratch: CoreScratch,
}

/// The atoms whose potential makes a slice.
#[derive(Clone, Copy)]
pub(super) enum SliceAtoms<'a> {
    /// Atoms that belong to the slice wholly.
    Whole(&'a [PlacedAtom]),
    /// All atoms; the parts of them inside the slice count.
    Parts { all: &'a [PlacedAtom], slice: usize },
}

impl PhaseGrating {
    /// Prepares the potentials. With `core_cutoff` (1/Angstrom) they are smoothed and cores are added in closed form. Without it they are
    /// exponentiated on the grid unsmoothed.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`] for an element that the tables lack.
    pub fn new(plan: &Plan, grid: Grid, core_cutoff: Option<f64>, elements: &[u8]) -> Result<Self> {
        let (settings, extent) = (&plan.settings, grid.extent_angstrom);
        let shape = match core_cutoff {
            Some(cutoff) => PotentialFilter::Smoothed { cutoff },
            None if settings.abtem_placement => PotentialFilter::AbtemPlacement,
            None => PotentialFilter::AsIs,
        };
        let table = settings.parametrization;
        let projector = Projector::new(grid.shape(), extent, table, elements, shape)?;
        let sigma = interaction_parameter(settings.optics.energy_ev());
        let reach = grid.common_reach(plan.transmission_grid.points, plan.band_limit);
        let cores = core_cutoff
            .map(|cutoff| Cores::new(table, elements, extent, reach, cutoff, sigma))
            .transpose()?;
        let weight = |fy: i64, fx: i64| {
            let [kx, ky] = [fx as f64 / extent[0], fy as f64 / extent[1]];
            plan.anti_aliasing().weight(kx * kx + ky * ky) as f32
        };
        let [rx, ry] = reach.map(|n| n as i64);
        let weights = (-ry..=ry).flat_map(|fy| (-rx..=rx).map(move |fx| weight(fy, fx))).collect();
        Ok(PhaseGrating { projector, cores, sigma: sigma as f32, reach, weights })
    }

    /// Whether the atoms of a slice are far enough apart for the closed form of their cores.
    pub fn suits(&self, atoms: &[PlacedAtom]) -> bool {
        self.cores.as_ref().is_none_or(|cores| cores.suits(atoms))
    }

    pub fn workspace(&self) -> GratingWorkspace {
        GratingWorkspace {
            data: self.projector.fft().buffer(),
            projector: self.projector.scratch(),
            fft: self.projector.fft().scratch(),
            cores: Vec::new(),
            core_scratch: CoreScratch::default(),
        }
    }

    /// The largest frequency index (x, y) of the coefficients.
    pub fn reach(&self) -> [usize; 2] {
        self.reach
    }

    /// Writes the coefficients within [`PhaseGrating::reach`] to `out`, an array of `fft` in FFT order. Other elements are not changed.
    pub fn coefficients(
        &self,
        plan: &Plan,
        atoms: SliceAtoms<'_>,
        w: &mut GratingWorkspace,
        fft: &Fft2,
        out: &mut [Complex32],
    ) {
        match atoms {
            SliceAtoms::Whole(atoms) => {
                self.projector.infinite(atoms, &mut w.data, &mut w.projector);
            }
            SliceAtoms::Parts { all, slice } => {
                let (out, scratch) = (&mut w.data, &mut w.projector);
                self.projector.finite(all, &plan.slices, slice, out, scratch);
            }
        }
        self.transform(w);
        match (&self.cores, atoms) {
            (Some(cores), SliceAtoms::Whole(atoms)) => {
                cores.add(atoms, &mut w.cores, &mut w.core_scratch);
            }
            _ => {
                w.cores.clear();
                w.cores.resize(self.weights.len(), Complex32::ZERO);
            }
        }
        self.add_cores(w, fft, out);
    }

    /// Adds the cores to the transform in `w`, limits the band, and writes the coefficients to `out`.
    fn add_cores(&self, w: &GratingWorkspace, fft: &Fft2, out: &mut [Complex32]) {
        let from = self.projector.fft();
        let [rx, ry] = self.reach;
        let wide = 2 * rx + 1;
        // Division instead of a rounded reciprocal: vacuum then transmits exactly 1.
        let pixels = (from.shape().0 * from.shape().1) as f32;
        let bin = |i: usize, n: usize, reach: usize| (i + n - reach) % n;
        for i in 0..=2 * ry {
            let source = &w.data[bin(i, from.shape().0, ry) * from.stride()..];
            let target = &mut out[bin(i, fft.shape().0, ry) * fft.stride()..];
            let at = i * wide;
            let (cores, weights) = (&w.cores[at..][..wide], &self.weights[at..][..wide]);
            // Negative frequencies and the others are apart in FFT order.
            for (first, count) in [(0, rx), (rx, rx + 1)] {
                let source = &source[bin(first, from.shape().1, rx)..][..count];
                let target = &mut target[bin(first, fft.shape().1, rx)..][..count];
                let (cores, weights) = (&cores[first..][..count], &weights[first..][..count]);
                vectorised(
                    #[inline(always)]
                    || {
                        for k in 0..count {
                            target[k].re = (source[k].re / pixels + cores[k].re) * weights[k];
                            target[k].im = (source[k].im / pixels + cores[k].im) * weights[k];
                        }
                    },
                );
            }
        }
    }

    /// Replaces the potential in `w` by the transform of its exponential, in the columns within the band limit.
    fn transform(&self, w: &mut GratingWorkspace) {
        let fft = self.projector.fft();
        let ((ny, nx), stride) = (fft.shape(), fft.stride());
        let mut pair = vec![Complex32::ZERO; nx];
        // A row of the array holds two rows of the potential. Starting from the last, none is overwritten before
        // it is read.
        for r in (0..ny.div_ceil(2)).rev() {
            pair.copy_from_slice(&w.data[r * stride..][..nx]);
            let (upper, lower) = w.data[2 * r * stride..].split_at_mut(stride);
            let lower = if 2 * r + 1 < ny { &mut lower[..nx] } else { &mut [] };
            vectorised(
                #[inline(always)]
                || {
                    for (v, potential) in upper.iter_mut().zip(&pair) {
                        *v = exp_i(self.sigma * potential.re);
                    }
                    for (v, potential) in lower.iter_mut().zip(&pair) {
                        *v = exp_i(self.sigma * potential.im);
                    }
                },
            );
        }
        fft.all_rows(&mut w.data, false, &mut w.fft);
        for range in fft.band_columns(self.reach[0]) {
            fft.some_columns(&mut w.data, range, false, &mut w.fft);
        }
    }
}

/// `exp(i phase)` to 1e-7 for |phase| below 1e3: reduction by pi/2 in three parts and polynomials
/// (S. L. Moshier's Cephes coefficients). Branch-free, so that loops over it vectorise.
#[inline]
fn exp_i(phase: f32) -> Complex32 {
    let n = (phase * std::f32::consts::FRAC_2_PI).round_ties_even();
    let r = ((phase - n * 1.570_312_5) - n * 4.837_513e-4) - n * 7.549_79e-8;
    let r2 = r * r;
    let sin = ((-1.951_529_6e-4 * r2 + 8.332_161e-3) * r2 - 0.166_666_55) * r2 * r + r;
    let cos =
        ((2.443_315_7e-5 * r2 - 1.388_731_6e-3) * r2 + 4.166_664_6e-2) * r2 * r2 - 0.5 * r2 + 1.0;
    let quadrant = n as i32;
    let (s, c) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let c = if (quadrant + 1) & 2 == 0 { c } else { -c };
    let s = if quadrant & 2 == 0 { s } else { -s };
    Complex32::new(c, s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomial_exponential_is_accurate() {
        for i in -40_000..40_000 {
            let x = i as f32 * 7.3e-4;
            let exact = (f64::from(x).cos(), f64::from(x).sin());
            let v = exp_i(x);
            let error = (f64::from(v.re) - exact.0).hypot(f64::from(v.im) - exact.1);
            assert!(error < 2e-7, "{x}: {error}");
        }
    }
}
