//! The table `[optics]`: the probe, the tilt of the specimen, and the spread of source and focus.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::fault::{Checked, fault, within};
use crate::engine::Source;
use crate::error::Error;
use crate::optics::{Aberration, Aberrations, Optics};
use crate::resample::image_band_limit;
use crate::setting::Setting;

/// The probe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpticsTable {
    /// Accelerating voltage in kV.
    pub energy_kv: f64,
    /// Convergence semiangle in mrad.
    pub convergence_mrad: f64,
    /// Defocus from the entrance surface in Angstrom; positive is underfocus, with the focus deeper in the specimen.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub defocus_angstrom: f64,
    /// Mistilt (x, y) of the specimen in mrad (see [`Optics::tilt_mrad`]).
    #[serde(default, skip_serializing_if = "are_zero")]
    pub mistilt_mrad: [f64; 2],
    /// Standard deviation of the focus in Angstrom.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub focal_spread_angstrom: f64,
    /// Full width at half maximum of the electron source in Angstrom; 0 is a point.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub source_fwhm_angstrom: f64,
    /// Share of the source in long tails (see [`Source::lorentz_share`]).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub source_lorentz_share: f64,
    /// Aberrations by name, `C12` to `C56`, in Angstrom.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub aberrations_angstrom: BTreeMap<String, f64>,
    /// Azimuths of the aberrations in rad; 0 for aberrations without a value.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub azimuths_rad: BTreeMap<String, f64>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn are_zero(values: &[f64; 2]) -> bool {
    *values == [0.0; 2]
}

impl OpticsTable {
    /// Returns the optics of the probe. Aberrations whose name is not known are left out; a checked recipe has none.
    pub(crate) fn optics(&self) -> Optics {
        let mut aberrations = Aberrations::defocus(self.defocus_angstrom);
        let one = |(name, value): (&String, &f64)| self.aberration(name, *value).ok();
        aberrations.0.extend(self.aberrations_angstrom.iter().filter_map(one));
        Optics {
            energy_kev: self.energy_kv,
            semiangle_mrad: self.convergence_mrad,
            aberrations,
            tilt_mrad: self.mistilt_mrad,
            focal_spread_angstrom: self.focal_spread_angstrom,
            ..Optics::default()
        }
    }

    /// Returns the highest frequency in images, in 1/Angstrom.
    pub(crate) fn image_band_limit(&self) -> f64 {
        image_band_limit(&self.optics())
    }

    /// Returns the electron source; `None` for a point.
    pub(crate) fn source(&self) -> Option<Source> {
        let (fwhm_angstrom, lorentz_share) = (self.source_fwhm_angstrom, self.source_lorentz_share);
        (fwhm_angstrom != 0.0).then_some(Source { fwhm_angstrom, lorentz_share })
    }

    fn aberration(&self, name: &str, angstrom: f64) -> Result<Aberration, Error> {
        let azimuth = self.azimuths_rad.get(name).copied().unwrap_or_default();
        Aberration::parse(&format!("{name}={angstrom}@{azimuth}"))
    }
}

