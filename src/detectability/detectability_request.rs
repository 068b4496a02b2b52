//! The request: everything that decides how well a defect can be found, with all defaults.

use serde::{Deserialize, Serialize};

use super::asked_defect::AskedDefect;
use crate::error::{Error, Result};
use crate::recipe::{CheckedRecipe, Recipe};
use crate::setting::Setting;
use crate::simulation::{
    AtomsSource, MicroscopeRequest, NumericsRequest, SigmaChoice, SpecimenRequest, check_detector,
};
use crate::structure::elements;

/// Least number of configurations: with fewer, the error of a result has no error bar.
pub const LEAST_CONFIGURATIONS: u32 = 4;
/// Most configurations: all images of a patch are kept.
const MOST_CONFIGURATIONS: u32 = 4096;
/// Limits of a patch's radius in Angstrom.
const RADII_ANGSTROM: [f64; 2] = [0.2, 10.0];
/// Limits of the width of rings in mrad.
const LEAST_RING_MRAD: f64 = 1.0;

/// Everything that decides how well a defect can be found. Each part except the atoms and the defects has a default. Unknown keys are
/// refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectabilityRequest {
    /// The atoms without defects: a structure file, or atoms in memory.
    pub structure: AtomsSource,
    /// The defects, each looked for alone: `vacancy:O@middle`.
    #[serde(default)]
    pub defects: Vec<AskedDefect>,
    /// Thicknesses in nm, each moved to a whole number of cells; empty: the thickness of the atoms as they are.
    #[serde(default)]
    pub thicknesses_nm: Vec<f64>,
    /// Doses in electrons per square Angstrom at which the test is reported.
    #[serde(default = "default_doses")]
    pub doses: Vec<f64>,
    /// Share of the columns without a defect that the test reports.
    #[serde(default = "default_false_alarms")]
    pub false_alarms: f64,
    /// Share of the defects that the test has to find.
    #[serde(default = "default_power")]
    pub power: f64,
    /// Share of the columns that hold the defect, for the average precision.
    #[serde(default = "default_rate")]
    pub rate: f64,
    /// Number of phonon configurations that are simulated.
    #[serde(default = "default_configurations")]
    pub configurations: u32,
    /// Number of configurations that an image averages, as in worlds, so that their scatter hides defects. `None`: an experiment, in which
    /// every electron meets its own configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averaged: Option<u32>,
    /// A place (x, y) in Angstrom in the box; the column nearest to it holds the defect. `None`: a column near the centre.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_angstrom: Option<[f64; 2]>,
    /// Elements of the column that holds the defect, `Ti-O`. `None`: the columns with the fewest other elements.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// Radius in Angstrom of the patch around the column whose pixels the test reads.
    #[serde(default = "default_radius")]
    pub radius_angstrom: f64,
    /// Distance of probes in Angstrom; `None`: half the Nyquist limit of the image, wavelength / (8 semiangle), with windows, and the
    /// Nyquist limit with other engines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_angstrom: Option<f64>,
    /// Width in mrad of the rings of which the best annulus is made; 0: no search.
    #[serde(default = "default_ring")]
    pub ring_mrad: f64,
    /// Number of simulated experiments of each hypothesis, where the test has no closed form.
    #[serde(default = "default_experiments")]
    pub experiments: usize,
    /// The dose of the recipe in electrons per square Angstrom, for the summary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recipe_dose: Option<f64>,
    /// Direction, size and vibrations of the atoms. The number of configurations is `configurations`.
    #[serde(default)]
    pub specimen: SpecimenRequest,
    /// The lens, the source and the detectors.
    #[serde(default)]
    pub microscope: MicroscopeRequest,
    /// Engine, grid, slices and probes. If no engine is named, windows with an error of 0.8 % are used, and the exact engine if a detector
    /// begins below two semiangles.
    #[serde(default)]
    pub numerics: NumericsRequest,
}

