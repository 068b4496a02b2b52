//! From the noise-free image to the recording: where the beam really was, how many electrons came, and what the detector
//! made of them.

mod acquisition_settings;
mod detector_chain;
mod exposure;
mod profiles;
mod recorder;
mod scan_path;
mod source_image;

pub use acquisition_settings::{Acquisition, AcquisitionTable};
pub use detector_chain::{Counted, DetectorChain};
pub use exposure::{ELECTRONS_PER_PA_US, Exposure};
pub use profiles::Profile;
pub use recorder::{RecordedRows, Recorder, clipping_warning};
pub use scan_path::{ScanFrame, ScanPath};
pub use source_image::SourceImage;
