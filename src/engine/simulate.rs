//! Executes a plan: simulates phonon configurations and averages their images.

use super::detector_images::Images;
use super::direct_beam::direct_beam_factors;
use super::multislice::Multislice;
use super::plan::Plan;
use super::prism::Prism;
use super::probe_raster::ProbeRaster;
use super::probe_scan::{ProbePlaces, Scan};
use super::probe_tail::ProbeTail;
use super::settings::Algorithm;
use super::stepper::{Stepper, TransmissionView};
use super::transmission::{Transmission, TransmissionBuilder};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::structure::Site;
use ndarray::{Array2, Array4};
use num_complex::Complex32;
use std::collections::BTreeSet;

/// Simulates the images of a scan: fractions of the incident beam as (thickness, detector, row = y, column = x), averaged over phonon
/// configurations. [`Settings::probe_step`](super::Settings::probe_step) decides the distance of the propagated probes.
///
/// The cell is periodic along x and y; sites outside are wrapped. The bytes of the result do not depend on the number of threads.
///
/// # Errors
/// [`Error::UnknownElement`] for an element that the tables lack, [`Error::Invalid`] for a probe step too coarse for the image, or
/// [`Error::Interrupted`].
pub fn simulate(
    plan: &Plan,
    sites: &[Site],
    scan: &Scan,
    progress: &dyn Progress,
) -> Result<Images> {
    Simulation::new(plan, &elements(sites))?.images(sites, scan, progress)
}

/// A plan that is ready to run, for several specimens with equal box, mean heights and elements. Everything that does not depend on the
/// exact positions of the atoms is prepared once.
pub struct Simulation<'a> {
    builder: TransmissionBuilder<'a>,
    lens: LensEngine<'a>,
}

/// Propagates probes through one lens, and makes their images.
pub(super) struct LensEngine<'a> {
    plan: &'a Plan,
    engine: WaveEngine<'a>,
    tail: Option<ProbeTail<'a>>,
    /// Factors by which images on each detector are multiplied.
    factors: Vec<f64>,
}

