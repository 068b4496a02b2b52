//! Profiles: typical sets of values for microscopes.

use serde::{Deserialize, Serialize};

use super::acquisition_settings::Acquisition;

/// A named set of values.
///
/// | value | ideal | routine | poor |
/// |---|---|---|---|
/// | dwell, fly-back (us) | 10, 0 | 10, 60 | 10, 60 |
/// | drift (nm/s), per axis | 0 | 0.007, 0.004 | 0.05, 0.03 |
/// | random walk (nm/s^1/2) | 0 | 0.002 | 0.01 |
/// | line jitter (A rms) | 0 | 0.05 | 0.2 |
/// | overshoot (A), decay (us) | 0 | 0.1, 100 | 0.5, 200 |
/// | hum of 50 Hz (A), per axis | 0 | 0.05, 0.02 | 0.3, 0.1 |
/// | scale (%), shear (%) | 0 | 0.5, -0.5, 0.2 | 2, -1, 1 |
/// | contamination | none | none | none |
/// | DQE | 1 | 0.8 | 0.5 |
/// | afterglow: share, time (us) | 0 | 0.02, 20 | 0.1, 50 |
/// | saturation (pA) | none | none | 50 |
/// | counts per electron, dark, noise | 1, 0, 0 | 50, 500, 20 | 4, 10, 2 |
/// | bits | 32 | 16 | 8 |
///
/// The effects are those that L. Jones and P. D. Nellist, Microsc. Microanal. 19 (2013) 1050 (drift, hum, jitter), F. F. Krause et
/// al., Ultramicroscopy 161 (2016) 146 (detector), and T. Mullarkey et al., doi:10.1093/micmic/ozad061 (late light, streaks)
/// describe; a drift of 0.5 nm per minute (routine) is what makers of microscopes promise for a stage at rest. The other
/// values are our own choice of a good and of a bad day: set those that are known of an instrument. How fast carbon grows depends on
/// the specimen more than on the microscope, by orders of magnitude, so no profile has any.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// No error but the Poisson noise of the electrons.
    #[default]
    Ideal,
    /// A corrected microscope, well kept.
    Routine,
    /// A bad day: drift, a noisy room, an old scintillator, eight bits.
    Poor,
}

/// No error except Poisson noise.
const IDEAL: Acquisition = Acquisition {
    dwell_us: 10.0,
    flyback_us: 0.0,
    frames: 1,
    drift_nm_per_s: [0.0; 2],
    drift_random_nm_per_sqrt_s: 0.0,
    line_jitter_angstrom: 0.0,
    overshoot_angstrom: 0.0,
    overshoot_decay_us: 100.0,
    hum_hz: 50.0,
    hum_angstrom: [0.0; 2],
    scale_percent: [0.0; 2],
    shear_percent: 0.0,
    contamination_angstrom3_per_electron: 0.0,
    dqe: 1.0,
    afterglow_share: 0.0,
    afterglow_us: 20.0,
    saturation_pa: 0.0,
    gain_counts: 1.0,
    dark_counts: 0.0,
    read_noise_counts: 0.0,
    bits: 32,
};

const ROUTINE: Acquisition = Acquisition {
    flyback_us: 60.0,
    drift_nm_per_s: [0.007, 0.004],
    drift_random_nm_per_sqrt_s: 0.002,
    line_jitter_angstrom: 0.05,
    overshoot_angstrom: 0.1,
    hum_angstrom: [0.05, 0.02],
    scale_percent: [0.5, -0.5],
    shear_percent: 0.2,
    dqe: 0.8,
    afterglow_share: 0.02,
    gain_counts: 50.0,
    dark_counts: 500.0,
    read_noise_counts: 20.0,
    bits: 16,
    ..IDEAL
};

const POOR: Acquisition = Acquisition {
    flyback_us: 60.0,
    drift_nm_per_s: [0.05, 0.03],
    drift_random_nm_per_sqrt_s: 0.01,
    line_jitter_angstrom: 0.2,
    overshoot_angstrom: 0.5,
    overshoot_decay_us: 200.0,
    hum_angstrom: [0.3, 0.1],
    scale_percent: [2.0, -1.0],
    shear_percent: 1.0,
    dqe: 0.5,
    afterglow_share: 0.1,
    afterglow_us: 50.0,
    saturation_pa: 50.0,
    gain_counts: 4.0,
    dark_counts: 10.0,
    read_noise_counts: 2.0,
    bits: 8,
    ..IDEAL
};

impl Profile {
    /// The name that recipes use.
    pub fn name(self) -> &'static str {
        match self {
            Profile::Ideal => "ideal",
            Profile::Routine => "routine",
            Profile::Poor => "poor",
        }
    }

    /// The values of the profile.
    pub fn acquisition(self) -> Acquisition {
        match self {
            Profile::Ideal => IDEAL,
            Profile::Routine => ROUTINE,
            Profile::Poor => POOR,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_are_within_the_limits() {
        for profile in [Profile::Ideal, Profile::Routine, Profile::Poor] {
            assert_eq!(profile.acquisition().check(), Ok(()), "{}", profile.name());
        }
    }
}
