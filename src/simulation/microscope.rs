//! The lens, the source and the detectors.

use serde::{Deserialize, Serialize};

use super::plausibility::{self, Warning};
use crate::detect::Detector;
use crate::engine::{Settings, Source};
use crate::error::{Error, Result};
use crate::optics::{Aberration, Aberrations, Optics};
use crate::recipe::Recipe;
use crate::setting::Setting;

/// The lens, the source and the detectors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MicroscopeRequest {
    /// Beam energy in keV.
    pub energy_kev: f64,
    /// Semiangle of the probe-forming aperture in mrad. For a plane wave it is the semiangle of the objective aperture.
    pub semiangle_mrad: f64,
    /// Defocus in Angstrom from the entrance surface; positive is underfocus, with the focus deeper in the specimen. Several values make a
    /// series.
    pub defocus_angstrom: Vec<f64>,
    /// Coefficients of the aberration function except the defocus.
    pub aberrations: Vec<Aberration>,
    /// Mistilt of the specimen (x, y) in mrad: the beam runs along (tan x, tan y, 1) of the box.
    pub tilt_mrad: [f64; 2],
    /// Standard deviation of the focus in Angstrom, over which images are averaged.
    pub focal_spread_angstrom: f64,
    /// Full width of the source at half maximum in Angstrom, at the specimen; `None`: a point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source_size_angstrom: Option<f64>,
    /// Share of the source in long tails (Lorentz profile), from 0 to 1.
    pub source_lorentz_share: f64,
    /// Detectors, in the order of the images.
    pub detectors: Vec<Detector>,
    /// Continue with a warning if a detector reaches beyond the angles of the grid.
    pub allow_empty_angles: bool,
}

impl Default for MicroscopeRequest {
    fn default() -> Self {
        let Settings { optics, detectors, .. } = Settings::default();
        MicroscopeRequest {
            energy_kev: optics.energy_kev,
            semiangle_mrad: optics.semiangle_mrad,
            defocus_angstrom: vec![0.0],
            aberrations: Vec::new(),
            tilt_mrad: optics.tilt_mrad,
            focal_spread_angstrom: optics.focal_spread_angstrom,
            source_size_angstrom: None,
            source_lorentz_share: 0.0,
            detectors,
            allow_empty_angles: false,
        }
    }
}

impl MicroscopeRequest {
    /// The lens, the source and the detectors of a recipe.
    pub(crate) fn of_recipe(recipe: &Recipe) -> Self {
        let optics = recipe.optics.optics();
        let source = recipe.optics.source();
        // The request holds the defocus separately, which a recipe may also give as C10.
        let defocus_angstrom = vec![optics.aberrations.defocus_angstrom()];
        let mut aberrations = optics.aberrations.0;
        aberrations.retain(|a| (a.order, a.symmetry) != (1, 0));
        MicroscopeRequest {
            energy_kev: recipe.optics.energy_kv,
            semiangle_mrad: optics.semiangle_mrad,
            defocus_angstrom,
            aberrations,
            tilt_mrad: optics.tilt_mrad,
            focal_spread_angstrom: optics.focal_spread_angstrom,
            source_size_angstrom: source.map(|source| source.fwhm_angstrom),
            source_lorentz_share: source.map_or(0.0, |source| source.lorentz_share),
            detectors: recipe.detector.asked(),
            allow_empty_angles: false,
        }
    }

    /// The source; `None` for a point.
    pub(crate) fn source(&self) -> Option<Source> {
        let lorentz_share = self.source_lorentz_share;
        self.source_size_angstrom.map(|fwhm_angstrom| Source { fwhm_angstrom, lorentz_share })
    }

