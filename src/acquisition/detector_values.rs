//! The detector chain of one of several detectors.

use serde::{Deserialize, Serialize};

use super::acquisition_settings::Acquisition;

/// Declares [`DetectorValues`], in which every value is optional.
macro_rules! detector_values {
    ($($(#[doc = $doc:literal])* $name:ident: $kind:ty,)*) => {
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

detector_values! {
    /// Detective quantum efficiency.
    dqe: f64,
    /// Share of the light that is emitted late.
    afterglow_share: f64,
    /// Time in which the late light falls to 1/e, in microseconds.
    afterglow_us: f64,
    /// Current on the detector in pA at which half of the signal is lost; 0: the detector is linear.
    saturation_pa: f64,
    /// Counts of one electron.
    gain_counts: f64,
    /// Counts without electrons.
    dark_counts: f64,
    /// Standard deviation of the read-out noise of one pixel in counts.
    read_noise_counts: f64,
    /// Bits of the converter.
    bits: u32,
}
