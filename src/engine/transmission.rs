//! Transmission functions `exp(i sigma V)` of all slices, band-limited.

use super::Site;
use super::plan::{Grid, Plan};
use crate::constants::interaction_parameter;
use crate::error::{Error, Result};
use crate::fft::radix::lanes;
use crate::fft::{Buffer, Fft2, Scratch};
use crate::phonons::displaced;
use crate::potential::projected::{PlacedAtom, Projection, Projector, ProjectorScratch};
use crate::progress::Progress;
use num_complex::Complex32;
use rayon::prelude::*;

/// Transmission functions of all slices.
pub(super) struct Transmission {
    /// `None` where no atom is, so that waves pass in one step.
    pub slices: Vec<Option<Buffer>>,
    pub layout: Layout,
}

/// How a transmission function is stored.
#[derive(Debug, Clone, Copy)]
pub(super) enum Layout {
    /// In blocks of rows as [`Fft2::arrange_block`] makes them, for waves over the whole cell.
    Arranged,
    /// Row by row, going on periodically beyond the cell, so that no window leaves the array.
    Padded {
        /// Elements from row to row.
        stride: usize,
    },
}

/// Makes transmission functions for one plan.
pub(super) struct TransmissionBuilder<'a> {
    plan: &'a Plan,
    projector: Projector,
    /// Transform of the transmission grid, over the whole cell.
    coarse: Fft2,
    layout: Layout,
    sigma: f32,
}

/// One thread's arrays.
struct Workspace {
    potential: Buffer,
    projector: ProjectorScratch,
    fine: Scratch,
    coarse: Scratch,
}

impl<'a> TransmissionBuilder<'a> {
    pub fn new(plan: &'a Plan, elements: &[u8]) -> Result<Self> {
        let grid = &plan.potential_grid;
        let settings = &plan.settings;
        let (shape, extent) = (grid.shape(), grid.extent_angstrom);
        let sharpen = settings.abtem_pixel_correction;
        let projector = Projector::new(shape, extent, settings.parametrization, elements, sharpen)?;
        let (ny, nx) = plan.transmission_grid.shape();
        let sigma = interaction_parameter(settings.optics.energy_ev) as f32;
        let layout = if plan.wave_grid == plan.transmission_grid {
            Layout::Arranged
        } else {
            // An odd number of 128-byte lines: rows then fall into different cache sets.
            let most = nx + plan.wave_grid.points[0] + lanes();
            Layout::Padded { stride: (most.div_ceil(16) | 1) * 16 }
        };
        Ok(TransmissionBuilder { plan, projector, coarse: Fft2::new(ny, nx), layout, sigma })
    }

    /// The transmission functions of one phonon configuration.
    pub fn build(
        &self,
        sites: &[Site],
        configuration: u32,
        progress: &dyn Progress,
    ) -> Result<Transmission> {
        let by_slice = self.place(sites, configuration);
        let all: Vec<PlacedAtom> = by_slice.iter().flatten().copied().collect();
        let workspace = || Workspace {
            potential: self.projector.fft().buffer(),
            projector: self.projector.scratch(),
            fine: self.projector.fft().scratch(),
            coarse: self.coarse.scratch(),
        };
        let slices: Result<Vec<Option<Buffer>>> = (0..by_slice.len())
            .into_par_iter()
            .map_init(workspace, |w, i| {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                match self.plan.settings.projection {
                    Projection::Infinite => {
                        if by_slice[i].is_empty() {
                            return Ok(None);
                        }
                        self.projector.infinite(&by_slice[i], &mut w.potential, &mut w.projector);
                    }
                    Projection::Finite => {
                        let slices = &self.plan.slices;
                        self.projector.finite(&all, slices, i, &mut w.potential, &mut w.projector);
                    }
                }
                let t = self.transmission(w);
                Ok(Some(match self.layout {
                    Layout::Arranged => self.arranged(&t),
                    Layout::Padded { stride } => self.padded(&t, stride),
                }))
            })
            .collect();
        Ok(Transmission { slices: slices?, layout: self.layout })
    }

