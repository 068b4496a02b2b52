//! Reads images that `stemgen simulate`, `acquire` and `live` wrote, for display. World files are read by [`crate::io::WorldFile`].

use std::path::{Path, PathBuf};

use hdf5::{Dataset, File, Group};
use ndarray::{Array2, Axis, Ix3};

use crate::error::{Error, Result};
use crate::io::hdf5::hdf5_guard::{
    Guarded, check_bytes, check_storage, damaged, datasets, number, pair, text, texts,
};
use crate::io::hdf5::hdf5_open::{self, regular_file};
use crate::io::hdf5::hdf5_values;
use crate::io::hdf5::worlds::schema;
use crate::lengths;

/// Kind of a file of images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageKind {
    /// Simulated images (`image_file.rs`): fractions of the beam, one image for each thickness.
    Simulated,
    /// A recording (`recording_file.rs`): counts, one image for each frame that was kept.
    Recording,
}

/// A file of images.
pub struct StoredImages {
    path: PathBuf,
    file: File,
    bytes: u64,
    /// Kind of the file.
    pub kind: ImageKind,
    /// The command that wrote the file, as typed.
    pub command_line: Option<String>,
    /// The request that made simulated images, as JSON.
    pub request: Option<String>,
    /// SHA-256 of the structure file that simulated images were made from.
    pub structure_sha256: Option<String>,
    /// Names of the images, in the order of the file. Recordings of several detectors have the names of the detectors too.
    pub names: Vec<String>,
}

/// One image.
pub struct StoredImage {
    /// The values, [row, column] = [y, x].
    pub values: Array2<f32>,
    /// Number of images in the stack that the image belongs to.
    pub of: usize,
    /// Pixel (x, y) in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Unit of the values.
    pub units: Option<String>,
}

/// Datasets of a recording: the recorded image, and the noise-free one.
const RECORDING: &str = "recording";
const IDEAL: &str = "ideal";

impl StoredImages {
    /// Opens a file of images; `None` for other HDF5 files, such as worlds.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Parse`] for a file that is damaged or holds no image.
    pub fn open(path: &Path) -> Result<Option<Self>> {
        let bytes = regular_file(path)?;
        let refused = |fault: String| Error::parse(path, 0, fault);
        // Other faults are reported when the file is opened as a world.
        let Some(file) = hdf5_open::open_if_hdf5(path)? else { return Ok(None) };
        let kind = match text(&file, "format").as_deref() {
            Some("stemgen images") => ImageKind::Simulated,
            Some("stemgen recording") => ImageKind::Recording,
            _ => return Ok(None),
        };
        let all = datasets(&file).map_err(refused)?;
        let names: Vec<String> = match kind {
            ImageKind::Simulated => {
                let images =
                    all.iter().filter_map(|n| n.trim_start_matches('/').strip_prefix("images/"));
                images.map(str::to_owned).collect()
            }
            ImageKind::Recording => {
                let group = file.group(schema::DETECTORS).ok();
                let of = |g: &Group| g.attr("names").map_or(0, |names| names.size());
                let detectors = group.and_then(|g| texts(&g, "names", of(&g))).unwrap_or_default();
                let plain = detectors.into_iter().filter(|name| !name.contains('/'));
                [RECORDING, IDEAL].map(str::to_owned).into_iter().chain(plain).collect()
            }
        };
        if names.is_empty() {
            return Err(refused("holds no images".into()));
        }
        Ok(Some(StoredImages {
            path: path.to_owned(),
            bytes,
            kind,
            command_line: text(&file, "command_line"),
            request: text(&file, "request"),
            structure_sha256: text(&file, "structure_sha256"),
            file,
            names,
        }))
    }

    /// Reads image number `index` of the stack of this name; the last one if `index` is `None`.
    ///
    /// # Errors
    /// [`Error::Parse`] for a name or a number that the file does not have, and for damaged values.
    pub fn image(&self, name: &str, index: Option<usize>) -> Result<StoredImage> {
        self.read((name, false), index)
            .map_err(|fault| Error::parse(&self.path, 0, format!("/{name}: {fault}")))
    }

    /// Reads the noise-free image of a detector of a recording.
    ///
    /// # Errors
    /// As [`StoredImages::image`].
    pub fn ideal(&self, detector: &str) -> Result<StoredImage> {
        self.read((detector, true), None)
            .map_err(|fault| Error::parse(&self.path, 0, format!("/{detector}: {fault}")))
    }

    fn read(&self, (name, ideal): (&str, bool), index: Option<usize>) -> Guarded<StoredImage> {
        if !self.names.iter().any(|known| known == name) {
            return Err(format!("does not exist; the file contains {}", self.names.join(", ")));
        }
        let at = match (self.kind, name) {
            (ImageKind::Simulated, _) => format!("images/{name}"),
            (ImageKind::Recording, RECORDING | IDEAL) => name.to_owned(),
            (ImageKind::Recording, _) => {
                format!(
                    "{}/{}",
                    schema::detector_group(name),
                    if ideal { IDEAL } else { RECORDING }
                )
            }
        };
        let dataset = self.file.dataset(&at).map_err(damaged)?;
        check_storage(&dataset, self.bytes)?;
        let step_angstrom = self.step(&dataset)?;
        let shape = dataset.shape();
        check_bytes(&shape, size_of::<f32>(), self.bytes)?;
        let of = if let [n, _, _] = shape[..] { n } else { 1 };
        let index = index.unwrap_or(of.saturating_sub(1));
        if index >= of {
            return Err(format!(
                "has {of} images; expected an index from 0 to {}",
                of.saturating_sub(1)
            ));
        }
        let values = match shape[..] {
            [rows, columns] => hdf5_values::part(&dataset, &self.path, &[0..rows, 0..columns])?,
            [_, rows, columns] => {
                let ranges = [index..index + 1, 0..rows, 0..columns];
                hdf5_values::part::<f32, Ix3>(&dataset, &self.path, &ranges)?
                    .index_axis_move(Axis(0), 0)
            }
            _ => return Err(format!("has the shape {shape:?}, which is no image")),
        };
        if values.iter().any(|v| !v.is_finite()) {
            return Err("holds values that are no finite numbers".into());
        }
        Ok(StoredImage { values, of, step_angstrom, units: text(&dataset, "units") })
    }

    fn step(&self, dataset: &Dataset) -> Guarded<[f64; 2]> {
        let step = match self.kind {
            ImageKind::Simulated => pair(dataset, "sampling_angstrom").map(|[y, x]| [x, y]),
            ImageKind::Recording => {
                number(&self.file, "pixel_size_nm").map(|nm: f64| [lengths::angstrom(nm); 2])
            }
        };
        let positive = |step: &[f64; 2]| step.iter().all(|s| (1e-5..1e7).contains(s));
        step.filter(positive).ok_or_else(|| "has no usable pixel size".into())
    }
}