enum WaveEngine<'a> {
    Multislice(Box<Multislice<'a>>),
    Prism(Box<Prism<'a>>),
}

impl<'a> LensEngine<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        let engine = match plan.settings.algorithm {
            Algorithm::Prism { .. } => WaveEngine::Prism(Box::new(Prism::new(plan))),
            _ => WaveEngine::Multislice(Box::new(Multislice::new(plan))),
        };
        let in_windows = || match &engine {
            WaveEngine::Multislice(multislice) => multislice.seen_without_specimen(),
            WaveEngine::Prism(_) => None,
        };
        let factors = direct_beam_factors(plan, in_windows);
        LensEngine { plan, engine, tail: ProbeTail::new(plan), factors }
    }

    /// The images of probes at these places, averaged over phonon configurations, through each of these lenses. The lenses' plans differ
    /// only in aberrations, and `builder` is of one of them: transmission functions, and with PRISM the waves, are made once for all. Where
    /// only some probes are `wanted`, the values of the others are meaningless.
    ///
    /// # Errors
    /// Errors of [`simulate()`]; [`Error::Invalid`] for some probes of PRISM.
    pub fn images(
        lenses: &mut [Self],
        builder: &TransmissionBuilder<'a>,
        sites: &[Site],
        (places, wanted): (ProbePlaces<'_>, Option<&[bool]>),
        progress: &dyn Progress,
    ) -> Result<Vec<Images>> {
        let Some(plan) = lenses.first().map(|lens| lens.plan) else { return Ok(Vec::new()) };
        let configurations = plan.settings.configurations();
        let values = places.len() * plan.record_after.len() * plan.settings.detectors.len();
        let mut sums = vec![vec![0.0_f64; values]; lenses.len()];
        let (units, unit) = units(plan, places, lenses.len());
        progress.start("simulating", unit, units * u64::from(configurations));
        for configuration in 0..configurations {
            let transmission = builder.build(sites, configuration, progress)?;
            let each = Self::intensities(lenses, &transmission, (places, wanted), progress)?;
            for (sum, values) in sums.iter_mut().zip(each) {
                sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
            }
            builder.reclaim(transmission);
        }
        let images = lenses.iter().zip(sums).map(|(lens, sum)| lens.mean(sum, sites, places));
        let images = images.collect::<Result<Vec<_>>>()?;
        progress.finish();
        Ok(images)
    }

    /// Intensities in one configuration, (probe, recorded thickness, detector) row-major, for each lens.
    fn intensities(
        lenses: &mut [Self],
        transmission: &Transmission,
        (places, wanted): (ProbePlaces<'_>, Option<&[bool]>),
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<f64>>> {
        let beams = |lens: &Self| match &lens.engine {
            WaveEngine::Prism(prism) => Some(prism.amplitudes.clone()),
            WaveEngine::Multislice(_) => None,
        };
        let amplitudes: Vec<_> = lenses.iter().filter_map(beams).collect();
        if let Some(LensEngine { engine: WaveEngine::Prism(prism), .. }) = lenses.first_mut() {
            return match places {
                ProbePlaces::Raster(scan) if wanted.is_none() => {
                    prism.run(transmission, scan, &amplitudes, progress)
                }
                _ => Err(single_probes_of_prism()),
            };
        }
        let each = lenses.iter_mut().filter_map(|lens| match &mut lens.engine {
            WaveEngine::Multislice(m) => Some(match wanted {
                Some(wanted) => m.run_some(transmission, places, wanted, progress),
                None => m.run(transmission, places, progress),
            }),
            WaveEngine::Prism(_) => None,
        });
        each.collect()
    }

    /// The mean of sums over configurations, with the contribution of the probe's tail.
    fn mean(&self, mut sum: Vec<f64>, sites: &[Site], places: ProbePlaces<'_>) -> Result<Images> {
        let plan = self.plan;
        let (records, detectors) = (plan.record_after.len(), plan.settings.detectors.len());
        let n = f64::from(plan.settings.configurations());
        if let Some(tail) = &self.tail {
            let values = tail.values(sites, places)?;
            sum.iter_mut().zip(values).for_each(|(s, t)| *s += n * t);
        }
        let [rows, columns] = places.shape();
        let data = Array4::from_shape_fn((records, detectors, rows, columns), |(t, d, y, x)| {
            (sum[((y * columns + x) * records + t) * detectors + d] / n * self.factors[d]) as f32
        });
        if let Some(bad) = data.iter().find(|v| !v.is_finite()) {
            let expected =
                "every pixel has to be finite; please report the settings that led to this";
            return Err(Error::invalid(crate::Setting::Intensity, bad, expected));
        }
        Ok(Images {
            data,
            detectors: plan.settings.detectors.iter().map(|d| d.name.clone()).collect(),
            thicknesses_angstrom: plan.thicknesses_angstrom(),
        })
    }
}

/// The error for single probes with PRISM: it sums beams for whole rows and columns of probes.
fn single_probes_of_prism() -> Error {
    let expected = "PRISM computes all probes together; use multislice or windows for single probes and for parts of a scan";
    Error::invalid(crate::Setting::Algorithm, "prism", expected)
}

/// Progress units of one configuration through several lenses, and their name.
fn units(plan: &Plan, places: ProbePlaces<'_>, lenses: usize) -> (u64, &'static str) {
    let probes = places.len() * lenses;
    match plan.beams {
        0 => (probes as u64, "probes"),
        beams => (((beams + probes) * plan.record_after.len().max(1)) as u64, "waves and probes"),
    }
}

impl<'a> Simulation<'a> {
    /// Prepares simulations of specimens that hold no other elements (atomic numbers) than these.
    ///
    /// # Errors
    /// [`crate::Error::UnknownElement`] for an element that the tables lack.
    pub fn new(plan: &'a Plan, elements: &[u8]) -> Result<Self> {
        let builder = TransmissionBuilder::new(plan, elements)?;
        Ok(Simulation { builder, lens: LensEngine::new(plan) })
    }

    /// Simulates the images of a scan, as [`simulate()`] does.
    ///
    /// # Errors
    /// Errors of [`simulate()`].
    pub(crate) fn images(
        &mut self,
        sites: &[Site],
        scan: &Scan,
        progress: &dyn Progress,
    ) -> Result<Images> {
        let raster = ProbeRaster::new(self.lens.plan, scan)?;
        let lens = std::slice::from_mut(&mut self.lens);
        let mut images =
            LensEngine::images(lens, &self.builder, sites, (raster.scan().into(), None), progress)?;
        Ok(raster.images(images.remove(0)))
    }

    /// Intensities of the probes with these indices (row-major in the scan) in one phonon configuration, as fractions of the beam: (index,
    /// recorded thickness, detector), row-major. They are equal, up to rounding, to the intensities of a simulation of a scan with a probe at
    /// every position, but only waves that these probes need are propagated.
    ///
    /// # Errors
    /// Errors of [`simulate()`]; [`Error::Invalid`] for plans for PRISM, which has no single probes.
    pub fn some_probes(
        &mut self,
        sites: &[Site],
        scan: &Scan,
        indices: &[usize],
        configuration: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>> {
        let WaveEngine::Multislice(multislice) = &mut self.lens.engine else {
            return Err(single_probes_of_prism());
        };
        let transmission = self.builder.build(sites, configuration, progress)?;
        let mut wanted = vec![false; scan.len()];
        indices.iter().for_each(|i| wanted[*i] = true);
        let mut values = multislice.run_few(&transmission, scan.into(), &wanted, progress)?;
        self.builder.reclaim(transmission);
        if let Some(tail) = &self.lens.tail {
            let tails = tail.values(sites, scan.into())?;
            values.iter_mut().zip(tails).for_each(|(v, t)| *v += t);
        }
        let plan = self.lens.plan;
        let detectors = plan.settings.detectors.len();
        let each = detectors * plan.record_after.len();
        values.iter_mut().enumerate().for_each(|(i, v)| *v *= self.lens.factors[i % detectors]);
        Ok(indices.iter().flat_map(|i| values[i * each..][..each].iter().copied()).collect())
    }
}

/// The diffraction pattern of one probe at `position_angstrom` (x, y), configuration 0, at the last recorded thickness.
///
/// The array has the shape of the plan's wave grid, rows = ky and columns = kx in FFT order, and holds fractions of the beam
/// per pixel; beyond the band limit they are 0.
///
/// Errors of [`simulate()`]; [`Error::Invalid`] for plans for PRISM, which has no single probes.
/// Errors of [`simulate()`]; [`Error::Invalid`] for plans for PRISM, which has no single probes.
pub(crate) fn diffraction(
    plan: &Plan,
    sites: &[Site],
    position_angstrom: [f64; 2],
    progress: &dyn Progress,
) -> Result<Array2<f32>> {
    diffraction_of(plan, sites, position_angstrom, 0..1, progress)
}

/// The diffraction pattern of [`diffraction()`] in the mean over all configurations.
///
/// # Errors
/// Errors of [`diffraction()`].
pub(crate) fn mean_diffraction(
    plan: &Plan,
    sites: &[Site],
    position_angstrom: [f64; 2],
    progress: &dyn Progress,
) -> Result<Array2<f32>> {
    let all = 0..plan.settings.configurations();
    diffraction_of(plan, sites, position_angstrom, all, progress)
}

fn diffraction_of(
    plan: &Plan,
    sites: &[Site],
    position_angstrom: [f64; 2],
    configurations: std::ops::Range<u32>,
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
    let mut engine = Multislice::lending(plan);
    let share = 1.0 / configurations.len() as f32;
    let mut sum = Array2::zeros(plan.wave_grid.shape());
    for configuration in configurations {
        let transmission = builder.build(sites, configuration, progress)?;
        let patterns = engine.diffraction(&transmission, position_angstrom);
        let last = patterns.into_iter().next_back().unwrap_or_default();
        let pattern = Array2::from_shape_vec(sum.dim(), last);
        sum += &pattern.map_err(|e| {
            Error::invalid(crate::Setting::Pattern, e, "has the shape of the wave grid")
        })?;
        builder.reclaim(transmission);
    }
    Ok(sum * share)
}

/// The wave at the exit surface in one phonon configuration, for an incident plane wave along the beam.
///
/// The array has the shape of the plan's wave grid, rows = y and columns = x; 1 is the amplitude of the incident wave.
///
/// # Errors
/// Errors of [`simulate()`]; [`Error::Invalid`] for plans with windows.
pub fn exit_wave(
    plan: &Plan,
    sites: &[Site],
    configuration: u32,
    progress: &dyn Progress,
) -> Result<Array2<Complex32>> {
    if plan.has_windows() {
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
    let (steps, end) =
        stepper.path((slices.entrance(), [0; 2]), transmission.filled(0..slices.len()));
    let to_exit = stepper.propagator(slices.boundaries[slices.len()] - end.0, [0; 2]);
    let fft = stepper.fft();
    let (mut waves, mut w) = ([fft.buffer()], stepper.workspace());
    let (ny, nx) = fft.shape();
    waves[0][0] = Complex32::ONE;
    stepper.start(&mut waves[0], stepper.band(), &mut w.fft);
    let view = TransmissionView { transmission: &transmission, origin: (0, 0) };
    for step in steps {
        stepper.propagate(&mut waves, step, view, &mut w);
    }
    let wave = stepper.leaving(&waves[0], &to_exit, &mut w.fft);
    let mut out = Array2::zeros((ny, nx));
    for y in 0..ny {
        for x in 0..nx {
            out[[y, x]] = wave[y * fft.stride() + x];
        }
    }
    Ok(out)
}

/// The waves of probes at places (x, y) in Angstrom in one phonon configuration, at each recorded thickness: (place, thickness, y, x), on
/// the plan's wave grid. The squared moduli of a wave add to the fraction of the beam.
///
/// # Errors
/// Errors of [`simulate()`]; [`Error::Invalid`] for plans with windows or for PRISM, and for a focal spread.
pub fn probe_exit_waves(
    plan: &Plan,
    sites: &[Site],
    places_angstrom: &[[f64; 2]],
    configuration: u32,
    progress: &dyn Progress,
) -> Result<Array4<Complex32>> {
    has_exit_waves(plan)?;
    let builder = TransmissionBuilder::new(plan, &elements(sites))?;
    let transmission = builder.build(sites, configuration, progress)?;
    Multislice::lending(plan).exit_waves(&transmission, places_angstrom, progress)
}

/// Refuses plans without exit waves of probes.
pub(crate) fn has_exit_waves(plan: &Plan) -> Result<()> {
    if plan.settings.algorithm != Algorithm::Multislice {
        let expected = "exit waves are made by multislice on the full grid; leave the engine out, or name `multislice`";
        return Err(Error::invalid(crate::Setting::Algorithm, plan.settings.algorithm, expected));
    }
    let spread = plan.settings.optics.focal_spread_angstrom;
    if spread > 0.0 {
        let expected =
            "a wave has one focus; leave the focal spread out, or simulate a series of defocus";
        return Err(Error::invalid(crate::Setting::FocalSpreadAngstrom, spread, expected));
    }
    Ok(())
}

/// The atomic numbers of the elements in some sites, ascending.
pub(crate) fn elements(sites: &[Site]) -> Vec<u8> {
    sites.iter().map(|s| s.number).collect::<BTreeSet<u8>>().into_iter().collect()
}
