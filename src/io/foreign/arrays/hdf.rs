//! Reads arrays from HDF5: files of `stemgen simulate`, and any other file with an image.

use std::path::Path;

use hdf5::Dataset;
use hdf5::types::TypeDescriptor;

use super::{ArrayAxis, ForeignArray, choose, held};
use crate::error::{Error, Result};
use crate::io::foreign::hdf5_axes::AxisSource;
use crate::io::hdf5::hdf5_guard::{check_storage, datasets, text};
use crate::io::hdf5::hdf5_open::{self, regular_file};
use crate::io::hdf5::{At, hdf5_values};

/// Group of the images in files of this program.
const IMAGES: &str = "/images/";

pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    let bytes = regular_file(path)?;
    let file = hdf5_open::open(path).map_err(|e| {
        Error::parse(path, 0, hdf5_open::reason(&e, "is not HDF5, or is truncated"))
    })?;
    let refused = |fault: String| Error::parse(path, 0, fault);
    let mut names = Vec::new();
    let all = datasets(&file).map_err(refused)?;
    // In files of this program this group links to the images a second time.
    let own = text(&file, "format").as_deref() == Some("stemgen images");
    for name in all.iter().filter(|name| !(own && name.starts_with("/entry/"))) {
        let dataset = file.dataset(name).at(path)?;
        check_storage(&dataset, bytes).map_err(|fault| refused(format!("{name} {fault}")))?;
        if may_be_image(&dataset) {
            names.push(name.clone());
        }
    }
    // Files of this program also hold arrays of atoms, which are no images.
    if names.iter().any(|n| n.starts_with(IMAGES)) {
        names.retain(|n| n.starts_with(IMAGES));
        names.iter_mut().for_each(|n| *n = n.trim_start_matches(IMAGES).to_owned());
    }
    let chosen = choose(path, &names, name)?;
    let dataset = file.dataset(&format!("{IMAGES}{chosen}")).or_else(|_| file.dataset(chosen));
    let dataset = dataset.at(path)?;
    held(&dataset.shape()).map_err(refused)?;
    let data =
        hdf5_values::all(&dataset, path).map_err(|fault| refused(format!("{chosen} {fault}")))?;
    let mut array = ForeignArray::plain(path, chosen, data);
    let source = AxisSource { file: &file, path, bytes, names: &all };
    let axes = source.axes(&dataset.name(), &dataset);
    array.axes = axes.map(|axes| axes.iter().map(ArrayAxis::named).collect());
    Ok(array)
}

fn may_be_image(dataset: &Dataset) -> bool {
    let kind = dataset.dtype().and_then(|t| t.to_descriptor());
    let real = matches!(
        kind,
        Ok(TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_))
    );
    real && dataset.ndim() >= 2
}
