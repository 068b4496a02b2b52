//! From the atoms of a slice to the Fourier coefficients of its band-limited `exp(i sigma V)`.

use super::plan::{Grid, Plan};
use super::transmission::disk_reach;
use crate::constants::interaction_parameter;
use crate::error::Result;
use crate::fft::{Buffer, Fft2, Scratch};
use crate::potential::cores::{CoreScratch, Cores};
use crate::potential::projected::{PlacedAtom, Projector, ProjectorScratch, Shape};
use crate::simd::vectorised;
use num_complex::Complex32;

/// Exponentiates potentials on one grid.
pub(super) struct Exponential {
    projector: Projector,
    /// What smoothing takes from the potentials, if they are smoothed.
    cores: Option<Cores>,
    sigma: f32,
    /// Frequencies `-reach..=reach` (x, y) hold the anti-aliasing disk.
    reach: [usize; 2],
    /// The disk there, rows of kx from the lowest frequency.
    disk: Vec<f32>,
}

/// One thread's arrays.
pub(super) struct Workspace {
    /// The potential, then its exponential, then the transform of that.
    data: Buffer,
    projector: ProjectorScratch,
    fft: Scratch,
    cores: Vec<Complex32>,
    core_scratch: CoreScratch,
}

/// Atoms that make a slice.
#[derive(Clone, Copy)]
pub(super) enum SliceAtoms<'a> {
    /// They belong to it wholly.
    Whole(&'a [PlacedAtom]),
    /// The parts of all atoms that lie in it.
    Parts { all: &'a [PlacedAtom], slice: usize },
}

impl Exponential {
    /// With `core_cutoff` (1/Angstrom), potentials are smoothed and cores put back; without, they are
    /// exponentiated as they are on the grid.
    pub fn new(plan: &Plan, grid: Grid, core_cutoff: Option<f64>, elements: &[u8]) -> Result<Self> {
        let (settings, extent) = (&plan.settings, grid.extent_angstrom);
        let shape = match core_cutoff {
            Some(cutoff) => Shape::Smoothed { cutoff },
            None if settings.abtem_pixel_correction => Shape::AbtemPixelCorrection,
            None => Shape::AsIs,
        };
        let table = settings.parametrization;
        let projector = Projector::new(grid.shape(), extent, table, elements, shape)?;
        let sigma = interaction_parameter(settings.optics.energy_ev);
        let reach = disk_reach(&grid, plan.transmission_grid.points, plan.band_limit);
        let cores = core_cutoff
            .map(|cutoff| Cores::new(table, elements, extent, reach, cutoff, sigma))
            .transpose()?;
        let weight = |fy: i64, fx: i64| {
            let [kx, ky] = [fx as f64 / extent[0], fy as f64 / extent[1]];
            plan.disk().weight(kx * kx + ky * ky) as f32
        };
        let [rx, ry] = reach.map(|n| n as i64);
        let disk = (-ry..=ry).flat_map(|fy| (-rx..=rx).map(move |fx| weight(fy, fx))).collect();
        Ok(Exponential { projector, cores, sigma: sigma as f32, reach, disk })
    }

    /// Whether the atoms of a slice are far enough apart.
    pub fn suits(&self, atoms: &[PlacedAtom]) -> bool {
        self.cores.as_ref().is_none_or(|cores| cores.suits(atoms))
    }

    pub fn workspace(&self) -> Workspace {
        Workspace {
            data: self.projector.fft().buffer(),
            projector: self.projector.scratch(),
            fft: self.projector.fft().scratch(),
            cores: Vec::new(),
            core_scratch: CoreScratch::default(),
        }
    }

    /// Frequency (x, y) up to which there are coefficients.
    pub fn reach(&self) -> [usize; 2] {
        self.reach
    }

    /// Puts the coefficients within [`Exponential::reach`] into `out`, an array of `fft`.
    pub fn coefficients(
        &self,
        plan: &Plan,
        atoms: SliceAtoms<'_>,
        w: &mut Workspace,
        (fft, out): (&Fft2, &mut [Complex32]),
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
                w.cores.resize(self.disk.len(), Complex32::ZERO);
            }
        }
        let from = self.projector.fft();
        let [rx, ry] = self.reach;
        let wide = 2 * rx + 1;
        // Divided, not multiplied by a rounded reciprocal: vacuum then transmits exactly 1.
        let pixels = (from.shape().0 * from.shape().1) as f32;
        let bin = |i: usize, n: usize, reach: usize| (i + n - reach) % n;
        for i in 0..=2 * ry {
            let source = &w.data[bin(i, from.shape().0, ry) * from.stride()..];
            let target = &mut out[bin(i, fft.shape().0, ry) * fft.stride()..];
            let (cores, disk) = (&w.cores[i * wide..][..wide], &self.disk[i * wide..][..wide]);
            // the frequencies below 0, and the others
            for (first, count) in [(0, rx), (rx, rx + 1)] {
                let source = &source[bin(first, from.shape().1, rx)..][..count];
                let target = &mut target[bin(first, fft.shape().1, rx)..][..count];
                let (cores, disk) = (&cores[first..][..count], &disk[first..][..count]);
                vectorised(
                    #[inline(always)]
                    || {
                        for k in 0..count {
                            target[k].re = (source[k].re / pixels + cores[k].re) * disk[k];
                            target[k].im = (source[k].im / pixels + cores[k].im) * disk[k];
                        }
                    },
                );
            }
        }
    }

    /// The potential in `w` becomes the transform of its exponential, in the columns of the disk.
    fn transform(&self, w: &mut Workspace) {
        let fft = self.projector.fft();
        let ((ny, nx), stride) = (fft.shape(), fft.stride());
        let mut pair = vec![Complex32::ZERO; nx];
        // Pairs of rows are spread from the last on, so that none is overwritten before it is read.
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
