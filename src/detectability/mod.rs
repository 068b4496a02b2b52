//! Detectability: the dose at which a defect of a column is found.
//!
//! Two hypotheses are compared: the column as it is (0), and the column with the defect (1). Each has an expected image of the patch
//! around the column, and electrons are counted by Poisson's law. The likelihood ratio is the best test of the two (J. Neyman and E. S.
//! Pearson, Phil. Trans. R. Soc. A 231 (1933) 289), so no analyst finds the defect at a lower dose.
//!
//! In an experiment every electron meets its own phonon configuration, so the mean image over many configurations is the expectation, and
//! the scatter between configurations is no noise. The scatter of the *computed* mean is removed from the result: see `DefectSignal`.
//! Worlds average a stated number of configurations, and their scatter hides defects: [`DetectabilityRequest::averaged`].
//!
//! - [`DetectabilityRequest`]: the atoms, the defects, the microscope, with all defaults; [`AskedDefect`];
//! - `defect_site`: the column, the atoms of the defect, the box;
//! - `patch_images`: images of the patch in each phonon configuration;
//! - `DefectSignal`: the information per dose, corrected for the finite number of configurations; the best annulus;
//! - `PoissonTest` (known image), `MixtureTest` and `linear_observer`: three grades of the test;
//! - [`DetectabilityJob`] and its [`DetectabilityReport`].

mod asked_defect;
mod defect_signal;
mod defect_site;
mod detectability_job;
mod detectability_report;
mod detectability_request;
mod evaluate_case;
mod linear_observer;
mod mixture_test;
mod patch_images;
mod poisson_test;
mod power_plot;
mod roc;

pub use asked_defect::{AskedDefect, DefectDepth, DefectForm};
pub use detectability_job::{DetectabilityJob, DetectabilityPlan};
pub use detectability_report::{
    AnnulusFound, AtDose, DetectabilityCase, DetectabilityReport, DetectorDetectability,
    DoseVerdict, NeededDose,
};
pub use detectability_request::DetectabilityRequest;
pub use power_plot::power_svg;
pub use roc::TestPower;
