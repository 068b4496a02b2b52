//! Recorded images: files of microscopes and of the programs that evaluate their images.
//!
//! | file | what it says of its pixels |
//! |---|---|
//! | DM3, DM4 (DigitalMicrograph) | size and unit of each image |
//! | EMD of Velox | size, detector and energy of each image |
//! | HDF5 of HyperSpy | size and unit of each axis, as far as they were set |
//! | HDF5 of the atomically resolved BiFeO3 images of the STEMGym paper | its scale, the places and polarisations of unit cells |
//! | any other HDF5 (py4DSTEM, Berkeley EMD ...) | what stands beside its image, where that is known |
//! | `.tif`, `.npy`, `.npz`, zarr | nothing, but in TIFF and zarr of abTEM |
//!
//! The kind of a file is found in its first bytes. Values are read as they are stored; none are scaled.

mod dm_image;
mod dm_tags;
mod hdf5_source;
mod hyperspy_signal;
mod length_units;
mod other_array;
mod unit_cells;
mod velox_image;

use std::io::Read;
use std::path::{Path, PathBuf};

use ndarray::Array2;

use crate::error::{Error, Result};
use crate::setting::Setting;
use hdf5_source::Hdf5Source;
pub use length_units::StatedPixel;
pub use unit_cells::RecordedCells;

/// Kinds of files with recorded images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordedFormat {
    /// DigitalMicrograph, version 3.
    Dm3,
    /// DigitalMicrograph, version 4.
    Dm4,
    /// HDF5 of Velox.
    VeloxEmd,
    /// HDF5 of HyperSpy.
    HyperSpy,
    /// HDF5 with unit cells and their polarisation.
    UnitCells,
    /// Any other HDF5.
    Hdf5,
    /// An array of `.tif`, `.npy`, `.npz` or zarr.
    Array,
}

impl RecordedFormat {
    /// The name for a reader.
    pub fn name(self) -> &'static str {
        match self {
            RecordedFormat::Dm3 => "DM3",
            RecordedFormat::Dm4 => "DM4",
            RecordedFormat::VeloxEmd => "Velox EMD",
            RecordedFormat::HyperSpy => "HyperSpy",
            RecordedFormat::UnitCells => "HDF5 with unit cells",
            RecordedFormat::Hdf5 => "HDF5",
            RecordedFormat::Array => "array",
        }
    }
}

/// Which image of a file that holds several.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ImageChoice {
    /// Name of the image, or path of its data set.
    pub dataset: Option<String>,
    /// Number of the frame, from 0.
    pub index: Option<usize>,
}

/// A recorded image, with what its file says of it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RecordedImage {
    /// The file.
    pub path: PathBuf,
    /// Its kind.
    pub format: RecordedFormat,
    /// Name of the image in the file; may be empty.
    pub name: String,
    /// The values, [row, column], as they are stored; those that are no finite numbers were not recorded.
    pub pixels: Array2<f64>,
    /// Edge of a pixel in nm as the file says, or why that is not known.
    pub pixel_nm: StatedPixel,
    /// Unit cells that the file lists.
    pub cells: Option<RecordedCells>,
    /// Energy of the electrons, if the file tells it.
    pub energy_kev: Option<f64>,
    /// Name of the detector, if the file tells it.
    pub detector: Option<String>,
}

/// First bytes of an HDF5 file.
const HDF5_MARK: &[u8] = b"\x89HDF\r\n\x1a\n";

/// What the first bytes of a file say that it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FileKind {
    Dm,
    Hdf5,
    Other,
}

impl FileKind {
    fn of(path: &Path) -> Result<Self> {
        let about = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
        if !about.is_file() {
            return Ok(FileKind::Other);
        }
        let file = std::fs::File::open(path).map_err(|e| Error::io(path, "read", e))?;
        let mut first = Vec::new();
        let read = file.take(HDF5_MARK.len() as u64).read_to_end(&mut first);
        read.map_err(|e| Error::io(path, "read", e))?;
        Ok(match first.as_slice() {
            HDF5_MARK => FileKind::Hdf5,
            [0, 0, 0, 3 | 4, ..] => FileKind::Dm,
            _ => FileKind::Other,
        })
    }
}

/// Whether a file is one for the HDF5 library.
///
/// # Errors
/// [`Error::Io`].
pub fn is_hdf5_inside(path: &Path) -> Result<bool> {
    FileKind::of(path).map(|kind| kind == FileKind::Hdf5)
}

/// Reads an image.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a foreign or damaged file, a wrong name, and values that are no real numbers;
/// [`Error::Choice`] where the file holds several images or frames and none is chosen: both list what there is.
pub fn read(path: &Path, choice: &ImageChoice) -> Result<RecordedImage> {
    let image = match FileKind::of(path)? {
        FileKind::Dm => dm_image::read(path, choice),
        FileKind::Hdf5 => {
            let source = Hdf5Source::open(path)?;
            if velox_image::is_one(&source) {
                velox_image::read(&source, choice)
            } else if hyperspy_signal::is_one(&source) {
                hyperspy_signal::read(&source, choice)
            } else if unit_cells::is_one(&source, choice) {
                unit_cells::read(&source, choice)
            } else {
                other_array::read_hdf5(&source, choice)
            }
        }
        FileKind::Other => other_array::read_plain(path, choice),
    }?;
    match image.pixels.is_empty() {
        true => Err(Error::parse(path, 0, format!("`{}` holds no pixels", image.name))),
        false => Ok(image),
    }
}

/// The frame to read of so many, from 0.
fn frame_of(path: &Path, name: &str, frames: usize, index: Option<usize>) -> Result<usize> {
    let last = frames.saturating_sub(1);
    let choice = |message: String| Err(Error::choice(path, Setting::ImageIndex, message));
    match index {
        None if frames == 1 => Ok(0),
        None => choice(format!("`{name}` holds {frames} frames; choose one, from 0 to {last}")),
        Some(index) if index < frames => Ok(index),
        Some(index) => {
            choice(format!("`{name}` has no frame {index}; it has those from 0 to {last}"))
        }
    }
}
