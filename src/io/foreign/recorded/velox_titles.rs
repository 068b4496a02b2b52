//! Reads the titles of the images of a Velox file, as its user saw them: the nine images of a segmented detector have different titles.
//!
//! Displays are data sets of one text in JSON: below `/Presentation/Displays/ImageDisplay` with the image in `dataPath` and the title in
//! `display/label`; from format 11 below `/Displays/ImageDisplay`, with the title in `title` or `id` and, in `data`, the path of another
//! text in JSON with the `dataPath`.

use std::collections::BTreeMap;

use hdf5::H5Type;
use hdf5::types::{VarLenAscii, VarLenUnicode};
use serde_json::Value;

use super::hdf5_source::Hdf5Source;

/// Paths of the displays.
const DISPLAYS: [&str; 2] = ["/Presentation/Displays/ImageDisplay/", "/Displays/ImageDisplay/"];
/// Largest number of displays that are read.
const MOST_DISPLAYS: usize = 4096;
/// Largest number of letters in a title.
const LONGEST_TITLE: usize = 200;

/// Returns the titles of the images, by their identifiers. If an image has several displays, the first counts.
pub(super) fn read(source: &Hdf5Source) -> BTreeMap<String, String> {
    let is_display = |name: &&String| DISPLAYS.iter().any(|group| name.starts_with(group));
    let mut titles = BTreeMap::new();
    for name in source.names.iter().filter(is_display).take(MOST_DISPLAYS) {
        let Some((id, title)) = json(source, name).and_then(|display| titled(source, &display))
        else {
            continue;
        };
        titles.entry(id).or_insert(title);
    }
    titles
}

/// Returns identifier and title of the image of a display.
fn titled(source: &Hdf5Source, display: &Value) -> Option<(String, String)> {
    let of = |reference: &str| json(source, reference)?["dataPath"].as_str().map(str::to_owned);
    let path = match display["dataPath"].as_str() {
        Some(path) => path.to_owned(),
        None => of(display["data"].as_str()?)?,
    };
    let id = path.trim_end_matches('/').rsplit('/').next()?.to_owned();
    let words = [&display["display"]["label"], &display["title"], &display["id"]];
    let title = words.into_iter().filter_map(Value::as_str).map(str::trim);
    let title = title.into_iter().find(|title| !title.is_empty())?;
    Some((id, title.chars().take(LONGEST_TITLE).collect()))
}

/// Reads a data set of one text in JSON.
fn json(source: &Hdf5Source, name: &str) -> Option<Value> {
    fn of<T: H5Type>(dataset: &hdf5::Dataset, bytes: impl Fn(&T) -> &[u8]) -> Option<Value> {
        let texts: Vec<T> = dataset.read_raw().ok()?;
        serde_json::from_slice(bytes(texts.first()?)).ok()
    }
    let name = format!("/{}", name.trim_start_matches('/'));
    let dataset = source.dataset(&name).ok().filter(|d| source.has(&name) && d.size() == 1)?;
    of::<VarLenUnicode>(&dataset, |text| text.as_bytes())
        .or_else(|| of::<VarLenAscii>(&dataset, |text| text.as_bytes()))
}
