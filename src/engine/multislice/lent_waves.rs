//! Access to the waves of multislice for patterns (`engine::patterns`), which begin and read them.

use super::super::stepper::{SliceStep, TransmissionView};
use super::super::transmission::TransmissionLayout;
use super::{Multislice, MultisliceWorkspace};
use num_complex::Complex32;

impl Multislice<'_> {
    /// Elements from row to row of a wave.
    pub(in crate::engine) fn stride(&self) -> usize {
        self.stepper.fft().stride()
    }

    /// Number of waves that should step together.
    pub(in crate::engine) fn waves_together(&self) -> usize {
        self.stepper.waves_together()
    }

    /// Bins (row, column) of the wave grid that contain probes.
    pub(in crate::engine) fn bins(&self) -> &[(usize, usize)] {
        &self.probes[0].1.bins
    }

    /// Number of foci.
    pub(in crate::engine) fn foci(&self) -> usize {
        self.probes.len()
    }

    /// The weight of a focus.
    pub(in crate::engine) fn weight(&self, focus: usize) -> f64 {
        self.probes[focus].0
    }

    /// The coefficients, in the order of [`Multislice::bins`], of the probe at a place in Angstrom.
    pub(in crate::engine) fn probe(&self, focus: usize, position: [f64; 2]) -> Vec<Complex32> {
        self.probes[focus].1.at(self.plan, position)
    }

    /// Sets a thread's waves to these coefficients, in the order of [`Multislice::bins`].
    pub(in crate::engine) fn begin_all<'c>(
        &self,
        MultisliceWorkspace { waves, step, .. }: &mut MultisliceWorkspace,
        coefficients: impl ExactSizeIterator<Item = &'c [Complex32]>,
    ) {
        let waves = self.at_least(waves, coefficients.len());
        for (wave, coefficients) in waves.iter_mut().zip(coefficients) {
            self.begin(wave, coefficients.iter().copied(), step);
        }
    }

    /// Passes a thread's first `n` waves through some steps.
    pub(in crate::engine) fn step_all(
        &self,
        w: &mut MultisliceWorkspace,
        n: usize,
        steps: &[SliceStep],
        view: TransmissionView<'_>,
    ) {
        let MultisliceWorkspace { waves, step, transmissions, .. } = w;
        match view.transmission.layout {
            TransmissionLayout::Padded { .. } => {
                self.step_waves(&mut waves[..n], steps, view, (transmissions, step));
            }
            TransmissionLayout::Arranged => steps.iter().for_each(|slice_step| {
                self.stepper.propagate(&mut waves[..n], *slice_step, view, step);
            }),
        }
    }

    /// The Fourier coefficients of a thread's wave between steps, times the number of pixels. Elements beyond the band limit are
    /// meaningless.
    pub(in crate::engine) fn spectrum<'w>(
        &self,
        MultisliceWorkspace { waves, copy, step, .. }: &'w mut MultisliceWorkspace,
        wave: usize,
    ) -> &'w [Complex32] {
        copy.copy_from_slice(&waves[wave]);
        self.stepper.transform_columns(copy, false, &mut step.fft);
        copy
    }
}
