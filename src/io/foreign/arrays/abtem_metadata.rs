//! Reads abTEM's description of a measurement (1.0.11) in zarr and TIFF files.

use serde_json::Value;

use super::{ArrayAxis, ForeignArray};
use crate::io::foreign::named_axes::NamedAxis;

/// Whether a description comes from abTEM, and not from another program.
pub fn describes(metadata: &Value) -> bool {
    metadata["axes"].is_object()
}

/// Copies the axes and settings of a description to the array, if the description fits it.
pub fn describe(array: &mut ForeignArray, metadata: &Value) {
    let number = |key: &str| metadata[key].as_f64();
    array.energy_kev = number("energy").map(|ev| ev / 1e3);
    array.semiangle_mrad = number("semiangle_cutoff");
    let axes = &metadata["axes"];
    let count = array.data.ndim();
    if axes.as_object().is_some_and(|a| a.len() == count) {
        array.axes = (0..count).map(|i| axis(&axes[format!("axis_{i}")])).collect();
    }
}

fn axis(value: &Value) -> Option<ArrayAxis> {
    // Axes of reciprocal space have a unit that shows it, and no place in an image.
    Some(ArrayAxis::named(&NamedAxis {
        name: value["label"].as_str()?.to_owned(),
        step: value["sampling"].as_f64(),
        first: Some(value["offset"].as_f64().unwrap_or(0.0)),
        unit: value["units"].as_str().unwrap_or_default().to_owned(),
    }))
}
