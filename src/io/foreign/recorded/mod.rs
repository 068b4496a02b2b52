//! Reads recorded images: files of microscopes and of the programs that evaluate their images.
//!
//! | file | information about its pixels |
//! |---|---|
//! | DM3, DM4 (DigitalMicrograph) | size and unit of each image |
//! | EMD of Velox | size, detector and energy of each image |
//! | HDF5 of HyperSpy | name, size and unit of each axis, as far as they were set |
//! | HDF5 of the atomically resolved BiFeO3 images of the STEMGym paper | its scale, the places and polarisations of unit cells |
//! | any other HDF5 (Berkeley EMD, Prismatic, NeXus, dimension scales, py4DSTEM ...) | names, steps and units of axes |
//! | TIFF | abTEM's metadata; calibrations of ImageJ and OME; the resolution |
//! | zarr | abTEM's metadata |
//! | `.npy`, `.npz` | nothing |
//!
//! The kind of a file is recognised by its first bytes. Axes that are named x and y determine the orientation of the image; without names
//! the last but one dimension counts rows. Values are read as they are stored, without scaling; values of a TIFF whose zero is white are
//! inverted, so that they count from black.

mod dm_image;
mod dm_tags;
mod hdf5_source;
mod hyperspy_signal;
mod image_choice;
mod other_array;
mod unit_cells;
mod velox_image;
mod velox_titles;

use std::io::Read;
use std::path::{Path, PathBuf};

use ndarray::Array2;

use crate::error::{Error, Result};
pub(crate) use crate::io::foreign::length_units::StatedPixel;
use crate::io::foreign::length_units::square_nm;
use crate::io::foreign::named_axes::{NamedAxis, x_and_y};
use hdf5_source::Hdf5Source;
pub use image_choice::ImageChoice;
use image_choice::frame_of;
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
    /// An array in `.tif`, `.npy`, `.npz` or zarr.
    Array,
}

impl RecordedFormat {
    /// Returns the name of the format in words.
    pub(crate) fn name(self) -> &'static str {
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

/// A recorded image, with the information in its file.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RecordedImage {
    /// Path of the file.
    pub path: PathBuf,
    /// Kind of the file.
    pub format: RecordedFormat,
    /// Name of the image in the file; may be empty.
    pub name: String,
    /// Values [row, column] as they are stored; pixels without a finite number were not recorded.
    pub pixels: Array2<f64>,
    /// Edge of a pixel in nm as the file gives it, or the reason why it is not known.
    pub pixel_nm: StatedPixel,
    /// Unit cells that the file lists.
    pub cells: Option<RecordedCells>,
    /// Energy of the electrons, if the file gives it.
    pub energy_kev: Option<f64>,
    /// Name of the detector, if the file gives it.
    pub detector: Option<String>,
    /// Changes of the image's orientation after reading, in words.
    pub notes: Vec<String>,
}

/// Information of the axes about an image.
#[derive(Debug, Clone, PartialEq)]
struct ImageAxes {
    /// The dimensions of rows and columns, if x and y are named.
    plane: Option<[usize; 2]>,
    pixel_nm: StatedPixel,
}

impl ImageAxes {
    /// Uses the named axes, or else the last two.
    fn of(axes: &[NamedAxis]) -> Self {
        let named = x_and_y(axes.iter().map(|axis| axis.name.as_str()));
        let plane = named.map(|[x, y]| [y, x]);
        let last = || Some([axes.len().checked_sub(2)?, axes.len() - 1]);
        let Some([y, x]) = plane.or_else(last) else {
            return ImageAxes { plane: None, pixel_nm: Err(UNSAID.into()) };
        };
        let pixel_nm = match (axes[x].step, axes[y].step) {
            (Some(along_x), Some(along_y)) => {
                square_nm([(along_x, &axes[x].unit), (along_y, &axes[y].unit)])
            }
            _ => Err(UNSAID.into()),
        };
        ImageAxes { plane, pixel_nm }
    }

    /// Reports that the file holds its image as [x, y].
    fn notes(&self) -> Vec<String> {
        let turned = self.plane.is_some_and(|[y, x]| x < y);
        let note = "the file names its axes x, y in that order: the image is transposed, so that rows count y";
        turned.then(|| note.to_owned()).into_iter().collect()
    }
}

const UNSAID: &str = "it states no pixel size";

/// First bytes of an HDF5 file.
const HDF5_MARK: &[u8] = b"\x89HDF\r\n\x1a\n";

/// Kind of a file, from its first bytes.
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

/// Whether a file is read by the HDF5 library.
///
/// # Errors
/// [`Error::Io`].
pub fn is_hdf5_inside(path: &Path) -> Result<bool> {
    FileKind::of(path).map(|kind| kind == FileKind::Hdf5)
}

/// Reads an image.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a foreign or damaged file, a wrong name, and values that are no real numbers; [`Error::Choice`] if
/// the file holds several images or frames and none is chosen. The last two list the images in the file.
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
