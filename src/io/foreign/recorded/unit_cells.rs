//! Reads HDF5 files of images with a list of their unit cells, such as the atomically resolved Sm-doped BiFeO3 images
//! (doi:10.5281/zenodo.4555979): `main image`, `xy_COM`, `Pxy`, `I1` to `I5` and `Scale`.

use ndarray::{Array2, ArrayD};

use super::hdf5_source::Hdf5Source;
use super::{ImageChoice, RecordedFormat, RecordedImage, StatedPixel};
use crate::error::Result;

/// Names of lists of intensities.
const INTENSITIES: [&str; 5] = ["i1", "i2", "i3", "i4", "i5"];

/// Unit cells of an image.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct RecordedCells {
    /// Positions (x, y) in pixels from the centre of pixel (0, 0): x with the column, y with the row.
    pub positions_px: Vec<[f64; 2]>,
    /// Polarisation (x, y) of each cell, in the file's units; empty if the file has none.
    pub polarisations: Vec<[f64; 2]>,
    /// Intensities of the atomic columns of each cell, with their names in the file.
    pub intensities: Vec<(String, Vec<f64>)>,
}

/// Returns a name in lower case without blanks and punctuation, which programs change.
fn plain(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase()
}

/// Returns the path of a data set in the file's first group, in any case and with any blanks.
fn find<'a>(source: &'a Hdf5Source, wanted: &str) -> Option<&'a str> {
    let at_top = |name: &&String| !name[1..].contains('/') && plain(name) == plain(wanted);
    source.names.iter().find(at_top).map(String::as_str)
}

/// Whether a file has this layout, and no other image in it is chosen.
pub(super) fn is_one(source: &Hdf5Source, choice: &ImageChoice) -> bool {
    let main = choice.dataset.as_deref().is_none_or(|name| plain(name) == plain("main image"));
    main && ["main image", "xy_COM"].iter().all(|name| find(source, name).is_some())
}

/// Reads the image with its cells.
pub(super) fn read(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let path = |name: &str| find(source, name).unwrap_or_default().to_owned();
    let image = path("main image");
    let pixels = source.image(&image, None, 0, choice)?;
    let positions_px = pairs(source, &path("xy_COM"))?;
    let polarisations = match find(source, "Pxy") {
        Some(name) => pairs(source, name)?,
        None => Vec::new(),
    };
    let mut intensities = Vec::new();
    for name in INTENSITIES.iter().filter_map(|name| find(source, name)) {
        let values: Vec<f64> = source.all::<f64>(name)?.into_iter().collect();
        intensities.push((name.trim_start_matches('/').to_owned(), values));
    }
    let count = positions_px.len();
    let others = intensities.iter().map(|(name, values)| (name.as_str(), values.len()));
    for (name, found) in others.chain([("Pxy", polarisations.len())]) {
        if found != count && (name, found) != ("Pxy", 0) {
            let fault = format!("xy_COM lists {count} unit cells, and {name} {found}");
            return Err(source.refused(fault));
        }
    }
    Ok(RecordedImage {
        path: source.path.clone(),
        format: RecordedFormat::UnitCells,
        name: image.trim_start_matches('/').to_owned(),
        pixels,
        pixel_nm: scale(source),
        cells: Some(RecordedCells { positions_px, polarisations, intensities }),
        energy_kev: None,
        detector: None,
        notes: Vec::new(),
    })
}

/// Returns the number of nm in a pixel.
fn scale(source: &Hdf5Source) -> StatedPixel {
    let name = find(source, "Scale").ok_or("it holds no `Scale`")?;
    let values = source.all::<f64>(name).map_err(|e| e.to_string())?;
    let mut values = values.into_iter();
    match (values.next(), values.next()) {
        (Some(nm), None) if nm.is_finite() && nm > 0.0 => Ok(nm),
        (Some(nm), None) => Err(format!("its `Scale` is {nm}")),
        _ => Err("its `Scale` is not one number".into()),
    }
}

/// Reads a list of pairs: (N, 2), or (2, N) as column-major programs write it.
fn pairs(source: &Hdf5Source, name: &str) -> Result<Vec<[f64; 2]>> {
    let values: ArrayD<f64> = source.all(name)?;
    let shape = values.shape().to_owned();
    let refuse =
        || source.refused(format!("{name} has the shape {shape:?}, expected (N, 2) or (2, N)"));
    let mut table: Array2<f64> = values.into_dimensionality().map_err(|_| refuse())?;
    if table.ncols() != 2 {
        table = table.reversed_axes();
    }
    if table.ncols() != 2 {
        return Err(refuse());
    }
    Ok(table.rows().into_iter().map(|row| [row[0], row[1]]).collect())
}
