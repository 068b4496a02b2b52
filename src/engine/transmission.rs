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
    spare: Spare<Workspace>,
    /// Arrays of transmission functions that are no longer needed.
    free: Spare<Buffer>,
}

/// One thread's arrays.
struct Workspace {
    usual: exponential::Workspace,
    oversampled: Option<exponential::Workspace>,
    wave: Buffer,
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
        let (spare, free) = (Spare::new(), Spare::new());
        Ok(TransmissionBuilder { plan, elements, usual, oversampled, coarse, layout, spare, free })
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
            oversampled: None,
            wave: self.coarse.buffer(),
            coarse: self.coarse.scratch(),
        };
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
                Ok(Some(self.spare.with(workspace, |w| self.slice(atoms, too_close[i], w))))
            })
            .collect();
        let occupancy = Occupancy::new(self.plan, &by_slice);
        Ok(Transmission { slices: slices?, layout: self.layout, occupancy })
    }

    /// Takes back the arrays of transmission functions, for the next configuration.
    pub fn reclaim(&self, transmission: Transmission) {
        self.free.give(transmission.slices.into_iter().flatten());
    }

    /// An array of `len` elements, whose contents do not matter.
    fn array(&self, len: usize) -> Buffer {
        self.free.take(|| Buffer::zeros(len))
    }

    /// One band-limited transmission function.
    fn slice(&self, atoms: SliceAtoms<'_>, too_close: bool, w: &mut Workspace) -> Buffer {
        let fft = &self.coarse;
        let (exponential, inner) = match self.oversampled.get().filter(|_| too_close) {
            Some(fine) => (fine, w.oversampled.get_or_insert_with(|| fine.workspace())),
            None => (&self.usual, &mut w.usual),
        };
        w.wave.fill(Complex32::ZERO);
        exponential.coefficients(self.plan, atoms, inner, (fft, &mut w.wave));
        for columns in fft.band_columns(exponential.reach()[0]) {
            fft.some_columns(&mut w.wave, columns, true, &mut w.coarse);
        }
        fft.all_rows(&mut w.wave, true, &mut w.coarse);
        match self.layout {
            Layout::Arranged => self.arranged(&w.wave),
            Layout::Padded { stride } => self.padded(&w.wave, stride),
        }
    }

    fn arranged(&self, t: &[Complex32]) -> Buffer {
        let (fft, rows) = (&self.coarse, lanes());
        let len = fft.arranged_len();
        let mut out = self.array(fft.row_blocks() * len);
        for (b, block) in out.chunks_exact_mut(len).take(fft.row_blocks()).enumerate() {
            fft.arrange_block(&t[b * rows * fft.stride()..], fft.stride(), block);
        }
        out
    }

    fn padded(&self, t: &[Complex32], stride: usize) -> Buffer {
        let (ny, nx) = self.coarse.shape();
        let rows = ny + self.plan.wave_grid.points[1] + lanes();
        let mut out = self.array(rows * stride);
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

/// Largest frequency (x, y) within `limit` (1/Angstrom) that `grid` and another one, of `points` over the same extent,
/// both hold.
pub(super) fn disk_reach(grid: &Grid, points: [usize; 2], limit: f64) -> [usize; 2] {
    let dk = grid.dk();
    [0, 1].map(|i| {
        let most = (grid.points[i].min(points[i]) - 1) / 2;
        ((limit / dk[i]) as usize).min(most)
    })
}
