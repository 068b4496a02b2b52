//! Files of HyperSpy (`.hspy`): HDF5 with one signal for each image, with its axes.

use std::path::Path;

use hdf5::Group;

use super::At;
use super::hdf5_create;
use super::image_file::ImageStack;
use super::world_writer::{number, text};
use crate::error::Result;
use crate::files::atomic_write;

/// Version of HyperSpy's file format.
const FORMAT_VERSION: &str = "3.3";
/// HyperSpy takes signals for images in this unit.
const UNIT: &str = "\u{c5}";

/// Writes images as signals, each named as its image: `hyperspy.api.load` returns them. Stacks of several thicknesses have a
/// navigation axis.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Hdf5`].
pub fn write_hspy(path: &Path, overwrite: bool, stacks: &[ImageStack]) -> Result<()> {
    atomic_write::write_with(path, overwrite, |temporary| create_hspy(temporary, path, stacks))
}

/// Writes images as [`write_hspy`] does, straight to `path`, of which errors say that it is `place`.
///
/// # Errors
/// [`crate::Error::Hdf5`].
pub fn create_hspy(path: &Path, place: &Path, stacks: &[ImageStack]) -> Result<()> {
    let write = || -> hdf5::Result<()> {
        let file = hdf5_create::file(path)?;
        text(&file, "file_format", "HyperSpy")?;
        text(&file, "file_format_version", FORMAT_VERSION)?;
        let experiments = hdf5_create::group(&file, "Experiments")?;
        stacks.iter().try_for_each(|stack| signal(&experiments, stack))?;
        file.flush()
    };
    write().at(place)
}

fn signal(experiments: &Group, stack: &ImageStack) -> hdf5::Result<()> {
    let group = hdf5_create::group(experiments, stack.name)?;
    text(&group, "package", "hyperspy")?;
    text(&group, "package_version", "2.0")?;
    let data = stack.data.as_standard_layout();
    let several = stack.thicknesses_angstrom.len() > 1;
    match several {
        true => group.new_dataset_builder().with_data(&data).create("data")?,
        false => {
            let image = data.index_axis(ndarray::Axis(0), 0);
            group.new_dataset_builder().with_data(&image).create("data")?
        }
    };
    let (count, rows, columns) = data.dim();
    let mut axes = Vec::new();
    if let ([first, second, ..], true) = (stack.thicknesses_angstrom, several) {
        axes.push(("thickness", count, [*first, second - first], true));
    }
    let [x0, y0] = stack.origin_angstrom;
    let [x, y] = stack.step_angstrom;
    axes.push(("y", rows, [y0, y], false));
    axes.push(("x", columns, [x0, x], false));
    for (n, (name, size, [offset, scale], navigate)) in axes.into_iter().enumerate() {
        let axis = hdf5_create::group(&group, &format!("axis-{n}"))?;
        text(&axis, "_type", "UniformDataAxis")?;
        text(&axis, "name", name)?;
        text(&axis, "units", UNIT)?;
        number(&axis, "size", size as i64)?;
        number(&axis, "offset", offset)?;
        number(&axis, "scale", scale)?;
        number(&axis, "navigate", navigate)?;
        number(&axis, "is_binned", false)?;
    }
    let metadata = hdf5_create::group(&group, "metadata")?;
    let general = hdf5_create::group(&metadata, "General")?;
    text(&general, "title", stack.name)?;
    let about = hdf5_create::group(&metadata, "Signal")?;
    text(&about, "signal_type", "")?;
    text(&about, "quantity", stack.units)?;
    hdf5_create::group(&group, "original_metadata")?;
    hdf5_create::group(&group, "learning_results")?;
    let attributes = hdf5_create::group(&group, "attributes")?;
    number(&attributes, "_lazy", false)?;
    number(&attributes, "ragged", false)
}
