//! From the atoms of a slice to the Fourier coefficients of its band-limited `exp(i sigma V)`.

use super::plan::{Grid, Plan};
use super::transmission::{crop_spectrum, disk_reach};
use crate::constants::interaction_parameter;
use crate::error::Result;
use crate::fft::{Buffer, Scratch};
use crate::potential::cores::{CoreScratch, Cores};
use crate::potential::projected::{PlacedAtom, Projector, ProjectorScratch, Shape};
use num_complex::Complex32;

/// Exponentiates potentials on one grid.
pub(super) struct Exponential {
    grid: Grid,
    projector: Projector,
    /// What smoothing takes from the potentials, if they are smoothed.
    cores: Option<Cores>,
    sigma: f32,
}

/// One thread's arrays.
pub(super) struct Workspace {
    potential: Buffer,
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
        Ok(Exponential { grid, projector, cores, sigma: sigma as f32 })
    }

    /// Whether the atoms of a slice are far enough apart.
    pub fn suits(&self, atoms: &[PlacedAtom]) -> bool {
        self.cores.as_ref().is_none_or(|cores| cores.suits(atoms))
    }

    pub fn workspace(&self) -> Workspace {
        Workspace {
            potential: self.projector.fft().buffer(),
            projector: self.projector.scratch(),
            fft: self.projector.fft().scratch(),
            cores: Vec::new(),
            core_scratch: CoreScratch::default(),
        }
    }

    /// Calls `put((iy, ix) on the transmission grid, coefficient)` for every frequency in the disk.
    pub fn coefficients(
        &self,
        plan: &Plan,
        atoms: SliceAtoms<'_>,
        w: &mut Workspace,
        mut put: impl FnMut((usize, usize), Complex32),
    ) {
        match atoms {
            SliceAtoms::Whole(atoms) => {
                self.projector.infinite(atoms, &mut w.potential, &mut w.projector);
            }
            SliceAtoms::Parts { all, slice } => {
                let (out, scratch) = (&mut w.potential, &mut w.projector);
                self.projector.finite(all, &plan.slices, slice, out, scratch);
            }
        }
        self.transform(plan.band_limit, w);
        let (ny, nx) = self.projector.fft().shape();
        let stride = self.projector.fft().stride();
        // Divided, not multiplied by a rounded reciprocal: vacuum then transmits exactly 1.
        let pixels = (nx * ny) as f32;
        let disk = plan.disk();
        let points = plan.transmission_grid.points;
        let weight = |k: [f64; 2]| disk.weight(k[0] * k[0] + k[1] * k[1]) as f32;
        let data = &w.potential;
        let (Some(cores), SliceAtoms::Whole(atoms)) = (&self.cores, atoms) else {
            crop_spectrum(&self.grid, points, plan.band_limit, |a, b, k| {
                put(b, data[a.0 * stride + a.1] / pixels * weight(k));
            });
            return;
        };
        cores.add(atoms, &mut w.cores, &mut w.core_scratch);
        let (rows, columns) = cores.shape();
        // Frequency 0 is in the middle there.
        let middle =
            |i: usize, n: usize, m: usize| if i <= m / 2 { i + m / 2 } else { i + m / 2 - n };
        crop_spectrum(&self.grid, points, plan.band_limit, |a, b, k| {
            let core = w.cores[middle(a.0, ny, rows) * columns + middle(a.1, nx, columns)];
            put(b, (data[a.0 * stride + a.1] / pixels + core) * weight(k));
        });
    }

    /// The potential in `w` becomes the transform of its exponential, in the columns of the band.
    fn transform(&self, band_limit: f64, w: &mut Workspace) {
        let fft = self.projector.fft();
        let (ny, nx) = fft.shape();
        let data = &mut w.potential;
        let arch = pulp::Arch::new();
        for row in data.chunks_exact_mut(fft.stride()).take(ny) {
            arch.dispatch(|| {
                for v in &mut row[..nx] {
                    *v = exp_i(self.sigma * v.re);
                }
            });
        }
        fft.all_rows(data, false, &mut w.fft);
        let limit = (band_limit * self.grid.extent_angstrom[0]) as usize;
        for range in fft.band_columns(limit.min(nx / 2)) {
            fft.some_columns(data, range, false, &mut w.fft);
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
