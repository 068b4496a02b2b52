//! abTEM's description of a measurement (1.0.11), as zarr and TIFF files hold it.

use serde_json::Value;

use super::{ArrayAxis, ForeignArray};
use crate::io::named_axes::NamedAxis;

/// Whether this is abTEM's description, and not one of another program.
pub fn describes(metadata: &Value) -> bool {
    metadata["axes"].is_object()
}

/// Takes over what a description says, if it fits the array.
pub fn describe(array: &mut ForeignArray, metadata: &Value) {
    let number = |key: &str| metadata[key].as_f64();
    array.energy_ev = number("energy");
    array.semiangle_mrad = number("semiangle_cutoff");
    let axes = &metadata["axes"];
    let count = array.data.ndim();
    if axes.as_object().is_some_and(|a| a.len() == count) {
        array.axes = (0..count).map(|i| axis(&axes[format!("axis_{i}")])).collect();
    }
}

fn axis(value: &Value) -> Option<ArrayAxis> {
    // Labels of reciprocal space say so in their unit, and have no place in an image.
    Some(ArrayAxis::named(&NamedAxis {
        name: value["label"].as_str()?.to_owned(),
        step: value["sampling"].as_f64(),
        first: Some(value["offset"].as_f64().unwrap_or(0.0)),
        unit: value["units"].as_str().unwrap_or_default().to_owned(),
    }))
}
