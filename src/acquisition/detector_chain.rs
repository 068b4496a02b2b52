//! From electrons to the numbers of a file.

use rand_distr::{Distribution, Gamma, Poisson};

use super::acquisition_settings::Acquisition;
use super::exposure::{ELECTRONS_PER_PA_US, Exposure};
use crate::rng::{ItemRng, Purpose, normal3};

/// What happens to the electrons of a pixel, in this order:
///
/// 1. they come at random: Poisson;
/// 2. each gives a pulse of random height, gamma distributed with mean 1 and variance `1 / DQE - 1`, so that the sum over n
///    electrons is gamma distributed too and the noise is that of a detector of this efficiency (R. K. Swank, J. Appl. Phys. 44
///    (1973) 4199);
/// 3. a share of the light comes late, as `exp(-t / tau)`, into the pixels that follow; what comes during the fly-back is lost. Each
///    frame begins in the dark;
/// 4. a detector that saturates at the current s makes of the current x no more than `x / (1 + x / s)`;
/// 5. gain, dark counts and Gaussian read-out noise;
/// 6. a converter rounds and cuts off.
#[derive(Debug, Clone)]
pub struct DetectorChain {
    settings: Acquisition,
    electrons_per_pixel: f64,
    /// Electrons per pixel at which half is lost.
    saturation: Option<f64>,
    /// Pulses of one electron; `None` where all are alike.
    pulse_shape: Option<f64>,
    late: LateLight,
    seed: u64,
}

/// Light of a scintillator that comes late, from pixel to pixel.
#[derive(Debug, Clone, Copy)]
struct LateLight {
    share: f64,
    /// What a pixel's own late light leaves in it: 1 - (1 - q) tau / dwell, if it is made evenly over the dwell time.
    own: f64,
    /// What is left of stored light after a pixel.
    kept: f64,
    /// What is left of it after the fly-back.
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

/// What becomes of one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Counted {
    /// The number in the file.
    pub value: f64,
    /// Whether the converter cut it off.
    pub clipped: bool,
}

impl DetectorChain {
    /// The chain of a recording; `seed` decides all that is random.
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
        }
    }

    /// Electrons that hit the detector in a pixel where it should get this fraction of the beam.
    pub fn electrons(&self, fraction: f64, pixel: u64) -> f64 {
        match Poisson::new(fraction * self.electrons_per_pixel) {
            Ok(poisson) => poisson.sample(&mut ItemRng::new(self.seed, Purpose::Electrons, pixel)),
            // Not positive: no electrons.
            Err(_) => 0.0,
        }
    }

    /// The light that electrons make, in units of one electron's.
    pub fn light(&self, electrons: f64, pixel: u64) -> f64 {
        let Some(shape) = self.pulse_shape else { return electrons };
        match Gamma::new(electrons * shape, 1.0 / shape) {
            Ok(gamma) => gamma.sample(&mut ItemRng::new(self.seed, Purpose::PulseHeight, pixel)),
            // No electrons.
            Err(_) => 0.0,
        }
    }

    /// Moves the late light of a line into the pixels where it is seen; `stored` is what earlier lines left, and then what this one
    /// leaves.
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

    /// The number in the file.
    pub fn counted(&self, light: f64, pixel: u64) -> Counted {
        let Acquisition { gain_counts, dark_counts, read_noise_counts, .. } = self.settings;
        let seen = self.saturation.map_or(light, |most| light / (1.0 + light / most));
        let noise = match read_noise_counts {
            0.0 => 0.0,
            sigma => sigma * normal3(self.seed, Purpose::ReadNoise, 0, pixel)[0],
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