fn default_doses() -> Vec<f64> {
    vec![1e2, 1e3, 1e4, 1e5, 1e6]
}

fn default_false_alarms() -> f64 {
    0.01
}

fn default_power() -> f64 {
    0.9
}

fn default_rate() -> f64 {
    0.05
}

fn default_configurations() -> u32 {
    16
}

fn default_radius() -> f64 {
    1.2
}

fn default_ring() -> f64 {
    10.0
}

fn default_experiments() -> usize {
    4000
}

impl DetectabilityRequest {
    /// The request with defaults for everything but the atoms and the defects.
    pub fn new(structure: AtomsSource, defects: Vec<AskedDefect>) -> Self {
        DetectabilityRequest {
            structure,
            defects,
            thicknesses_nm: Vec::new(),
            doses: default_doses(),
            false_alarms: default_false_alarms(),
            power: default_power(),
            rate: default_rate(),
            configurations: default_configurations(),
            averaged: None,
            site_angstrom: None,
            column: None,
            radius_angstrom: default_radius(),
            step_angstrom: None,
            ring_mrad: default_ring(),
            experiments: default_experiments(),
            recipe_dose: None,
            specimen: SpecimenRequest::default(),
            microscope: MicroscopeRequest::default(),
            numerics: NumericsRequest::default(),
        }
    }

    /// The request for the crystal of a recipe without defects, with the recipe's thickness, vibrations, probe, detectors and dose. The
    /// defect is the vacancy or the substitution of the recipe, in the middle of the thickness, at the recipe's rate for one site.
    ///
    /// # Errors
    /// [`Error::Invalid`] for particles and files of atoms, which have no one crystal along the beam, and for elements that are unknown.
    pub fn of_recipe(recipe: &CheckedRecipe) -> Result<Self> {
        let structure = recipe.structure()?.clone();
        let mut request = Self::new(AtomsSource::Given(structure), Vec::new());
        if let Some((defect, rate)) = usual_defect(recipe)? {
            (request.defects, request.rate) = (vec![defect], rate);
        }
        request.thicknesses_nm = vec![recipe.field.thickness_nm];
        let dose = recipe.dose.electrons_per_angstrom2;
        request.recipe_dose = Some(dose);
        if !request.doses.contains(&dose) {
            request.doses.push(dose);
            request.doses.sort_by(f64::total_cmp);
        }
        request.specimen.seed = recipe.seed;
        request.specimen.sigma_angstrom =
            Some(SigmaChoice::ByElement(recipe.phonons.sigma_angstrom.clone()));
        request.microscope = MicroscopeRequest::of_recipe(recipe);
        Ok(request)
    }

    /// Refuses values outside their limits.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the setting and the limits.
    pub(crate) fn check(&self) -> Result<()> {
        let refuse =
            |setting, value: String, expected: &str| Err(Error::invalid(setting, value, expected));
        let share = |setting, value: f64| match value > 0.0 && value < 1.0 {
            true => Ok(()),
            false => Err(Error::invalid(setting, value, "expected a share above 0 and below 1")),
        };
        share(Setting::FalseAlarms, self.false_alarms)?;
        share(Setting::Power, self.power)?;
        share(Setting::DefectRate, self.rate)?;
        if self.power <= self.false_alarms {
            let expected =
                "has to exceed the share of false alarms, which a test reaches by guessing";
            return refuse(Setting::Power, self.power.to_string(), expected);
        }
        if self.defects.is_empty() {
            let expected = "name a defect to look for, such as vacancy:O";
            return refuse(Setting::Defect, "none".to_owned(), expected);
        }
        self.check_numbers()?;
        self.check_configurations()?;
        self.microscope.check()?;
        if self.microscope.defocus_angstrom.len() > 1 {
            let value = format!("{} values", self.microscope.defocus_angstrom.len());
            return refuse(Setting::Defocus, value, "expected one value; ask once for each");
        }
        if self.specimen.frames.is_some() {
            let expected = "a defect needs mean positions; give one frame, and phonons";
            return refuse(Setting::Frames, "given".to_owned(), expected);
        }
        if let Some(detector) =
            self.microscope.detectors.iter().find(|d| d.centre_of_mass.is_some())
        {
            let expected = "the test reads counted electrons; leave the centre of mass out";
            return refuse(Setting::Detector, detector.name.clone(), expected);
        }
        self.microscope.detectors.iter().try_for_each(check_detector)
    }