    fn arranged(&self, t: &[Complex32]) -> Buffer {
        let (fft, rows) = (&self.coarse, lanes());
        let len = fft.arranged_len();
        let mut out = Buffer::zeros(fft.row_blocks() * len);
        for (b, block) in out.chunks_exact_mut(len).take(fft.row_blocks()).enumerate() {
            fft.arrange_block(&t[b * rows * fft.stride()..], fft.stride(), block);
        }
        out
    }

    fn padded(&self, t: &[Complex32], stride: usize) -> Buffer {
        let (ny, nx) = self.coarse.shape();
        let rows = ny + self.plan.wave_grid.points[1] + lanes();
        let mut out = Buffer::zeros(rows * stride);
        for (y, row) in out.chunks_exact_mut(stride).take(rows).enumerate() {
            let source = &t[y % ny * self.coarse.stride()..][..nx];
            row.chunks_mut(nx).for_each(|part| part.copy_from_slice(&source[..part.len()]));
        }
        out
    }

    /// Displaces the atoms and sorts them into slices.
    fn place(&self, sites: &[Site], configuration: u32) -> Vec<Vec<PlacedAtom>> {
        let slices = &self.plan.slices;
        let mut by_slice = vec![Vec::new(); slices.len()];
        for site in sites {
            let position = match self.plan.settings.phonons {
                Some(p) => displaced(site, p.seed, configuration),
                None => site.position,
            };
            // Wrapped by the mean height: a site near a face must not jump to the other one.
            let z = slices.wrap(site.position[2]) + (position[2] - site.position[2]);
            let position = [position[0], position[1], z];
            by_slice[slices.index(z)].push(PlacedAtom { position, number: site.number });
        }
        by_slice
    }

    /// From the potential in `w` to the band-limited transmission function.
    fn transmission(&self, w: &mut Workspace) -> Buffer {
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
        fft.all_rows(data, false, &mut w.fine);
        let limit = (self.plan.band_limit * self.plan.potential_grid.extent_angstrom[0]) as usize;
        for range in fft.band_columns(limit) {
            fft.some_columns(data, range, false, &mut w.fine);
        }
        let mut out = self.coarse.buffer();
        let points = self.plan.transmission_grid.points;
        let (from, to) = (fft.stride(), self.coarse.stride());
        // Divided, not multiplied by a rounded reciprocal: vacuum then transmits exactly 1.
        let pixels = (nx * ny) as f32;
        let disk = self.plan.disk();
        crop_spectrum(&self.plan.potential_grid, points, self.plan.band_limit, |a, b, k| {
            let weight = disk.weight(k[0] * k[0] + k[1] * k[1]) as f32;
            out[b.0 * to + b.1] = data[a.0 * from + a.1] / pixels * weight;
        });
        self.coarse.inverse(&mut out, &mut w.coarse);
        out
    }
}

/// Calls `copy((iy, ix) on grid, (iy, ix) on the other grid, k)` for every frequency inside the disk
/// of radius `limit` (1/Angstrom). The other grid, of `points` (x, y) over the same extent, must
/// hold the disk.
pub(super) fn crop_spectrum(
    grid: &Grid,
    points: [usize; 2],
    limit: f64,
    mut copy: impl FnMut((usize, usize), (usize, usize), [f64; 2]),
) {
    let dk = grid.dk();
    let reach = [0, 1].map(|i| {
        let most = (grid.points[i].min(points[i]) as i64 - 1) / 2;
        ((limit / dk[i]) as i64).min(most)
    });
    let bin = |f: i64, n: usize| f.rem_euclid(n as i64) as usize;
    for fy in -reach[1]..=reach[1] {
        for fx in -reach[0]..=reach[0] {
            let k = [fx as f64 * dk[0], fy as f64 * dk[1]];
            if k[0] * k[0] + k[1] * k[1] < limit * limit {
                let a = (bin(fy, grid.points[1]), bin(fx, grid.points[0]));
                let b = (bin(fy, points[1]), bin(fx, points[0]));
                copy(a, b, k);
            }
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
