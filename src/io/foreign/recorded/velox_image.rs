//! Reads EMD files of Velox: images at `/Data/Image/ID/Data`, [row, column, frame], with JSON in `Metadata` beside them.

use serde_json::Value;

use super::hdf5_source::Hdf5Source;
use super::{ImageChoice, RecordedFormat, RecordedImage, StatedPixel, velox_titles};
use crate::error::Result;
use crate::io::foreign::arrays::choose;
use crate::io::foreign::length_units::square_nm;

const IMAGES: &str = "/Data/Image/";
/// The axis of the frames.
const FRAMES: usize = 2;
/// Number of letters of an identifier that distinguish images with the same title.
const SHORT_ID: usize = 8;

/// Whether a file has the layout of Velox.
pub(super) fn is_one(source: &Hdf5Source) -> bool {
    !identifiers(source).is_empty()
}

/// Returns the identifiers of the images.
fn identifiers(source: &Hdf5Source) -> Vec<&str> {
    let of = |name: &'_ String| -> Option<(usize, usize)> {
        let id = name.strip_prefix(IMAGES)?.strip_suffix("/Data")?;
        (!id.contains('/')).then_some((IMAGES.len(), IMAGES.len() + id.len()))
    };
    let found = source.names.iter().filter_map(|name| of(name).map(|(a, b)| &name[a..b]));
    let has_metadata = |id: &&str| source.has(&format!("{IMAGES}{id}/Metadata"));
    found.filter(has_metadata).collect()
}

/// Reads an image, chosen by its title, by title and the beginning of its identifier, or by its path.
pub(super) fn read(source: &Hdf5Source, choice: &ImageChoice) -> Result<RecordedImage> {
    let all = identifiers(source);
    let by_path =
        |wanted: &str| all.iter().position(|id| wanted.split('/').any(|part| part == *id));
    let asked = choice.dataset.as_deref().and_then(by_path);
    // Fourier transforms are complex and not offered. One that is named, or the only one, is read: the error then gives the reason.
    let real = |id: &&str| source.is_real(&format!("{IMAGES}{id}/Data"));
    let ids: Vec<&str> = match (asked, all.len()) {
        (Some(_), _) | (None, 1) => all,
        (None, _) => all.into_iter().filter(real).collect(),
    };
    let described: Vec<Value> = ids.iter().map(|id| metadata(source, id, 0)).collect();
    let detectors: Vec<&str> = described.iter().map(detector).collect();
    let titles = velox_titles::read(source);
    let plain = |k: usize| titles.get(ids[k]).map_or(detectors[k], String::as_str);
    let name_of = |k: usize| {
        let alone = (0..ids.len()).filter(|other| plain(*other) == plain(k)).count() == 1;
        let short: String = ids[k].chars().take(SHORT_ID).collect();
        if alone { plain(k).to_owned() } else { format!("{}:{short}", plain(k)) }
    };
    let names: Vec<String> = (0..ids.len()).map(name_of).collect();
    let at = match asked {
        Some(at) => at,
        None => {
            let chosen = choose(&source.path, &names, choice.dataset.as_deref())?;
            names.iter().position(|name| name == chosen).unwrap_or(0)
        }
    };
    let pixels = source.image(&format!("{IMAGES}{}/Data", ids[at]), None, FRAMES, choice)?;
    let metadata = metadata(source, ids[at], choice.index.unwrap_or(0));
    let volts =
        metadata["Optics"]["AccelerationVoltage"].as_str().and_then(|v| v.parse::<f64>().ok());
    Ok(RecordedImage {
        path: source.path.clone(),
        format: RecordedFormat::VeloxEmd,
        name: names[at].clone(),
        pixels,
        pixel_nm: pixel_nm(&metadata),
        cells: None,
        energy_kev: volts.map(|v| v * 1e-3).filter(|v| v.is_finite() && *v > 0.0),
        detector: Some(detectors[at].to_owned()).filter(|d| d != NAMELESS),
        notes: Vec::new(),
    })
}

/// Name for a detector that the file does not name.
const NAMELESS: &str = "image";

fn detector(metadata: &Value) -> &str {
    metadata["BinaryResult"]["Detector"]
        .as_str()
        .filter(|name| !name.is_empty())
        .unwrap_or(NAMELESS)
}

fn pixel_nm(metadata: &Value) -> StatedPixel {
    let about = &metadata["BinaryResult"];
    let number = |value: &Value| value.as_str().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0);
    let unit = |name: &str| about[name].as_str().unwrap_or_default().to_owned();
    let size = &about["PixelSize"];
    let (x, y) = (unit("PixelUnitX"), unit("PixelUnitY"));
    square_nm([(number(&size["width"]), &x), (number(&size["height"]), &y)])
}

/// Returns the metadata of a frame; null if they are no JSON.
fn metadata(source: &Hdf5Source, id: &str, frame: usize) -> Value {
    let name = format!("{IMAGES}{id}/Metadata");
    let read = || -> Option<Value> {
        let shape = source.dataset(&name).ok()?.shape();
        let [length, frames] = shape[..] else { return None };
        let column = frame.min(frames.checked_sub(1)?);
        let bytes = source.part::<u8>(&name, &[0..length, column..column + 1]).ok()?;
        let text: Vec<u8> = bytes.into_iter().take_while(|b| *b != 0).collect();
        serde_json::from_slice(&text).ok()
    };
    read().unwrap_or(Value::Null)
}