    fn check_numbers(&self) -> Result<()> {
        let [low, high] = RADII_ANGSTROM;
        if !(low..=high).contains(&self.radius_angstrom) {
            let expected = format!("expected {low} to {high} A");
            return Err(Error::invalid(
                Setting::PatchRadiusAngstrom,
                self.radius_angstrom,
                expected,
            ));
        }
        let positive = |value: &&f64| !(**value > 0.0 && value.is_finite());
        if let Some(bad) = self.doses.iter().find(positive) {
            let expected = "expected electrons per square Angstrom, above 0";
            return Err(Error::invalid(Setting::Dose, bad, expected));
        }
        if let Some(bad) = self.thicknesses_nm.iter().find(positive) {
            return Err(Error::invalid(Setting::DefectThicknessNm, bad, "expected nm, above 0"));
        }
        if let Some(bad) = self.step_angstrom.as_ref().filter(positive) {
            return Err(Error::invalid(Setting::Scan, format!("step of {bad} A"), "is above 0"));
        }
        if self.ring_mrad != 0.0 && !(LEAST_RING_MRAD..=1570.0).contains(&self.ring_mrad) {
            let expected = "expected a width from 1 mrad, or 0 for no search of an annulus";
            return Err(Error::invalid(Setting::RingWidthMrad, self.ring_mrad, expected));
        }
        if !(100..=10_000_000).contains(&self.experiments) {
            let expected = "expected 100 to 10 000 000 simulated experiments";
            return Err(Error::invalid(Setting::Experiments, self.experiments, expected));
        }
        if !self.thicknesses_nm.is_empty() && self.specimen.repeat.is_some() {
            let expected = "repetitions set the thickness too; leave one of the two out";
            return Err(Error::invalid(Setting::Repeat, "given", expected));
        }
        Ok(())
    }

    fn check_configurations(&self) -> Result<()> {
        let refuse = |value: u32, expected: String| {
            Err(Error::invalid(Setting::PhononConfigurations, value, expected))
        };
        if !(LEAST_CONFIGURATIONS..=MOST_CONFIGURATIONS).contains(&self.configurations) {
            let expected =
                format!("expected {LEAST_CONFIGURATIONS} to {MOST_CONFIGURATIONS}; 16 are usual");
            return refuse(self.configurations, expected);
        }
        match self.averaged {
            Some(0) => {
                let expected = "an image averages one configuration or more";
                Err(Error::invalid(Setting::AveragedConfigurations, 0, expected))
            }
            Some(n) if self.configurations < 4 * n.max(4) => refuse(
                self.configurations,
                format!(
                    "half of them make the data and half the test, and images that average {n} need several times as many; expected {} or more",
                    4 * n.max(4)
                ),
            ),
            _ => Ok(()),
        }
    }
}

/// The first defect of a recipe, in the middle of the thickness, and its rate.
fn usual_defect(recipe: &Recipe) -> Result<Option<(AskedDefect, f64)>> {
    let known = |text: String, rate| Ok(Some((text.parse()?, rate)));
    if let Some(alloy) = &recipe.alloy {
        return known(format!("substitution:{}:{}", alloy.host, alloy.guest), alloy.rate);
    }
    if let Some(vacancies) = &recipe.vacancies {
        return known(format!("vacancy:{}", vacancies.element), vacancies.rate);
    }
    match &recipe.substitutions {
        Some(s) => known(format!("substitution:{}:{}", s.element, s.by), s.rate),
        None => Ok(None),
    }
}

