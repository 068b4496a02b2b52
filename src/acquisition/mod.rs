//! From the noise-free image to the recording: the real positions of the beam, the electrons, and the response of the detector.

mod acquisition_settings;
mod detector_chain;
mod exposure;
mod profiles;
mod recorder;
mod scan_path;
mod source_image;

pub use acquisition_settings::{Acquisition, AcquisitionTable, DetectorValues};
pub use detector_chain::DetectorChain;
pub use exposure::Exposure;
pub use profiles::Profile;
pub use recorder::{RecordedRows, Recorder, clipping_warning};
pub use scan_path::{ScanFrame, ScanPath};
pub use source_image::SourceImage;
