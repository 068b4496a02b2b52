//! Executes a plan: configurations, averages, images.

use super::multislice::Multislice;
use super::plan::Plan;
use super::prism::Prism;
use super::raster::ProbeRaster;
use super::settings::Algorithm;
use super::stepper::{Specimen, Stepper};
use super::tail::Tail;
use super::transmission::TransmissionBuilder;
use super::{Scan, Site};
use crate::error::{Error, Result};
use crate::progress::Progress;
use ndarray::{Array2, Array4, ArrayView2, s};
use num_complex::Complex32;
use std::collections::BTreeSet;

/// Detector images, as fractions of the incident beam, averaged over phonon configurations.
#[derive(Debug, Clone, PartialEq)]
pub struct Images {
    /// (thickness, detector, row = y, column = x)
    pub data: Array4<f32>,
    /// Detector names.
    pub detectors: Vec<String>,
    /// Thicknesses in Angstrom.
    pub thicknesses_angstrom: Vec<f64>,
}

impl Images {
    /// The image of a detector at a recorded thickness.
    pub fn image(&self, thickness: usize, detector: usize) -> ArrayView2<'_, f32> {
        self.data.slice(s![thickness, detector, .., ..])
    }
}

/// Simulates the images of a scan; [`Settings::probe_step`](super::Settings::probe_step) says where probes stand.
///
/// The cell is periodic along x and y; sites outside are wrapped. The result is the same bytes for
/// any number of threads.
///
/// # Errors
/// An element that the tables lack, a probe step too coarse for the image, or [`Error::Interrupted`].
pub fn simulate(
    plan: &Plan,
    sites: &[Site],
    scan: &Scan,
    progress: &dyn Progress,
) -> Result<Images> {
    Simulation::new(plan, &elements(sites))?.images(sites, scan, progress)
}

/// A plan with all that does not depend on where atoms are: for several specimens of the same box, heights and
/// elements.
pub struct Simulation<'a> {
    plan: &'a Plan,
    builder: TransmissionBuilder<'a>,
    engine: Engine<'a>,
    tail: Option<Tail<'a>>,
}

