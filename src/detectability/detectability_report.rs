//! How well defects are found: numbers, sentences, and a table.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::asked_defect::AskedDefect;
use super::roc::TestPower;

/// Whether a dose suffices to find a defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DoseVerdict {
    /// The dose is known.
    Found,
    /// No dose suffices: the defect changes nothing, or the scatter of other causes hides it.
    Never,
    /// The signal is not above 0 by two standard errors. The lower end of the range is a lower limit of the dose.
    Unresolved,
}

/// The dose at which a defect is found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NeededDose {
    /// Whether there is a dose.
    pub verdict: DoseVerdict,
    /// The dose in electrons per square Angstrom.
    pub electrons_per_angstrom2: Option<f64>,
    /// The dose plus and minus one standard error; an end that no simulation bounds is missing.
    pub range: [Option<f64>; 2],
}

impl NeededDose {
    /// No dose suffices.
    pub(crate) const NEVER: NeededDose =
        NeededDose { verdict: DoseVerdict::Never, electrons_per_angstrom2: None, range: [None; 2] };

    /// The dose in words: `3.4e6 (3.1e6 to 3.8e6)`.
    pub fn words(&self) -> String {
        match (self.verdict, self.electrons_per_angstrom2, self.range) {
            (DoseVerdict::Found, Some(dose), [Some(low), Some(high)]) => {
                format!("{} ({} to {})", short(dose), short(low), short(high))
            }
            (DoseVerdict::Found, Some(dose), _) => short(dose),
            (DoseVerdict::Unresolved, _, [Some(least), _]) => format!("above {}", short(least)),
            (DoseVerdict::Unresolved, ..) => "unresolved".to_owned(),
            _ => "not at any dose".to_owned(),
        }
    }
}

/// A number with two significant digits: `3.4e6`, `250`.
pub fn short(value: f64) -> String {
    let exponent = format!("{value:.1e}");
    match value.abs() {
        v if (1e-2..1e3).contains(&v) => {
            let digits = (1 - v.log10().floor() as i32).max(0) as usize;
            format!("{value:.digits$}")
        }
        _ => exponent.replace(".0e", "e"),
    }
}

/// The tests at one dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AtDose {
    /// Electrons per square Angstrom.
    pub electrons_per_angstrom2: f64,
    /// Electrons that the patch counts on the detector.
    pub counted_electrons: f64,
    /// The test with known images: counting statistics alone. At an unknown depth: the mean over depths that are known.
    pub known: TestPower,
    /// The linear observer of images that average few configurations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub linear: Option<TestPower>,
    /// The mixture of depths, or of phonon patterns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mixture: Option<TestPower>,
    /// Least standard error of the column's place (x, y) in Angstrom (Cramer and Rao).
    pub position_error_angstrom: [f64; 2],
}

/// How well one detector finds a defect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorDetectability {
    /// Name of the detector.
    pub detector: String,
    /// Inner and outer angle in mrad.
    pub annulus_mrad: [f64; 2],
    /// Change of the patch by the defect in per cent of the patch.
    pub contrast_percent: f64,
    /// Squared d' for one electron per square Angstrom.
    pub information_angstrom2: f64,
    /// Standard error of the information.
    pub information_error_angstrom2: f64,
    /// The needed dose with known images.
    pub known: NeededDose,
    /// The needed dose of the linear observer, for images that average few configurations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub linear: Option<NeededDose>,
    /// The needed dose for a mixture of depths or phonon patterns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mixture: Option<NeededDose>,
    /// The tests at each dose.
    pub doses: Vec<AtDose>,
}

impl DetectorDetectability {
    /// The needed dose of the question that was asked: of the linear observer for images that average few configurations, of the mixture
    /// at an unknown depth, else with known images.
    pub fn needed(&self) -> NeededDose {
        self.linear.or(self.mixture).unwrap_or(self.known)
    }

    /// The least standard error of the column's place at a dose in electrons per square Angstrom, in pm: the larger of x and y. It falls
    /// with the root of the dose. NaN if the report has no doses.
    pub fn place_error_pm(&self, dose: f64) -> f64 {
        let at = |at: &AtDose| {
            let [x, y] = at.position_error_angstrom;
            100.0 * x.max(y) * (at.electrons_per_angstrom2 / dose).sqrt()
        };
        self.doses.first().map_or(f64::NAN, at)
    }
}

/// An annulus made of rings, and its result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AnnulusFound {
    /// Inner and outer angle in mrad.
    pub annulus_mrad: [f64; 2],
    /// Squared d' for one electron per square Angstrom.
    pub information_angstrom2: f64,
    /// Standard error of the information.
    pub information_error_angstrom2: f64,
    /// The needed dose with known images.
    pub needed: NeededDose,
}

/// A defect at one thickness.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectabilityCase {
    /// The defect.
    pub defect: AskedDefect,
    /// Thickness in nm, a whole number of cells.
    pub thickness_nm: f64,
    /// Elements of the column with their numbers of atoms: `Ti26 O26`.
    pub column: String,
    /// Place (x, y) of the column in the box, in Angstrom.
    pub site_angstrom: [f64; 2],
    /// Heights of the changed atoms in nm from the entrance surface.
    pub depths_nm: Vec<f64>,
    /// One result for each detector.
    pub detectors: Vec<DetectorDetectability>,
    /// The annulus with the lowest needed dose, of whole rings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best_annulus: Option<AnnulusFound>,
    /// All rings, each counted and weighed alone: no set of annuli within their angles needs less.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub all_rings: Option<AnnulusFound>,
}

