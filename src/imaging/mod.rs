//! Imaging: the noise-free image of any rectangle of a field.
//!
//! specimen -> slices -> engine -> detector image. A [`RegionImager`] makes the image in one of three ways: `direct` simulates each
//! rectangle with its own atoms, `mosaic` shares simulations among similar columns, `film` lets the light atoms of a thin film scatter
//! independently. `choose` picks the imager, and `audit` measures its error. `turned_raster` makes images at places between
//! pixels. `source_imager` blurs an image by the electron source.

pub(crate) mod audit;
mod choose;
pub(crate) mod direct;
pub(crate) mod displaced_atoms;
pub(crate) mod film;
mod imaging_cost;
mod mosaic;
mod noise;
mod one_detector;
pub(crate) mod pixels;
pub(crate) mod region_imager;
pub(crate) mod simulator;
pub(crate) mod source_imager;
mod turned_raster;

pub use audit::column_statistics::KindAudit;
pub(crate) use audit::kept_audits::KeptAudits;
pub use audit::power_spectrum::PowerBand;
pub(crate) use audit::region_audit::{AUDIT_REMEDY, audit_cost};
pub use audit::region_audit::{Audit, AuditOptions, RegionAudit, audit};
pub(crate) use choose::ChosenImager;
pub use choose::{ImagingCheck, ImagingChoice, MethodChoice};
pub use direct::DirectImager;
pub use displaced_atoms::{DisplacedAtoms, mean_atoms};
pub use film::film_imager::FilmImager;
pub(crate) use film::grown_carbon::MOST_GROWN_ANGSTROM;
pub use film::grown_carbon::{CarbonPatch, GrownCarbon};
pub use film::surface_imager::SurfaceImager;
pub use imaging_cost::{ImagingCost, SimulationRuns};
pub use mosaic::image_library::RecomputedImage;
pub use mosaic::image_note::NewImages;
#[cfg(feature = "hdf5")]
pub use mosaic::library_archive;
pub use mosaic::library_cache::{Cache, CacheFault, Holding};
pub use mosaic::mosaic_cost::MosaicCost;
pub use mosaic::mosaic_imager::MosaicImager;
pub(crate) use mosaic::shared_cells::SharedCells;
pub use mosaic::supplied_images;
#[cfg(feature = "hdf5")]
pub use mosaic::supplied_library::SuppliedLibrary;
pub use mosaic::survey::FieldSurvey;
pub(crate) use noise::{Noise, check_countable};
pub use one_detector::OneDetector;
pub use pixels::{PixelBox, PixelRect};
pub use region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
pub use simulator::Simulator;
pub(crate) use turned_raster::overview_image;
pub(crate) use turned_raster::turned_images_of_others;
pub use turned_raster::{TurnedRaster, turned_image};
