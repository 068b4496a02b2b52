//! Transmission functions `exp(i sigma V)` of all slices, band-limited.

use super::phase_grating::{GratingWorkspace, PhaseGrating, SliceAtoms};
use super::plan::Plan;
use super::slice_coverage::{LocalSlice, SliceCoverage, place};
use super::workspace_pool::WorkspacePool;
use crate::error::{Error, Result};
use crate::fft::lanes;
use crate::fft::{Buffer, Fft2, Scratch};
use crate::potential::projected::{PlacedAtom, Projection};
use crate::progress::Progress;
use crate::structure::Site;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// The transmission functions of all slices in one phonon configuration.
pub(super) struct Transmission {
    /// `None` for slices without atoms, which waves pass in one step.
    pub slices: Vec<Option<Buffer>>,
    pub layout: TransmissionLayout,
    pub coverage: SliceCoverage,
}

/// How a transmission function is stored.
#[derive(Debug, Clone, Copy)]
pub(super) enum TransmissionLayout {
    /// In blocks of rows as written by [`Fft2::arrange_block`], for waves over the whole cell.
    Arranged,
    /// Row by row, continued periodically beyond the cell, so that no window leaves the array.
    Padded {
        /// Elements from row to row.
        stride: usize,
    },
}

/// Makes transmission functions for one plan.
pub(super) struct TransmissionBuilder<'a> {
    plan: &'a Plan,
    elements: Vec<u8>,
    usual: PhaseGrating,
    /// For slices with atoms that are too close for [`crate::potential::cores`]; made when first needed.
    oversampled: OnceLock<PhaseGrating>,
    /// Transform of the transmission grid.
    coarse: Fft2,
    layout: TransmissionLayout,
    workspaces: WorkspacePool<TransmissionWorkspace>,
    /// Arrays of transmission functions of earlier configurations, which are overwritten.
    arrays: WorkspacePool<Buffer>,
}

/// One thread's arrays.
struct TransmissionWorkspace {
    usual: GratingWorkspace,
    oversampled: Option<GratingWorkspace>,
    wave: Buffer,
    coarse: Scratch,
}

impl<'a> TransmissionBuilder<'a> {
    pub fn new(plan: &'a Plan, elements: &[u8]) -> Result<Self> {
        let usual = PhaseGrating::new(plan, plan.potential_grid, plan.core_cutoff, elements)?;
        let (ny, nx) = plan.transmission_grid.shape();
        let layout = if !plan.has_windows() {
            TransmissionLayout::Arranged
        } else {
            // An odd number of 128-byte lines: rows then fall into different cache sets.
            let most = nx + plan.wave_grid.points[0] + lanes();
            TransmissionLayout::Padded { stride: (most.div_ceil(16) | 1) * 16 }
        };
        let elements = elements.to_vec();
        let (oversampled, coarse) = (OnceLock::new(), Fft2::new(ny, nx));
        Ok(TransmissionBuilder {
            plan,
            elements,
            usual,
            oversampled,
            coarse,
            layout,
            workspaces: WorkspacePool::new(),
            arrays: WorkspacePool::new(),
        })
    }

    /// The transmission functions of one phonon configuration.
    ///
    /// # Errors
    /// [`Error::Interrupted`], and [`crate::Error::UnknownElement`] for an element that the tables lack.
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
            let made = PhaseGrating::new(self.plan, grid, None, &self.elements)?;
            self.oversampled.get_or_init(|| made);
        }
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
                let make = || self.workspace();
                Ok(Some(self.workspaces.with(make, |w| self.slice(atoms, too_close[i], w))))
            })
            .collect();
        let coverage = SliceCoverage::new(self.plan, &by_slice);
        Ok(Transmission { slices: slices?, layout: self.layout, coverage })
    }

    fn workspace(&self) -> TransmissionWorkspace {
        TransmissionWorkspace {
            usual: self.usual.workspace(),
            oversampled: None,
            wave: self.coarse.buffer(),
            coarse: self.coarse.scratch(),
        }
    }

    /// Takes back the arrays of transmission functions, for the next configuration.
    pub fn reclaim(&self, transmission: Transmission) {
        self.arrays.give(transmission.slices.into_iter().flatten());
    }

    /// An array of `len` elements with arbitrary contents.
    fn array(&self, len: usize) -> Buffer {
        self.arrays.take(|| Buffer::zeros(len))
    }

    /// One band-limited transmission function.
    fn slice(
        &self,
        atoms: SliceAtoms<'_>,
        too_close: bool,
        w: &mut TransmissionWorkspace,
    ) -> Buffer {
        let fft = &self.coarse;
        let (grating, inner) = match self.oversampled.get().filter(|_| too_close) {
            Some(fine) => (fine, w.oversampled.get_or_insert_with(|| fine.workspace())),
            None => (&self.usual, &mut w.usual),
        };
        w.wave.fill(Complex32::ZERO);
        grating.coefficients(self.plan, atoms, inner, fft, &mut w.wave);
        for columns in fft.band_columns(grating.reach()[0]) {
            fft.some_columns(&mut w.wave, columns, true, &mut w.coarse);
        }
        fft.all_rows(&mut w.wave, true, &mut w.coarse);
        match self.layout {
            TransmissionLayout::Arranged => self.arranged(&w.wave),
            TransmissionLayout::Padded { stride } => self.padded(&w.wave, stride),
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
    /// The slices of a range that contain atoms, at their mean heights in the cell.
    pub fn filled(&self, slices: Range<usize>) -> impl Iterator<Item = LocalSlice> {
        slices.filter(|&i| self.slices[i].is_some()).map(|i| self.coverage.in_the_mean(i))
    }
}