/// Atomic numbers of the elements of a column, from text such as `Ti-O`.
pub fn column_elements(text: &str) -> Result<Vec<u8>> {
    let parts = text.split(['-', ',', ' ']).filter(|part| !part.is_empty());
    let mut numbers = parts.map(elements::atomic_number).collect::<Result<Vec<u8>>>()?;
    numbers.sort_unstable();
    numbers.dedup();
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> DetectabilityRequest {
        let recipe = Recipe::load("srtio3", crate::recipe::Difficulty::Easy).unwrap();
        DetectabilityRequest::of_recipe(&recipe.checked().unwrap()).unwrap()
    }

    #[test]
    fn a_recipe_gives_its_own_values() {
        let request = request();
        request.check().unwrap();
        assert_eq!(request.defects[0].to_string(), "vacancy:O@middle");
        assert_eq!((request.rate, request.recipe_dose), (0.05, Some(1e4)));
        assert_eq!(request.microscope.optics(0.0), recipe_optics());
        assert_eq!(request.thicknesses_nm, [10.0]);
    }

    fn recipe_optics() -> crate::optics::Optics {
        Recipe::load("srtio3", crate::recipe::Difficulty::Easy).unwrap().optics.optics()
    }

    #[test]
    fn defaults_stand_in_one_place() {
        let given = r#"{"structure": "a.cif", "defects": ["vacancy:O"]}"#;
        let read: DetectabilityRequest = serde_json::from_str(given).unwrap();
        let defects = vec!["vacancy:O".parse().unwrap()];
        assert_eq!(read, DetectabilityRequest::new(AtomsSource::File("a.cif".into()), defects));
        let text = toml::to_string(&read).unwrap();
        assert_eq!(toml::from_str::<DetectabilityRequest>(&text).unwrap(), read);
        let unknown = r#"{"structure": "a.cif", "defects": [], "dose": 3}"#;
        assert!(serde_json::from_str::<DetectabilityRequest>(unknown).is_err());
    }

    #[test]
    fn values_outside_their_limits_are_refused_with_their_setting() {
        type Change = fn(&mut DetectabilityRequest);
        let cases: [(Setting, Change); 13] = [
            (Setting::FalseAlarms, |r| r.false_alarms = 0.0),
            (Setting::Power, |r| r.power = 1.0),
            (Setting::Power, |r| r.power = 0.005),
            (Setting::DefectRate, |r| r.rate = f64::NAN),
            (Setting::Defect, |r| r.defects.clear()),
            (Setting::Dose, |r| r.doses = vec![-1.0]),
            (Setting::DefectThicknessNm, |r| r.thicknesses_nm = vec![0.0]),
            (Setting::PatchRadiusAngstrom, |r| r.radius_angstrom = 0.0),
            (Setting::PhononConfigurations, |r| r.configurations = 1),
            (Setting::PhononConfigurations, |r| r.averaged = Some(8)),
            (Setting::AveragedConfigurations, |r| r.averaged = Some(0)),
            (Setting::RingWidthMrad, |r| r.ring_mrad = 0.01),
            (Setting::Repeat, |r| r.specimen.repeat = Some([1; 3])),
        ];
        for (setting, change) in cases {
            let mut changed = request();
            change(&mut changed);
            match changed.check() {
                Err(Error::Invalid { setting: found, .. }) => assert_eq!(found, setting),
                other => panic!("{setting:?}: {other:?}"),
            }
        }
    }

    #[test]
    fn particles_have_no_one_crystal() {
        let recipe = Recipe::load("pt", crate::recipe::Difficulty::Easy).unwrap();
        let error = DetectabilityRequest::of_recipe(&recipe.checked().unwrap()).unwrap_err();
        assert!(error.to_string().contains("crystal along a zone axis"), "{error}");
    }
}
