//! HDF5: files of `stemgen simulate`, and any other with an image in it.

use std::path::Path;

use hdf5::types::{TypeDescriptor, VarLenUnicode};
use hdf5::{Dataset, File, Group};

use super::{ArrayAxis, ForeignArray, choose};
use crate::error::{Error, Result};
use crate::io::At;

pub fn read(path: &Path, name: Option<&str>) -> Result<ForeignArray> {
    std::fs::File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let file = File::open(path).map_err(|e| {
        let reason = e.to_string();
        let first = reason.lines().next().unwrap_or_default();
        Error::parse(path, 0, format!("is not HDF5, or is truncated ({first})"))
    })?;
    let mut names = Vec::new();
    collect(&file, &mut names).at(path)?;
    // The atoms of our own files are arrays too.
    if names.iter().any(|n| n.starts_with("/images/")) {
        names.retain(|n| n.starts_with("/images/"));
        names.iter_mut().for_each(|n| *n = n.trim_start_matches("/images/").to_owned());
    }
    let chosen = choose(path, &names, name)?;
    let dataset = file.dataset(&format!("/images/{chosen}")).or_else(|_| file.dataset(chosen));
    let dataset = dataset.at(path)?;
    let data = dataset.read_dyn::<f64>().at(path)?;
    let mut array = ForeignArray::plain(path, chosen, data);
    array.axes = axes(&dataset, array.data.ndim());
    Ok(array)
}

/// Names of the datasets that may be images.
fn collect(group: &Group, names: &mut Vec<String>) -> hdf5::Result<()> {
    for dataset in group.datasets()? {
        let kind = dataset.dtype()?.to_descriptor();
        let real = matches!(
            kind,
            Ok(TypeDescriptor::Float(_) | TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_))
        );
        if real && dataset.ndim() >= 2 {
            names.push(dataset.name());
        }
    }
    group.groups()?.iter().try_for_each(|g| collect(g, names))
}

/// The axes that `stemgen simulate` writes: names of all, pixel and origin of the last two.
fn axes(dataset: &Dataset, count: usize) -> Option<Vec<ArrayAxis>> {
    let labels: Vec<VarLenUnicode> = dataset.attr("axes").and_then(|a| a.read_raw()).ok()?;
    let pair = |name: &str| -> Option<Vec<f64>> {
        dataset.attr(name).and_then(|a| a.read_raw()).ok().filter(|v: &Vec<f64>| v.len() == 2)
    };
    let (sampling, origin) = (pair("sampling_angstrom")?, pair("origin_angstrom")?);
    if labels.len() != count || count < 2 {
        return None;
    }
    let axis = |(i, label): (usize, &VarLenUnicode)| {
        let place = (i + 2).checked_sub(count);
        ArrayAxis {
            label: label.as_str().to_owned(),
            sampling_angstrom: place.map(|p| sampling[p]),
            origin_angstrom: place.map_or(0.0, |p| origin[p]),
        }
    };
    Some(labels.iter().enumerate().map(axis).collect())
}
