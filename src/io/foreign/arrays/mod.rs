//! Reads images of other programs: NumPy, zarr, TIFF and HDF5 files, with the description of their axes.
//!
//! | file | source of the axes |
//! |---|---|
//! | `.npy`, `.npz` | nothing |
//! | zarr, format 2 or 3 (`measurement.to_zarr`) | abTEM's metadata; names of dimensions |
//! | `.tif`, `.tiff` (`measurement.to_tiff`) | abTEM's metadata in one of the descriptions; pixels of ImageJ, OME, and by the resolution |
//! | `.h5`, `.hdf5`, `.emd`, `.nxs` | see `hdf5_axes` |

mod abtem_metadata;
mod hdf;
mod number_type;
mod numpy;
mod tagged;
mod tiff_calibration;
mod tiff_descriptions;
mod zarr;

use std::path::{Path, PathBuf};

use ndarray::ArrayD;

use super::length_units::unit_nm;
use super::named_axes::{NamedAxis, x_and_y};
use crate::error::{Error, Result};
use crate::lengths;
use crate::setting::Setting;
pub(super) use number_type::NumberType;
pub(crate) use numpy::unpack as unpack_npz;

/// Description of one dimension of an array.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ArrayAxis {
    /// Name: `x`, `y`, `thickness` ...; may be empty.
    pub label: String,
    /// Distance of neighbouring entries in Angstrom.
    pub sampling_angstrom: Option<f64>,
    /// Position of the first entry in Angstrom.
    pub origin_angstrom: Option<f64>,
}

/// An array of another program.
#[derive(Debug, Clone, PartialEq)]
pub struct ForeignArray {
    /// Path of the file.
    pub path: PathBuf,
    /// Name of the array in the file; empty if it has none.
    pub name: String,
    /// The values, in the order of the file.
    pub data: ArrayD<f64>,
    /// Description of each dimension, if the file has one.
    pub axes: Option<Vec<ArrayAxis>>,
    /// Beam energy, if the file gives it.
    pub energy_kev: Option<f64>,
    /// Convergence semiangle, if the file gives it.
    pub semiangle_mrad: Option<f64>,
    /// Conversions of the values after reading, in words.
    pub notes: Vec<String>,
    /// Reason for a missing pixel size, if the file allows to give one.
    pub pixel_unsaid: Option<String>,
}

const HDF5_ENDINGS: [&str; 8] = ["h5", "hdf5", "hdf", "he5", "emd", "nxs", "nx", "nc"];

/// Whether a file is read as HDF5.
pub fn is_hdf5(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| HDF5_ENDINGS.contains(&ending.as_str()))
}

/// Reads an array of real numbers with at least two dimensions. `name` chooses among several.
///
/// # Errors
/// [`Error::Io`]; [`Error::Parse`] for a foreign or damaged file, or a wrong name; [`Error::Choice`] if the name is missing. The last two
/// list the arrays in the file.
pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if metadata.is_dir() {
        return zarr::read(path, name);
    }
    if !metadata.is_file() {
        return Err(Error::parse(
            path,
            0,
            "is no regular file; expected an image, or a zarr folder",
        ));
    }
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("npy") => numpy::read_npy(path, name),
        Some("npz") => numpy::read_npz(path, name),
        Some("tif" | "tiff") => tagged::read(path, name),
        _ if is_hdf5(path) => hdf::read(path, name),
        _ => Err(Error::parse(
            path,
            0,
            "not a known kind of image; expected .npy, .npz, .tif, .h5 or a zarr folder",
        )),
    }
}

/// Largest number of values in an array: 512 MiB in memory.
pub(crate) const MOST_VALUES: usize = 1 << 26;
/// Largest number of axes of an array; NumPy allows no more.
const MOST_AXES: usize = 64;

/// Returns the number of values of an array of this shape, or the reason why it is too large. Called before memory is requested.
pub(super) fn held(shape: &[usize]) -> std::result::Result<usize, String> {
    let count = shape.iter().try_fold(1_usize, |n, length| n.checked_mul(*length));
    // Axes of length 0 hide the lengths of the others.
    let fits = shape.len() <= MOST_AXES && shape.iter().all(|length| *length <= MOST_VALUES);
    count.filter(|n| fits && *n <= MOST_VALUES).ok_or_else(|| {
        let shown = &shape[..shape.len().min(MOST_AXES)];
        format!(
            "an array of shape {shown:?} is announced; at most {MOST_VALUES} values along {MOST_AXES} axes are \
             read: save one image alone"
        )
    })
}

impl ArrayAxis {
    /// Converts an axis whose step and origin are in a unit of length; for other axes only the name is kept.
    fn named(axis: &NamedAxis) -> Self {
        let angstrom = unit_nm(&axis.unit).map(lengths::angstrom);
        let length = |value: Option<f64>| Some(value? * angstrom?);
        ArrayAxis {
            label: axis.name.clone(),
            sampling_angstrom: length(axis.step).filter(|step| *step != 0.0),
            origin_angstrom: length(axis.first),
        }
    }

    /// Returns the dimensions that are named x and y.
    pub(crate) fn x_and_y(axes: &[ArrayAxis]) -> Option<[usize; 2]> {
        x_and_y(axes.iter().map(|axis| axis.label.as_str()))
    }
}

impl ForeignArray {
    fn plain(path: &Path, name: &str, data: ArrayD<f64>) -> Self {
        ForeignArray {
            path: path.to_owned(),
            name: name.to_owned(),
            data,
            axes: None,
            energy_kev: None,
            semiangle_mrad: None,
            notes: Vec::new(),
            pixel_unsaid: None,
        }
    }

    /// Returns an error that names the array's file and the setting that has to be chosen.
    pub(crate) fn choice(&self, setting: Setting, message: impl Into<String>) -> Error {
        Error::choice(&self.path, setting, message)
    }

    /// Returns an error that names the array's file.
    pub fn error(&self, message: impl Into<String>) -> Error {
        Error::parse(&self.path, 0, message)
    }
}

/// Returns the array called `name`, or the only array.
pub(super) fn choose<'a>(path: &Path, found: &'a [String], name: Option<&str>) -> Result<&'a str> {
    const SHOWN: usize = 12;
    let mut listed = found.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if found.len() > SHOWN {
        listed += &format!(" and {} more", found.len() - SHOWN);
    }
    let refuse = |message: String| Err(Error::parse(path, 0, message));
    let plain = |n: &str| n.trim_matches('/').to_owned();
    match (found, name) {
        ([], _) => refuse("holds no array of real numbers with two dimensions or more".into()),
        (_, Some(name)) => match found.iter().find(|n| plain(n) == plain(name)) {
            Some(found) => Ok(found),
            None => refuse(format!("holds no image `{name}`; there are: {listed}")),
        },
        ([only], None) => Ok(only),
        (_, None) => {
            let message = format!("holds several arrays; choose one of: {listed}");
            Err(Error::choice(path, Setting::DataSet, message))
        }
    }
}

/// Refuses a name for a file with a single array.
fn nameless(path: &Path, name: Option<&str>) -> Result<()> {
    match name {
        None => Ok(()),
        Some(name) => Err(Error::parse(
            path,
            0,
            format!("holds a single array, none called `{name}`; give no name"),
        )),
    }
}
