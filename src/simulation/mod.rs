//! Images of a user's atoms: the request as one value, and the job that fulfils it.
//!
//! A [`SimulationRequest`] holds everything that decides an image, and every default. The command line, Python and Rust fill
//! the same request; TOML files hold it ([`SimulationRequest::from_toml`]), and image files keep the one that made them.
//!
//! - [`SimulationRequest`] and its parts: [`SpecimenRequest`], [`MicroscopeRequest`], [`ScanRequest`], [`NumericsRequest`];
//! - `plausibility`: values that are possible, but hardly meant, as errors and [`Warning`]s;
//! - [`PreparedSpecimen`]: the atoms in their box;
//! - `engine_choice`: the fastest engine that keeps an accuracy, where the request leaves it open;
//! - [`SimulationJob`]: plans, warnings, memory and time, and the run: images, single probes, plane waves, diffraction patterns
//!   of single probes and of whole scans ([`PatternsRequest`]).
//!
//! ```
//! use stemgen::simulation::{SimulationJob, SimulationRequest};
//!
//! # fn main() -> stemgen::Result<()> {
//! let mut request = SimulationRequest::of_file("structures/si.cif");
//! request.specimen.repeat = Some([4, 4, 1]);
//! request.scan.end = Some([5.431, 5.431]);
//! request.scan.points = Some([4, 4]);
//! let job = SimulationJob::new(request)?;
//! let images = job.run(&stemgen::progress::Silent)?;
//! assert_eq!(images[0].name, "HAADF");
//! assert_eq!(images[0].data.shape(), [1, 4, 4]); // [thickness, y, x], fractions of the incident beam
//! # Ok(())
//! # }
//! ```

mod atoms;
mod engine_choice;
mod images;
mod job;
mod microscope;
mod numerics_request;
mod pattern_job;
mod plan_report;
mod plane_wave;
mod plausibility;
mod request;
mod scan;
mod source_patterns;
mod time_estimate;

pub use atoms::{AtomsSource, FromFile, FromTable, PreparedSpecimen, SigmaChoice, SpecimenRequest};
pub use images::{SimulatedImage, noisy_name};
pub use job::SimulationJob;
pub use microscope::MicroscopeRequest;
pub use numerics_request::{Engine, NumericsRequest};
pub(crate) use pattern_job::pattern_window_angstrom;
pub use pattern_job::{PatternBand, PatternValues, PatternsRequest, StoredPatterns};
pub use plan_report::{GridReport, PlanReport, SliceReport};
pub use plane_wave::PlaneWaveImages;
pub use plausibility::{Warning, check_detector, check_energy, check_hdf5_name, check_semiangle};
pub use request::SimulationRequest;
pub use scan::{LengthUnit, ScanRequest};
pub use time_estimate::{seconds, threads};