    /// Refuses values that no microscope has, and values that are likely mistakes.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the expected value.
    pub fn check(&self) -> Result<()> {
        plausibility::check_energy(self.energy_kev)?;
        plausibility::check_semiangle(self.semiangle_mrad)?;
        let [first, ..] = self.defocus_angstrom[..] else {
            return Err(Error::invalid(
                Setting::Defocus,
                "none",
                "expected a length in A, or several",
            ));
        };
        for defocus in &self.defocus_angstrom {
            if !defocus.is_finite() {
                return Err(Error::invalid(Setting::Defocus, defocus, "expected a length in A"));
            }
        }
        let series = self.defocus_angstrom.len() > 1;
        plausibility::check_aberrations(first, series, &self.aberrations)?;
        self.detectors.iter().try_for_each(plausibility::check_detector)?;
        self.check_image_names()?;
        if self.source_lorentz_share != 0.0 && self.source_size_angstrom.is_none() {
            let expected = "is a share of a source that has a size; give the size too";
            return Err(Error::invalid(
                Setting::SourceLorentzShare,
                self.source_lorentz_share,
                expected,
            ));
        }
        self.source().map_or(Ok(()), |source| source.validate())
    }

    /// Refuses two images of one name.
    fn check_image_names(&self) -> Result<()> {
        let images: Vec<Detector> = self.detectors.iter().flat_map(Detector::images).collect();
        let twice = |(n, d): &(usize, &Detector)| images[..*n].iter().any(|e| e.name == d.name);
        match images.iter().enumerate().find(twice) {
            None => Ok(()),
            Some((_, d)) => Err(Error::invalid(Setting::DetectorName, &d.name, "is used twice")),
        }
    }

    /// Warnings about values that are possible, but likely mistakes.
    pub(crate) fn warnings(&self) -> Vec<Warning> {
        self.aberrations.iter().filter_map(plausibility::check_azimuth).collect()
    }

    /// The optics at one value of the defocus, in Angstrom.
    pub(crate) fn optics(&self, defocus_angstrom: f64) -> Optics {
        let mut aberrations = Aberrations::defocus(defocus_angstrom);
        aberrations.0.extend(self.aberrations.iter().copied());
        Optics {
            energy_kev: self.energy_kev,
            semiangle_mrad: self.semiangle_mrad,
            aberrations,
            tilt_mrad: self.tilt_mrad,
            focal_spread_angstrom: self.focal_spread_angstrom,
            ..Optics::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl Fn(&mut MicroscopeRequest)) -> (Setting, String) {
        let mut request = MicroscopeRequest::default();
        change(&mut request);
        match request.check().unwrap_err() {
            Error::Invalid { setting, expected, .. } => (setting, expected),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn the_default_is_that_of_the_engine() {
        let request = MicroscopeRequest::default();
        request.check().unwrap();
        assert_eq!(request.optics(0.0), Optics::default());
    }

    #[test]
    fn what_is_hardly_meant_is_refused_with_its_setting() {
        assert_eq!(refused(|m| m.energy_kev = 200e3).0, Setting::EnergyKev);
        assert_eq!(refused(|m| m.semiangle_mrad = 0.021).0, Setting::SemiangleMrad);
        assert_eq!(refused(|m| m.defocus_angstrom = Vec::new()).0, Setting::Defocus);
        assert_eq!(refused(|m| m.defocus_angstrom = vec![0.0, f64::NAN]).0, Setting::Defocus);
        assert_eq!(refused(|m| m.source_lorentz_share = 0.5).0, Setting::SourceLorentzShare);
        assert_eq!(refused(|m| m.source_size_angstrom = Some(-1.0)).0, Setting::SourceSizeAngstrom);
        let (setting, expected) = refused(|m| m.detectors = vec![Detector::new("H", 0.068, 0.2)]);
        assert_eq!(setting, Setting::Detector);
        assert!(expected.contains("did you mean H=68-200?"), "{expected}");
        let twice = || vec![Aberration::parse("C30=1").unwrap(); 2];
        assert_eq!(refused(|m| m.aberrations = twice()).0, Setting::Aberration);
        let defocus = |m: &mut MicroscopeRequest| {
            m.aberrations = vec![Aberration::parse("C10=5").unwrap()];
            m.defocus_angstrom = vec![20.0];
        };
        assert!(refused(defocus).1.contains("C10 is minus the defocus"));
    }
}
