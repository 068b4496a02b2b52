//! Transmission functions `exp(i sigma V)` of all slices, band-limited.

use super::Site;
use super::exponential::{self, Exponential, SliceAtoms};
use super::occupancy::{Occupancy, place};
use super::plan::{Grid, Plan};
use super::spare::Spare;
use crate::error::{Error, Result};
use crate::fft::radix::lanes;
use crate::fft::{Buffer, Fft2, Scratch};
use crate::potential::projected::{PlacedAtom, Projection};
use crate::progress::Progress;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// Transmission functions of all slices.
pub(super) struct Transmission {
    /// `None` where no atom is, so that waves pass in one step.
    pub slices: Vec<Option<Buffer>>,
    pub layout: Layout,
    pub occupancy: Occupancy,
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
    elements: Vec<u8>,
    usual: Exponential,
    /// For slices with atoms too close for [`crate::potential::cores`]; made when first needed.
    oversampled: OnceLock<Exponential>,
    /// Transform of the transmission grid, over the whole cell.
    coarse: Fft2,
    layout: Layout,
}

/// One thread's arrays.
struct Workspace {
    usual: exponential::Workspace,
    oversampled: Option<exponential::Workspace>,
    coarse: Scratch,
}

impl<'a> TransmissionBuilder<'a> {
    pub fn new(plan: &'a Plan, elements: &[u8]) -> Result<Self> {
        let usual = Exponential::new(plan, plan.potential_grid, plan.core_cutoff, elements)?;
        let (ny, nx) = plan.transmission_grid.shape();
        let layout = if plan.wave_grid == plan.transmission_grid {
            Layout::Arranged
        } else {
            // An odd number of 128-byte lines: rows then fall into different cache sets.
            let most = nx + plan.wave_grid.points[0] + lanes();
            Layout::Padded { stride: (most.div_ceil(16) | 1) * 16 }
        };
        let elements = elements.to_vec();
        let (oversampled, coarse) = (OnceLock::new(), Fft2::new(ny, nx));
        Ok(TransmissionBuilder { plan, elements, usual, oversampled, coarse, layout })
    }

    /// The transmission functions of one phonon configuration.
    pub fn build(
        &self,
        sites: &[Site],
        configuration: u32,
        progress: &dyn Progress,
    ) -> Result<Transmission> {
        let by_slice = place(self.plan, sites, configuration);
        let all: Vec<PlacedAtom> = by_slice.iter().flatten().copied().collect();
        let too_close: Vec<bool> = by_slice.par_iter().map(|s| !self.usual.suits(s)).collect();
        if self.oversampled.get().is_none() && too_close.contains(&true) {
            let grid = self.plan.oversampled_grid();
            let made = Exponential::new(self.plan, grid, None, &self.elements)?;
            self.oversampled.get_or_init(|| made);
        }
        let workspace = || Workspace {
            usual: self.usual.workspace(),
            oversampled: self.oversampled.get().map(Exponential::workspace),
            coarse: self.coarse.scratch(),
        };
        let spare = Spare::new();
        let slices: Result<Vec<Option<Buffer>>> = (0..by_slice.len())
            .into_par_iter()
            .map(|i| {
                if progress.interrupted() {
                    return Err(Error::Interrupted);
                }
                let atoms = match self.plan.settings.projection {
                    Projection::Infinite if by_slice[i].is_empty() => return Ok(None),
                    Projection::Infinite => SliceAtoms::Whole(&by_slice[i]),
                    Projection::Finite => SliceAtoms::Parts { all: &all, slice: i },
                };
                Ok(Some(spare.with(workspace, |w| self.slice(atoms, too_close[i], w))))
            })
            .collect();
        let occupancy = Occupancy::new(self.plan, &by_slice);
        Ok(Transmission { slices: slices?, layout: self.layout, occupancy })
    }

    /// One band-limited transmission function.
    fn slice(&self, atoms: SliceAtoms<'_>, too_close: bool, w: &mut Workspace) -> Buffer {
        let mut t = self.coarse.buffer();
        let stride = self.coarse.stride();
        let put = |(iy, ix): (usize, usize), value| t[iy * stride + ix] = value;
        match (self.oversampled.get(), &mut w.oversampled) {
            (Some(fine), Some(w)) if too_close => fine.coefficients(self.plan, atoms, w, put),
            _ => self.usual.coefficients(self.plan, atoms, &mut w.usual, put),
        }
        self.coarse.inverse(&mut t, &mut w.coarse);
        match self.layout {
            Layout::Arranged => self.arranged(&t),
            Layout::Padded { stride } => self.padded(&t, stride),
        }
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
}

impl Transmission {
    /// Those of some slices that hold atoms.
    pub fn filled(&self, slices: Range<usize>) -> impl Iterator<Item = usize> {
        slices.filter(|&i| self.slices[i].is_some())
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
    let reach = disk_reach(grid, points, limit).map(|n| n as i64);
    // Frequencies are below n / 2: no division.
    let bin = |f: i64, n: usize| (if f < 0 { f + n as i64 } else { f }) as usize;
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

/// Largest frequency (x, y) that [`crop_spectrum`] visits.
pub(super) fn disk_reach(grid: &Grid, points: [usize; 2], limit: f64) -> [usize; 2] {
    let dk = grid.dk();
    [0, 1].map(|i| {
        let most = (grid.points[i].min(points[i]) - 1) / 2;
        ((limit / dk[i]) as usize).min(most)
    })
}
