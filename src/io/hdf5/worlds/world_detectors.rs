//! Reads the detectors of a world file that has several.

use hdf5::{File, Group};

use super::schema;
use super::world_file::WorldFile;
use super::world_metadata::scaling;
use crate::detect::{CentreOfMass, Detector};
use crate::error::{Error, Result};
use crate::io::hdf5::hdf5_guard::{self, Guarded, number};
use crate::setting::Setting;

/// Largest number of detectors in a file.
const MOST_DETECTORS: usize = 1000;

/// Returns the detectors that a file names, the main one first; empty for a file without names for them.
pub(super) fn read(file: &File) -> Guarded<Vec<Detector>> {
    if !file.link_exists(schema::DETECTORS) {
        return Ok(Vec::new());
    }
    let unusable = |what: &str| format!("/{} {what}; build it again", schema::DETECTORS);
    let group = file.group(schema::DETECTORS).map_err(|_| unusable("is no group"))?;
    let count = group.attr("names").map_or(0, |names| names.size());
    let names = hdf5_guard::texts(&group, "names", count);
    let names = names.filter(|n| (1..=MOST_DETECTORS).contains(&n.len()));
    let names = names.ok_or_else(|| unusable("has no usable attribute `names`"))?;
    let detector = |name: String| {
        let plain = !name.is_empty() && !name.contains('/') && !name.starts_with('.');
        let group = Some(&group).filter(|_| plain).and_then(|g| g.group(&name).ok());
        let angle = |which: &str| number::<f64>(group.as_ref()?, which).filter(|v| v.is_finite());
        match (angle("inner_mrad"), angle("outer_mrad")) {
            (Some(inner), Some(outer)) => {
                let sector_degrees = group.as_ref().and_then(sector);
                let centre_of_mass = group.as_ref().and_then(axis);
                let annulus = Detector::new(&name, inner, outer);
                Ok(Detector { sector_degrees, centre_of_mass, ..annulus })
            }
            _ => Err(unusable(&format!("has no usable group for `{name}`"))),
        }
    };
    names.into_iter().map(detector).collect()
}

/// Returns the azimuths of a sector.
fn sector(group: &Group) -> Option<[f64; 2]> {
    let values = group.attr("sector_degrees").ok()?.read_raw::<f64>().ok()?;
    <[f64; 2]>::try_from(values).ok().filter(|ends| ends.iter().all(|v| v.is_finite()))
}

/// Returns the axis of an image of a centre of mass.
fn axis(group: &Group) -> Option<CentreOfMass> {
    match hdf5_guard::text(group, schema::CENTRE_OF_MASS)?.as_str() {
        "x" => Some(CentreOfMass::X),
        "y" => Some(CentreOfMass::Y),
        _ => None,
    }
}

impl WorldFile {
    /// Returns the detectors of a world that names several, the main one first; empty if it has one without a name.
    pub fn detectors(&self) -> &[Detector] {
        &self.metadata.detectors
    }

    /// Returns the world with the images of a detector: its tiles, noiseless tiles, overview and scaling. All detectors share the truth.
    ///
    /// # Errors
    /// [`Error::Choice`] with the names of the detectors; [`Error::Invalid`] for a damaged file.
    pub fn on_detector(&self, name: &str) -> Result<WorldFile> {
        let detectors = self.detectors();
        let Some(number) = detectors.iter().position(|d| d.name == name) else {
            let names: Vec<&str> = detectors.iter().map(|d| d.name.as_str()).collect();
            let message = match names.is_empty() {
                true => format!("has one detector without a name, none called `{name}`"),
                false => format!("has no detector `{name}`; it has {}", names.join(", ")),
            };
            return Err(Error::choice(&self.path, Setting::DetectorName, message));
        };
        let images = match number {
            0 => String::new(),
            _ => format!("{}/", schema::detector_group(name)),
        };
        let mut metadata = self.metadata.clone();
        metadata.scaling = scaling(&self.file, &format!("{images}{}", schema::TILES));
        let (path, file, bytes) = (self.path.clone(), self.file.clone(), self.bytes);
        let world = WorldFile { path, file, bytes, metadata, images };
        world.check()?;
        Ok(world)
    }

    /// Returns the path of a group or dataset of the images that are read.
    pub(super) fn of_images(&self, name: &str) -> String {
        format!("{}{name}", self.images)
    }
}
