//! Reads images of files without a layout that is known here: any HDF5, TIFF, NumPy and zarr.

use std::path::Path;

use ndarray::{Array2, Axis};

use super::hdf5_source::Hdf5Source;
use super::{ImageAxes, ImageChoice, RecordedFormat, RecordedImage, UNSAID, frame_of};
use crate::error::{Error, Result};
use crate::io::foreign::arrays::{self, ArrayAxis, ForeignArray, choose};
use crate::io::foreign::named_axes::NamedAxis;

/// Endings of array files other than HDF5.
const ENDINGS: [&str; 5] = ["npy", "npz", "tif", "tiff", "zarr"];

/// Reads an image of an HDF5 file by its path.
pub(super) fn read_hdf5(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let whole = |name: &str| format!("/{}", name.trim_matches('/'));
    let wanted = choice.dataset.as_deref().map(whole);
    // A data set that is named is read even if it is no image: the error then gives the reason.
    let name = match wanted.filter(|name| source.has(name)) {
        Some(name) => name,
        None => {
            let offered = source.images();
            if let (true, Some(refusal)) = (offered.is_empty(), source.refusal()) {
                return Err(refusal);
            }
            choose(&source.path, &offered, choice.dataset.as_deref())?.to_owned()
        }
    };
    let axes = source.axes(&name).unwrap_or_default();
    let axes = ImageAxes::of(&axes);
    let pixels = source.image(&name, axes.plane, 0, choice)?;
    Ok(RecordedImage {
        path: source.path.clone(),
        format: RecordedFormat::Hdf5,
        notes: axes.notes(),
        pixel_nm: axes.pixel_nm,
        name: name.trim_start_matches('/').to_owned(),
        pixels,
        cells: None,
        energy_kev: None,
        detector: None,
    })
}

/// Names the kind of a file that HyperSpy reads and this program does not, by its ending.
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
        let message = "is no recorded image of a known format: DM3, DM4, HDF5 (Velox EMD, HyperSpy, py4DSTEM and others), TIFF, .npy, .npz \
            or zarr; check that the file is complete";
        return Err(Error::parse(path, 0, message));
    }
    let array = arrays::read(path, choice.dataset.as_deref())?;
    let named: Vec<NamedAxis> = array.axes.iter().flatten().map(named).collect();
    let axes = match (&array.axes, &array.pixel_unsaid) {
        (Some(_), _) => ImageAxes::of(&named),
        (None, why) => {
            let why = why.clone().unwrap_or_else(|| UNSAID.into());
            ImageAxes { plane: None, pixel_nm: Err(why) }
        }
    };
    let name = array.name.clone();
    let notes = [array.notes.clone(), axes.notes()].concat();
    let energy_kev = array.energy_kev;
    let pixels = image_of(array, axes.plane, choice)?;
    Ok(RecordedImage {
        path: path.to_owned(),
        format: RecordedFormat::Array,
        name,
        pixels,
        pixel_nm: axes.pixel_nm,
        cells: None,
        energy_kev,
        detector: None,
        notes,
    })
}

/// Returns the image of an array whose dimensions `[y, x]` count rows and columns; without them, its last two. A third counts frames.
fn image_of(
    array: ForeignArray,
    plane: Option<[usize; 2]>,
    choice: &ImageChoice,
) -> Result<Array2<f64>> {
    let path = array.path.clone();
    let shape = array.data.shape().to_owned();
    if !(2..=3).contains(&shape.len()) {
        let found =
            format!("has the shape {shape:?}; an image has two axes, and a third for its frames");
        return Err(array.error(found));
    }
    let [y, x] = plane.unwrap_or([shape.len() - 2, shape.len() - 1]);
    let shown = if array.name.is_empty() { "the file" } else { &array.name };
    let others = (0..shape.len()).find(|axis| *axis != y && *axis != x);
    let frame = frame_of(&path, shown, others.map_or(1, |axis| shape[axis]), choice.index)?;
    let image = match others {
        Some(axis) => array.data.index_axis_move(Axis(axis), frame),
        None => array.data,
    };
    let image: Array2<f64> =
        image.into_dimensionality().map_err(|e| Error::parse(&path, 0, e.to_string()))?;
    let image = if x < y { image.reversed_axes() } else { image };
    let whole = others.is_none() && image.is_standard_layout();
    // A large image is not copied; one of many frames is copied so that the others are freed.
    Ok(if whole { image } else { image.as_standard_layout().to_owned() })
}

/// Converts an axis of an array of another program.
fn named(axis: &ArrayAxis) -> NamedAxis {
    NamedAxis {
        name: axis.label.clone(),
        step: axis.sampling_angstrom,
        first: axis.origin_angstrom,
        unit: "A".into(),
    }
}