/// Checks the limits of the table's values.
pub(crate) fn check_optics(optics: &OpticsTable) -> Checked {
    within("optics.energy_kv", optics.energy_kv, 10.0, 1500.0)?;
    within("optics.convergence_mrad", optics.convergence_mrad, 0.1, 100.0)?;
    within("optics.defocus_angstrom", optics.defocus_angstrom, -1e4, 1e4)?;
    for (name, value) in &optics.aberrations_angstrom {
        let key = format!("optics.aberrations_angstrom.{name}");
        if name == "C10" && optics.defocus_angstrom != 0.0 {
            return fault(
                &key,
                value,
                "expected none: defocus_angstrom sets the defocus (C10 is minus it)",
            );
        }
        optics.aberration(name, *value).map_err(|e| of(&key, value, e))?;
    }
    for (name, value) in &optics.azimuths_rad {
        if !optics.aberrations_angstrom.contains_key(name) {
            let expected = "expected an aberration that aberrations_angstrom lists";
            return fault(&format!("optics.azimuths_rad.{name}"), value, expected);
        }
    }
    optics.optics().validate().map_err(|error| {
        let key = match &error {
            Error::Invalid { setting: Setting::MistiltMrad, .. } => "optics.mistilt_mrad",
            Error::Invalid { setting: Setting::FocalSpreadAngstrom, .. } => {
                "optics.focal_spread_angstrom"
            }
            _ => "optics.aberrations_angstrom",
        };
        of(key, "", error)
    })?;
    let source = optics.source().map_or(Ok(()), |source| source.validate());
    source.map_err(|error| match &error {
        Error::Invalid { setting: Setting::SourceLorentzShare, .. } => {
            of("optics.source_lorentz_share", "", error)
        }
        _ => of("optics.source_fwhm_angstrom", "", error),
    })?;
    within("optics.source_lorentz_share", optics.source_lorentz_share, 0.0, 1.0)
}

/// Converts an error of the engine to a fault of a key.
fn of(key: &str, value: impl ToString, error: Error) -> super::fault::Fault {
    let (value, expected) = match error {
        Error::Invalid { value, expected, .. } => (value, expected),
        other => (value.to_string(), other.to_string()),
    };
    super::fault::Fault { key: key.to_owned(), value, expected }
}

#[cfg(test)]
mod tests {
    use crate::recipe::{Difficulty, Override, Recipe};

    fn with(change: &str) -> crate::Result<Recipe> {
        let change: Override = change.parse()?;
        let recipe = Recipe::load("srtio3", Difficulty::Easy)?.with_overrides(&[change])?;
        Ok(recipe.checked()?.recipe().clone())
    }

    #[test]
    fn optics_are_read() {
        let recipe = with(
            "optics={defocus_angstrom=50, mistilt_mrad=[3, -1], aberrations_angstrom={C12=30, C30=1e4}, azimuths_rad={C12=0.3}}",
        );
        let recipe = recipe.unwrap();
        let optics = recipe.optics.optics();
        assert_eq!(optics.tilt_mrad, [3.0, -1.0]);
        assert_eq!(optics.aberrations.0.len(), 3);
        assert_eq!(optics.aberrations.0[0].magnitude_angstrom, -50.0);
        assert_eq!(optics.aberrations.0[1].azimuth_rad, 0.3);
        assert!(recipe.optics.source().is_none());
        assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        let source = with("optics.source_fwhm_angstrom=0.9").unwrap().optics.source().unwrap();
        assert_eq!((source.fwhm_angstrom, source.lorentz_share), (0.9, 0.0));
    }

    #[test]
    fn what_no_microscope_has_is_refused_with_the_range() {
        for (change, parts) in [
            ("optics.mistilt_mrad=[2000, 0]", ["mistilt_mrad", "from -20 to 20"]),
            ("optics.focal_spread_angstrom=1e5", ["focal_spread_angstrom", "from 0 to"]),
            ("optics.focal_spread_angstrom=-3", ["focal_spread_angstrom", "from 0 to"]),
            ("optics.source_fwhm_angstrom=-0.5", ["source_fwhm_angstrom", "above 0"]),
            ("optics.source_lorentz_share=2", ["source_lorentz_share", "from 0"]),
            ("optics.defocus_angstrom=1e9", ["defocus_angstrom", "from -10000"]),
            ("optics.aberrations_angstrom.C11=3", ["C11", "C56"]),
            ("optics.azimuths_rad.C12=3", ["azimuths_rad.C12", "aberrations_angstrom lists"]),
            ("optics.defocus=3", ["defocus", "did you mean `defocus_angstrom`?"]),
        ] {
            let message = with(change).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{change}: {message}");
            }
        }
    }
}
