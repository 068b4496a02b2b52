//! Settings of a recording: the scan and its errors, and the chain from the detector to the file.

use serde::{Deserialize, Serialize};

use super::profiles::Profile;
use crate::setting::{Fault, check_range};

/// Declares [`Acquisition`] with the values of a scan and of a detector chain, [`AcquisitionTable`], in which every value is optional, and
/// [`DetectorValues`], the optional values of a chain alone.
macro_rules! acquisition {
    (
        scan { $($(#[doc = $scan_doc:literal])* $scan:ident: $scan_kind:ty,)* }
        chain { $($(#[doc = $doc:literal])* $name:ident: $kind:ty,)* }
    ) => {
        /// How a noise-free image is recorded.
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Acquisition {
            $($(#[doc = $scan_doc])* pub $scan: $scan_kind,)*
            $($(#[doc = $doc])* pub $name: $kind,)*
        }

        /// The table `[acquisition]` of a recipe. Missing values are taken from its profile.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct AcquisitionTable {
            /// The profile of missing values; `ideal` when absent.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub profile: Option<Profile>,
            $($(#[doc = $scan_doc])*
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub $scan: Option<$scan_kind>,)*
            $($(#[doc = $doc])*
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub $name: Option<$kind>,)*
        }

        impl AcquisitionTable {
            /// Fills in missing values from the profile.
            pub fn resolved(&self) -> Acquisition {
                let base = self.profile.unwrap_or_default().acquisition();
                Acquisition {
                    $($scan: self.$scan.unwrap_or(base.$scan),)*
                    $($name: self.$name.unwrap_or(base.$name),)*
                }
            }
        }

        /// The table `acquisition` of a table `[[detector]]`: values of its detector chain that differ from `[acquisition]`.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct DetectorValues {
            $($(#[doc = $doc])*
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub $name: Option<$kind>,)*
        }

        impl DetectorValues {
            /// Returns the settings of a recording with these values.
            pub(crate) fn over(&self, base: &Acquisition) -> Acquisition {
                Acquisition { $($name: self.$name.unwrap_or(base.$name),)* ..*base }
            }
        }
    };
}

acquisition! {
    scan {
        /// Time on each pixel in microseconds.
        dwell_us: f64,
        /// Time from the last pixel of a line to the first of the next, in microseconds.
        flyback_us: f64,
        /// Number of frames among which the dose is shared.
        frames: usize,
        /// Velocity (x, y) of the specimen in nm/s.
        drift_nm_per_s: [f64; 2],
        /// Random walk of the specimen: standard deviation along each axis after one second, in nm.
        drift_random_nm_per_sqrt_s: f64,
        /// Random displacement of whole lines: standard deviation along each axis in Angstrom.
        line_jitter_angstrom: f64,
        /// Distance in Angstrom of the beam to the left of its intended place at the start of a line.
        overshoot_angstrom: f64,
        /// Time in which the overshoot falls to 1/e, in microseconds.
        overshoot_decay_us: f64,
        /// Frequency of the mains hum in Hz.
        hum_hz: f64,
        /// Amplitude (x, y) of the mains hum in Angstrom.
        hum_angstrom: [f64; 2],
        /// Excess size of the scan along (x, y), in per cent.
        scale_percent: [f64; 2],
        /// Displacement along x over distance along y, in per cent.
        shear_percent: f64,
        /// Volume of carbon in cubic Angstrom that each electron deposits on the specimen: the thickness in Angstrom that a dose of 1 e/A^2
        /// adds to the exposed area. Frames show the carbon of earlier frames.
        contamination_angstrom3_per_electron: f64,
    }
    chain {
        /// Detective quantum efficiency: electrons give pulses of different height, of relative variance 1 / DQE - 1.
        dqe: f64,
        /// Share of the light that is emitted late.
        afterglow_share: f64,
        /// Time in which the late light falls to 1/e, in microseconds.
        afterglow_us: f64,
        /// Current s on the detector in pA at which half of the signal is lost: x becomes x / (1 + x / s). 0: the detector is linear.
        saturation_pa: f64,
        /// Counts of one electron.
        gain_counts: f64,
        /// Counts without electrons.
        dark_counts: f64,
        /// Standard deviation of the read-out noise of one pixel in counts.
        read_noise_counts: f64,
        /// Bits of the converter: 8, 12 or 16; 32 for single-precision numbers that are not rounded.
        bits: u32,
    }
}

/// Range of a value, with its key.
type Limits = (&'static str, [f64; 2]);

/// Supported converters.
const BITS: [u32; 4] = [8, 12, 16, 32];

impl Acquisition {
    /// The values with their limits.
    fn limited(&self) -> [(f64, Limits); 23] {
        let drift = ("drift_nm_per_s", [-100.0, 100.0]);
        let hum = ("hum_angstrom", [0.0, 100.0]);
        let scale = ("scale_percent", [-20.0, 20.0]);
        [
            (self.dwell_us, ("dwell_us", [0.01, 1e6])),
            (self.flyback_us, ("flyback_us", [0.0, 1e6])),
            (self.frames as f64, ("frames", [1.0, 10_000.0])),
            (self.drift_nm_per_s[0], drift),
            (self.drift_nm_per_s[1], drift),
            (self.drift_random_nm_per_sqrt_s, ("drift_random_nm_per_sqrt_s", [0.0, 10.0])),
            (self.line_jitter_angstrom, ("line_jitter_angstrom", [0.0, 10.0])),
            (self.overshoot_angstrom, ("overshoot_angstrom", [-100.0, 100.0])),
            (self.overshoot_decay_us, ("overshoot_decay_us", [1e-3, 1e6])),
            (self.hum_hz, ("hum_hz", [0.1, 1e5])),
            (self.hum_angstrom[0], hum),
            (self.hum_angstrom[1], hum),
            (self.scale_percent[0], scale),
            (self.scale_percent[1], scale),
            (self.shear_percent, ("shear_percent", [-20.0, 20.0])),
            (
                self.contamination_angstrom3_per_electron,
                ("contamination_angstrom3_per_electron", [0.0, 10.0]),
            ),
            (self.dqe, ("dqe", [0.01, 1.0])),
            (self.afterglow_share, ("afterglow_share", [0.0, 0.9])),
            (self.afterglow_us, ("afterglow_us", [1e-3, 1e6])),
            (self.saturation_pa, ("saturation_pa", [0.0, 1e6])),
            (self.gain_counts, ("gain_counts", [1e-6, 1e6])),
            (self.dark_counts, ("dark_counts", [0.0, 1e6])),
            (self.read_noise_counts, ("read_noise_counts", [0.0, 1e6])),
        ]
    }

    /// Checks every value against its limits.
    ///
    /// # Errors
    /// The first value outside its limits.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        for (value, (key, limits)) in self.limited() {
            check_range(key, value, limits)?;
        }
        if BITS.contains(&self.bits) {
            return Ok(());
        }
        let expected = "expected 8, 12 or 16, or 32 for numbers that are not rounded".to_owned();
        Err(Fault { key: "bits".into(), value: self.bits.to_string(), expected })
    }

    /// Time from the start of one line of this number of pixels to the start of the next, in s.
    pub fn line_s(&self, columns: usize) -> f64 {
        1e-6 * (columns as f64 * self.dwell_us + self.flyback_us)
    }

    /// The largest count of the converter; `None` for a converter that does not round.
    pub(crate) fn full_scale(&self) -> Option<f64> {
        (self.bits < 32).then(|| f64::from((1_u32 << self.bits) - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_changes_its_profile() {
        let table = AcquisitionTable {
            profile: Some(Profile::Poor),
            frames: Some(3),
            ..AcquisitionTable::default()
        };
        let poor = Profile::Poor.acquisition();
        assert_eq!(table.resolved(), Acquisition { frames: 3, ..poor });
        assert_eq!(AcquisitionTable::default().resolved(), Profile::Ideal.acquisition());
    }

    #[test]
    fn values_outside_their_limits_are_named() {
        let ideal = Profile::Ideal.acquisition();
        let fault = |change: fn(&mut Acquisition)| {
            let mut changed = ideal;
            change(&mut changed);
            changed.check().err().map(|fault| fault.key)
        };
        assert_eq!(fault(|_| {}), None);
        assert_eq!(fault(|a| a.dwell_us = -1.0).as_deref(), Some("dwell_us"));
        assert_eq!(fault(|a| a.frames = 0).as_deref(), Some("frames"));
        assert_eq!(fault(|a| a.drift_nm_per_s[1] = f64::NAN).as_deref(), Some("drift_nm_per_s"));
        assert_eq!(fault(|a| a.dqe = 0.0).as_deref(), Some("dqe"));
        let key = Some("contamination_angstrom3_per_electron");
        assert_eq!(fault(|a| a.contamination_angstrom3_per_electron = -1e-3).as_deref(), key);
        assert_eq!(fault(|a| a.contamination_angstrom3_per_electron = 11.0).as_deref(), key);
        assert_eq!(fault(|a| a.bits = 10).as_deref(), Some("bits"));
    }
}
