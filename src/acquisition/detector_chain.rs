//! The detector chain: from electrons to the numbers of a file.

use rand_distr::{Distribution, Gamma, Poisson};

use super::acquisition_settings::Acquisition;
use super::exposure::{ELECTRONS_PER_PA_US, Exposure};
use crate::rng::{ItemRng, Purpose, item_of_detector, normal3};

/// Converts the electrons of a pixel to the number in the file, in these steps:
///
/// 1. Electrons arrive at random, with Poisson statistics.
/// 2. Each gives a pulse of random height, gamma distributed with mean 1 and variance `1 / DQE - 1`. The sum over n
///    electrons is then gamma distributed too, and its noise is the noise of a detector of this efficiency (R. K. Swank,
///    J. Appl. Phys. 44 (1973) 4199).
/// 3. A share of the light is emitted late, as `exp(-t / tau)`, in the pixels that follow. Light emitted during the fly-back is lost.
///    Each frame begins in the dark.
/// 4. A detector that saturates at the current s converts the current x to `x / (1 + x / s)`.
/// 5. Gain, dark counts and Gaussian read-out noise are applied.
/// 6. A converter rounds and clips.
///
/// A camera that measures the mean angle of the electrons counts single electrons: it has the first step only.
#[derive(Debug, Clone)]
pub struct DetectorChain {
    settings: Acquisition,
    electrons_per_pixel: f64,
    /// Electrons per pixel at which half of the signal is lost.
    saturation: Option<f64>,
    /// Shape parameter of the pulse heights; `None` if all pulses are equal.
    pulse_shape: Option<f64>,
    late: LateLight,
    seed: u64,
    /// Number of the detector. Each detector draws its own random numbers.
    detector: u16,
}

/// Number of the draws of mean angles; read-out noise has 0.
const DEFLECTIONS: u32 = 1;

/// Late light of a scintillator, passed from pixel to pixel.
#[derive(Debug, Clone, Copy)]
struct LateLight {
    share: f64,
    /// Share of a pixel's late light that is emitted within the pixel: 1 - (1 - q) tau / dwell, if it is made evenly over the dwell time.
    own: f64,
    /// Share of the stored light that remains after a pixel.
    kept: f64,
    /// Share of the stored light that remains after the fly-back.
    after_flyback: f64,
}

impl LateLight {
    fn new(settings: &Acquisition) -> Self {
        let Acquisition { afterglow_share, afterglow_us, dwell_us, flyback_us, .. } = *settings;
        let lost = -libm::expm1(-dwell_us / afterglow_us);
        LateLight {
            share: afterglow_share,
            own: 1.0 - lost * afterglow_us / dwell_us,
            kept: 1.0 - lost,
            after_flyback: libm::exp(-flyback_us / afterglow_us),
        }
    }
}

/// The recorded value of one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Counted {
    /// The number in the file.
    pub value: f64,
    /// Whether the converter clipped it.
    pub clipped: bool,
}

impl DetectorChain {
    /// Prepares the chain for a recording; `seed` decides all random numbers.
    pub fn new(settings: &Acquisition, exposure: &Exposure, seed: u64) -> Self {
        let saturates = settings.saturation_pa > 0.0;
        let per_pa = exposure.dwell_us * ELECTRONS_PER_PA_US;
        DetectorChain {
            settings: *settings,
            electrons_per_pixel: exposure.electrons_per_pixel,
            saturation: saturates.then_some(settings.saturation_pa * per_pa),
            pulse_shape: (settings.dqe < 1.0).then_some(settings.dqe / (1.0 - settings.dqe)),
            late: LateLight::new(settings),
            seed,
            detector: 0,
        }
    }

    /// The chain of another detector that records at the same time; 0 is the main one.
    #[must_use]
    pub(crate) fn of_detector(self, detector: u16) -> Self {
        DetectorChain { detector, ..self }
    }

    /// Number of the random numbers of a pixel.
    fn item(&self, pixel: u64) -> u64 {
        item_of_detector(pixel, self.detector)
    }

    /// Draws the electrons that hit the detector in a pixel with this fraction of the beam.
    pub(crate) fn electrons(&self, fraction: f64, pixel: u64) -> f64 {
        match Poisson::new(fraction * self.electrons_per_pixel) {
            Ok(poisson) => {
                poisson.sample(&mut ItemRng::new(self.seed, Purpose::Electrons, self.item(pixel)))
            }
            // The mean is not positive, so there are no electrons.
            Err(_) => 0.0,
        }
    }

    /// Draws the light that electrons make, in units of the mean light of one electron.
    pub(crate) fn light(&self, electrons: f64, pixel: u64) -> f64 {
        let Some(shape) = self.pulse_shape else { return electrons };
        match Gamma::new(electrons * shape, 1.0 / shape) {
            Ok(gamma) => {
                gamma.sample(&mut ItemRng::new(self.seed, Purpose::PulseHeight, self.item(pixel)))
            }
            // There are no electrons.
            Err(_) => 0.0,
        }
    }

    /// Moves the late light of a line into the pixels in which it is emitted. `stored` is the late light of earlier lines on entry, and
    /// includes this line's on return.
    pub fn spread_late(&self, line: &mut [f64], stored: &mut f64) {
        let LateLight { share, own, kept, after_flyback } = self.late;
        if share == 0.0 {
            return;
        }
        for light in line.iter_mut() {
            let late = share * *light;
            *light += *stored * (1.0 - kept) - late * (1.0 - own);
            *stored = *stored * kept + late * (1.0 - own);
        }
        *stored *= after_flyback;
    }

    /// Draws the mean angle along an axis (0: x, 1: y) of counted electrons, of which one has this mean and standard deviation. No
    /// electrons have the angle 0.
    pub(crate) fn mean_angle(
        &self,
        [mean, deviation]: [f64; 2],
        electrons: f64,
        axis: usize,
        pixel: u64,
    ) -> f64 {
        if electrons < 1.0 {
            return 0.0;
        }
        let normal = normal3(self.seed, Purpose::ReadNoise, DEFLECTIONS, self.item(pixel))[axis];
        mean + deviation * normal / electrons.sqrt()
    }

    /// Converts light to the number in the file.
    pub(crate) fn counted(&self, light: f64, pixel: u64) -> Counted {
        let Acquisition { gain_counts, dark_counts, read_noise_counts, .. } = self.settings;
        let seen = self.saturation.map_or(light, |most| light / (1.0 + light / most));
        let noise = match read_noise_counts {
            0.0 => 0.0,
            sigma => sigma * normal3(self.seed, Purpose::ReadNoise, 0, self.item(pixel))[0],
        };
        let value = dark_counts + gain_counts * seen + noise;
        match self.settings.full_scale() {
            None => Counted { value, clipped: false },
            Some(most) => {
                let rounded = (value + 0.5).floor();
                Counted {
                    value: rounded.clamp(0.0, most),
                    clipped: !(0.0..=most).contains(&rounded),
                }
            }
        }
    }
}
