//! Images of files that have no layout of their own here: any HDF5, and TIFF, NumPy and zarr.

use std::path::Path;

use ndarray::{ArrayD, Axis};

use super::hdf5_source::Hdf5Source;
use super::length_units::{StatedPixel, square_nm};
use super::{ImageChoice, RecordedFormat, RecordedImage, frame_of};
use crate::error::{Error, Result};
use crate::io::arrays::{self, ArrayAxis, choose};
use crate::io::hdf5_guard::{any_text, pair};

const UNSAID: &str = "it says nothing of its pixels";
/// Endings of the arrays that are no HDF5.
const ENDINGS: [&str; 5] = ["npy", "npz", "tif", "tiff", "zarr"];

/// Reads an image of an HDF5 file by its path.
pub(super) fn read_hdf5(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let whole = |name: &str| format!("/{}", name.trim_matches('/'));
    let wanted = choice.dataset.as_deref().map(whole);
    // One that is there and no image has a reason of its own.
    let name = match wanted.filter(|name| source.has(name)) {
        Some(name) => name,
        None => choose(&source.path, &source.images(), choice.dataset.as_deref())?.to_owned(),
    };
    let pixels = source.image(&name, 0, choice)?;
    Ok(RecordedImage {
        path: source.path.clone(),
        format: RecordedFormat::Hdf5,
        pixel_nm: beside(source, &name),
        name: name.trim_start_matches('/').to_owned(),
        pixels,
        cells: None,
        energy_kev: None,
        detector: None,
    })
}

/// What attributes of an image, or lists of places along its axes beside it, say of its pixels: our own images, py4DSTEM
/// (`dim0`, `dim1`) and Berkeley EMD (`dim1`, `dim2`).
fn beside(source: &Hdf5Source, name: &str) -> StatedPixel {
    let dataset = source.dataset(name).map_err(|e| e.to_string())?;
    if let Some([x, y]) = pair(&dataset, "sampling_angstrom") {
        return square_nm([(x, "A"), (y, "A")]);
    }
    let (group, _) = name.rsplit_once('/').ok_or(UNSAID)?;
    let axes = dataset.ndim();
    let first = usize::from(!source.has(&format!("{group}/dim0")));
    let side = |axis: usize| -> Option<(f64, String)> {
        let list = format!("{group}/dim{}", axis + first);
        let about = source.file.dataset(&list).ok()?;
        let unit = any_text(&about, "units")?;
        let places = source.all::<f64>(&list).ok()?;
        let places: Vec<f64> = places.into_iter().collect();
        let steps = places.len().checked_sub(1).filter(|n| *n > 0)?;
        Some(((places[steps] - places[0]) / steps as f64, unit))
    };
    match (side(axes - 2), side(axes - 1)) {
        (Some(y), Some(x)) => square_nm([(x.0, &x.1), (y.0, &y.1)]),
        _ => Err(UNSAID.into()),
    }
}

/// What a file is by its name, where HyperSpy reads it and this program does not.
fn converted_by_hyperspy(ending: &str) -> Option<&'static str> {
    match ending {
        "mrc" | "mrcs" | "map" | "rec" | "st" => Some("an MRC file"),
        "ser" | "emi" => Some("a SER or EMI file of TIA"),
        "blo" | "tvips" | "bcf" | "rpl" | "prz" => Some("a file of another program"),
        _ => None,
    }
}

/// Reads an image of a TIFF, NumPy or zarr file.
pub(super) fn read_plain(path: &Path, choice: &ImageChoice) -> Result<RecordedImage> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if let Some(what) = ending.as_deref().and_then(converted_by_hyperspy) {
        let message = format!(
            "{what}, which is not read; HyperSpy converts it (pip install hyperspy rosettasciio): \
             hyperspy.api.load(\"FILE\").save(\"image.hspy\")"
        );
        return Err(Error::parse(path, 0, message));
    }
    if !ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
        let message = "is no recorded image that is known here: DM3, DM4, HDF5 (Velox EMD, HyperSpy, py4DSTEM and \
                       others), TIFF, .npy, .npz or zarr; is it whole?";
        return Err(Error::parse(path, 0, message));
    }
    let array = arrays::read(path, choice.dataset.as_deref())?;
    let name = array.name.clone();
    let shape = array.data.shape().to_owned();
    let frames = match shape[..] {
        [_, _] => 1,
        [frames, _, _] => frames,
        _ => {
            let found = format!(
                "has the shape {shape:?}; an image has two axes, and a third for its frames"
            );
            return Err(array.error(found));
        }
    };
    let shown = if name.is_empty() { "the file" } else { &name };
    let frame = frame_of(path, shown, frames, choice.index)?;
    let plane: ArrayD<f64> = match shape.len() {
        3 => array.data.index_axis_move(Axis(0), frame),
        _ => array.data,
    };
    let plane = plane.as_standard_layout().into_owned().into_dimensionality();
    let pixels = plane.map_err(|e| Error::parse(path, 0, e.to_string()))?;
    Ok(RecordedImage {
        path: path.to_owned(),
        format: RecordedFormat::Array,
        name,
        pixels,
        pixel_nm: array.axes.as_deref().map_or_else(|| Err(UNSAID.into()), sampling),
        cells: None,
        energy_kev: array.energy_ev.map(|ev| ev * 1e-3),
        detector: None,
    })
}

/// Of the last two axes, where the file describes them.
fn sampling(axes: &[ArrayAxis]) -> StatedPixel {
    let [.., first, last] = axes else { return Err(UNSAID.into()) };
    match (first.sampling_angstrom, last.sampling_angstrom) {
        (Some(first), Some(last)) => square_nm([(last, "A"), (first, "A")]),
        _ => Err(UNSAID.into()),
    }
}