/// How well defects are found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectabilityReport {
    /// Name of the material or of the file.
    pub name: String,
    /// Number of simulated phonon configurations.
    pub configurations: u32,
    /// Number of configurations that an image averages; `None` for an experiment.
    pub averaged: Option<u32>,
    /// The share of the defects that is to be found.
    pub power: f64,
    /// The share of false alarms.
    pub false_alarms: f64,
    /// The share of columns with the defect, for average precisions.
    pub rate: f64,
    /// The recipe's dose in electrons per square Angstrom.
    pub recipe_dose: Option<f64>,
    /// Beam energy in keV.
    pub energy_kev: f64,
    /// Semiangle of the probe in mrad.
    pub semiangle_mrad: f64,
    /// Radius of the patch in Angstrom.
    pub radius_angstrom: f64,
    /// Distance of the probes in Angstrom.
    pub step_angstrom: f64,
    /// The algorithm that made the images.
    pub engine: String,
    /// All cases: thicknesses, and in each the defects.
    pub cases: Vec<DetectabilityCase>,
}

impl DetectabilityReport {
    /// One sentence for each case and detector.
    pub fn sentences(&self) -> Vec<String> {
        let each = |case: &DetectabilityCase| {
            let one = |found: &DetectorDetectability| self.sentence(case, found);
            case.detectors.iter().map(one).collect::<Vec<_>>()
        };
        self.cases.iter().flat_map(each).collect()
    }

    /// The sentence of a case and a detector: "A missing O atom in the middle of 10 nm of srtio3 (column O26) is found ...".
    pub(crate) fn sentence(
        &self,
        case: &DetectabilityCase,
        found: &DetectorDetectability,
    ) -> String {
        let defect = case.defect.words();
        let article = if defect.starts_with(['A', 'E', 'I', 'O']) { "An" } else { "A" };
        let link = if defect.ends_with("middle") { "of" } else { "in" };
        let mut text = format!(
            "{article} {defect} {link} {:.1} nm of {} (column {})",
            case.thickness_nm, self.name, case.column
        );
        let aims = format!(
            "{} % power at {} % false alarms",
            percent(self.power),
            percent(self.false_alarms)
        );
        let needed = found.needed();
        match needed.verdict {
            DoseVerdict::Found => {
                let dose = needed.electrons_per_angstrom2.map(short).unwrap_or_default();
                let _ = write!(
                    text,
                    " is found on {} with {aims} from {dose} electrons per square Angstrom",
                    found.detector
                );
            }
            DoseVerdict::Never => {
                let _ = write!(text, " is not found on {} with {aims} at any dose", found.detector);
            }
            DoseVerdict::Unresolved => {
                let least = needed.range[0].map(short).unwrap_or_default();
                let _ = write!(
                    text,
                    " needs more than {least} electrons per square Angstrom on {}; more phonon configurations would give the dose",
                    found.detector
                );
            }
        }
        if let Some(dose) = self.recipe_dose {
            let _ = write!(text, "; the recipe gives {}", short(dose));
        }
        text + "."
    }

    /// The report as a table (CSV): one line for each case, detector and dose.
    pub fn to_csv(&self) -> String {
        let mut text = String::from(
            "defect,thickness_nm,column,detector,inner_mrad,outer_mrad,contrast_percent,information_angstrom2,\
             information_error_angstrom2,verdict,needed_dose,needed_low,needed_high,dose,d_prime,auc,power,\
             average_precision,position_error_x_angstrom,position_error_y_angstrom\n",
        );
        let optional = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
        for case in &self.cases {
            for found in &case.detectors {
                let needed = found.needed();
                let verdict = match needed.verdict {
                    DoseVerdict::Found => "found",
                    DoseVerdict::Never => "never",
                    DoseVerdict::Unresolved => "unresolved",
                };
                for at in &found.doses {
                    let test = at.linear.as_ref().or(at.mixture.as_ref()).unwrap_or(&at.known);
                    let fields = [
                        case.defect.to_string(),
                        case.thickness_nm.to_string(),
                        case.column.clone(),
                        found.detector.clone(),
                        found.annulus_mrad[0].to_string(),
                        found.annulus_mrad[1].to_string(),
                        found.contrast_percent.to_string(),
                        found.information_angstrom2.to_string(),
                        found.information_error_angstrom2.to_string(),
                        verdict.to_owned(),
                        optional(needed.electrons_per_angstrom2),
                        optional(needed.range[0]),
                        optional(needed.range[1]),
                        at.electrons_per_angstrom2.to_string(),
                        test.d_prime.to_string(),
                        test.auc.to_string(),
                        test.power.to_string(),
                        test.average_precision.to_string(),
                        at.position_error_angstrom[0].to_string(),
                        at.position_error_angstrom[1].to_string(),
                    ];
                    text += &fields.join(",");
                    text.push('\n');
                }
            }
        }
        text
    }
}

/// A share in per cent, without needless digits.
fn percent(share: f64) -> f64 {
    (share * 1e6).round() / 1e4
}