enum Engine<'a> {
    Multislice(Box<Multislice<'a>>),
    Prism(Box<Prism<'a>>),
}

impl<'a> Simulation<'a> {
    /// For specimens of no other elements than these.
    ///
    /// # Errors
    /// An element that the tables lack.
    pub fn new(plan: &'a Plan, elements: &[u8]) -> Result<Self> {
        let builder = TransmissionBuilder::new(plan, elements)?;
        let engine = match plan.settings.algorithm {
            Algorithm::Prism { .. } => Engine::Prism(Box::new(Prism::new(plan))),
            _ => Engine::Multislice(Box::new(Multislice::new(plan))),
        };
        Ok(Simulation { plan, builder, engine, tail: Tail::new(plan) })
    }

    /// As [`simulate`].
    ///
    /// # Errors
    /// Those of [`simulate`].
    pub fn images(
        &mut self,
        sites: &[Site],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Images> {
        let raster = ProbeRaster::new(self.plan, scan)?;
        Ok(raster.images(self.at_probes(sites, raster.scan(), progress)?))
    }

    /// The images of a scan with a probe at every position.
    fn at_probes(
        &mut self,
        sites: &[Site],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Images> {
        let plan = self.plan;
        let configurations = plan.settings.configurations();
        let records = plan.record_after.len();
        let detectors = plan.settings.detectors.len();
        let mut sum = vec![0.0_f64; scan.len() * records * detectors];
        let units = (plan.beams + scan.len()) * records.max(1);
        let units = if plan.beams > 0 { units } else { scan.len() };
        let unit = if plan.beams > 0 { "waves and probes" } else { "probes" };
        progress.start("simulating", unit, units as u64 * u64::from(configurations));
        for configuration in 0..configurations {
            let transmission = self.builder.build(sites, configuration, progress)?;
            let values = match &mut self.engine {
                Engine::Multislice(m) => m.run(&transmission, scan, progress)?,
                Engine::Prism(p) => p.run(&transmission, scan, progress)?,
            };
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
            self.builder.reclaim(transmission);
        }
        let n = f64::from(configurations);
        if let Some(tail) = &self.tail {
            let values = tail.values(sites, scan)?;
            sum.iter_mut().zip(values).for_each(|(s, t)| *s += n * t);
        }
        progress.finish();
        let [rows, columns] = scan.shape;
        let data = Array4::from_shape_fn((records, detectors, rows, columns), |(t, d, y, x)| {
            (sum[((y * columns + x) * records + t) * detectors + d] / n) as f32
        });
        Ok(Images {
            data,
            detectors: plan.settings.detectors.iter().map(|d| d.name.clone()).collect(),
            thicknesses_angstrom: plan.thicknesses_angstrom(),
        })
    }
}

/// Diffraction intensity of one probe (configuration 0) at the last recorded thickness: fraction of
/// the beam per pixel of the plan's wave grid, FFT order, rows = ky.
///
/// # Errors
/// As [`simulate`]; plans for PRISM have no single probe and are refused.
pub fn diffraction(
    plan: &Plan,
    sites: &[Site],
    position_angstrom: [f64; 2],
    progress: &dyn Progress,
) -> Result<Array2<f32>> {
    if matches!(plan.settings.algorithm, Algorithm::Prism { .. }) {
        return Err(Error::invalid(
            crate::Setting::Algorithm,
            "prism",
            "use multislice for single patterns",
        ));
    }
    let builder = TransmissionBuilder::new(plan, &elements(sites))?;
    let transmission = builder.build(sites, 0, progress)?;
    let mut engine = Multislice::new(plan);
    let patterns = engine.diffraction(&transmission, position_angstrom);
    let last = patterns.into_iter().next_back().unwrap_or_default();
    let shape = plan.wave_grid.shape();
    Array2::from_shape_vec(shape, last)
        .map_err(|e| Error::invalid(crate::Setting::Pattern, e, "has the shape of the wave grid"))
}

/// The exit wave of a plane wave along the beam through one phonon configuration, on the plan's
/// grid, at the exit surface: (row = y, column = x), mean intensity 1 where nothing is absorbed.
///
/// # Errors
/// As [`simulate`].
pub fn exit_wave(
    plan: &Plan,
    sites: &[Site],
    configuration: u32,
    progress: &dyn Progress,
) -> Result<Array2<Complex32>> {
    if plan.wave_grid != plan.transmission_grid {
        return Err(Error::invalid(
            crate::Setting::Algorithm,
            "window",
            "use multislice for plane waves",
        ));
    }
    let builder = TransmissionBuilder::new(plan, &elements(sites))?;
    let transmission = builder.build(sites, configuration, progress)?;
    let mut stepper = Stepper::new(plan);
    let slices = &plan.slices;
    let (legs, end) = stepper.route(slices.entrance(), transmission.filled(0..slices.len()));
    let to_exit = stepper.propagator(slices.boundaries[slices.len()] - end);
    let fft = stepper.fft();
    let (mut waves, mut w) = ([fft.buffer()], stepper.workspace());
    let (ny, nx) = fft.shape();
    waves[0][0] = Complex32::ONE;
    stepper.start(&mut waves[0], stepper.band(), &mut w.fft);
    let specimen = Specimen { transmission: &transmission, origin: (0, 0) };
    for leg in legs {
        stepper.travel(&mut waves, leg, specimen, &mut w);
    }
    stepper.propagate_by(&mut waves, &to_exit, &mut w.fft);
    let [mut wave] = waves;
    if let [low, high] = stepper.band() {
        for row in wave.chunks_exact_mut(fft.stride()) {
            row[low.end..high.start].fill(Complex32::ZERO);
        }
    }
    fft.all_rows(&mut wave, true, &mut w.fft);
    let mut out = Array2::zeros((ny, nx));
    for y in 0..ny {
        for x in 0..nx {
            out[[y, x]] = wave[y * fft.stride() + x];
        }
    }
    Ok(out)
}

/// The elements of some sites, ascending.
pub(crate) fn elements(sites: &[Site]) -> Vec<u8> {
    sites.iter().map(|s| s.number).collect::<BTreeSet<u8>>().into_iter().collect()
}
