//! Contents of a released file, name by name, and their comparison with another file.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::io::{WorldFile, schema};
use crate::numerics::processor;

/// Attributes that may differ between two files of one released world, with the reason. Everything else is compared.
pub(crate) const NOT_COMPARED: [(&str, &str); 2] = [
    ("/metadata@stemgen_version", "version of the program"),
    ("/metadata@wall_time_s", "time that a build took, in files of earlier versions"),
];

/// Attributes that are computed from the image, and differ by its rounding.
const FROM_IMAGE: [&str; 1] = ["/metadata@audit"];

/// Digests by name, as [`WorldFile::contents`] returns them.
type Digests = BTreeMap<String, String>;

/// Digests of all contents of a file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PinnedContents {
    /// Digests that are identical on every machine.
    everywhere: Digests,
    /// Digests of the image and of attributes that are computed from it, by kind of processor.
    image: BTreeMap<String, Digests>,
}

/// Differences between the contents of a file and the released contents.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ContentsDifference {
    /// Names that differ, are missing, or were not released.
    pub differs: Vec<String>,
    /// Names that were not compared, with the reason.
    pub not_compared: Vec<String>,
    /// Number of names compared.
    pub compared: usize,
}

impl PinnedContents {
    /// Computes the digests of a file on this kind of processor.
    ///
    /// # Errors
    /// Errors of reading the file.
    pub(crate) fn of(world: &WorldFile) -> Result<Self> {
        let left_out = |name: &String| NOT_COMPARED.iter().any(|(n, _)| n == name);
        let all = world.contents()?.into_iter().filter(|(name, _)| !left_out(name));
        let (image, everywhere) = all.partition(|(name, _)| is_of_image(name));
        Ok(PinnedContents { everywhere, image: [(processor(), image)].into() })
    }

    /// Adds the digests for other kinds of processors.
    pub(super) fn keep_others(&mut self, old: PinnedContents) {
        for (kind, digests) in old.image {
            self.image.entry(kind).or_insert(digests);
        }
    }

    /// Compares the released contents with the contents of a file.
    pub(crate) fn compare(&self, found: &PinnedContents) -> ContentsDifference {
        let mut result = ContentsDifference::default();
        let left_out = NOT_COMPARED.map(|(name, why)| format!("{name} ({why})"));
        if self.everywhere.is_empty() {
            let all = "attributes, overview and valid_region, which this manifest does not list";
            result.not_compared.push(all.into());
            return result;
        }
        result.not_compared.extend(left_out);
        result.add(&self.everywhere, &found.everywhere, true);
        for (kind, image) in &found.image {
            match (self.image.get(kind), self.image.values().next()) {
                (Some(known), _) => result.add(known, image, true),
                // The names are identical on every machine, so they can be compared without digests.
                (None, Some(names)) => {
                    result.add(names, image, false);
                    let names: Vec<&str> = image.keys().map(String::as_str).collect();
                    let why = "the manifest lists no digests for this kind of processor";
                    result.not_compared.push(format!("{} ({why})", names.join(", ")));
                }
                (None, None) => {}
            }
        }
        result
    }
}

impl ContentsDifference {
    /// Compares names, and also the digests if `values` is set.
    fn add(&mut self, known: &Digests, found: &Digests, values: bool) {
        let names: BTreeSet<&String> = known.keys().chain(found.keys()).collect();
        for name in names {
            match (known.get(name), found.get(name)) {
                (Some(_), None) => self.differs.push(format!("{name} (missing)")),
                (None, Some(_)) => self.differs.push(format!("{name} (not in the release)")),
                (a, b) if values && a != b => self.differs.push(name.clone()),
                _ => self.compared += usize::from(values),
            }
        }
    }
}

/// Whether a name belongs to the image, or to an attribute that is computed from it.
fn is_of_image(name: &str) -> bool {
    let images = [schema::TILES, schema::CLEAN, schema::OVERVIEW];
    let object = name.split('@').next().unwrap_or_default();
    FROM_IMAGE.contains(&name) || object.split('/').any(|part| images.contains(&part))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contents(kind: &str, image: &[(&str, &str)]) -> PinnedContents {
        let digests = |list: &[(&str, &str)]| -> Digests {
            list.iter().map(|(name, digest)| ((*name).to_owned(), (*digest).to_owned())).collect()
        };
        let everywhere = digests(&[("/valid_region", "v"), ("/metadata@dose", "d")]);
        PinnedContents { everywhere, image: [(kind.to_owned(), digests(image))].into() }
    }

    const IMAGE: [(&str, &str); 2] = [("/tiles/*", "t"), ("/overview", "o")];

    #[test]
    fn all_that_differs_is_named() {
        let known = contents("one", &IMAGE);
        let same = known.compare(&contents("one", &IMAGE));
        assert!(same.differs.is_empty() && same.compared == 4);
        assert_eq!(same.not_compared.len(), NOT_COMPARED.len());
        let mut other = contents("one", &[("/tiles/*", "t"), ("/clean/*", "c")]);
        other.everywhere.insert("/metadata@dose".into(), "e".into());
        other.everywhere.remove("/valid_region");
        other.everywhere.insert("/mine".into(), "m".into());
        let expected = [
            "/metadata@dose",
            "/mine (not in the release)",
            "/valid_region (missing)",
            "/clean/* (not in the release)",
            "/overview (missing)",
        ];
        assert_eq!(known.compare(&other).differs, expected);
    }

    #[test]
    fn on_another_processor_the_names_are_compared_and_the_rest_is_listed() {
        let known = contents("one", &IMAGE);
        let rounded = known.compare(&contents("two", &[("/tiles/*", "u"), ("/overview", "p")]));
        assert!(rounded.differs.is_empty() && rounded.compared == 2);
        let message = rounded.not_compared.last().unwrap();
        assert!(
            message.starts_with("/overview, /tiles/* (the manifest lists no digests"),
            "{message}"
        );
        let lost = known.compare(&contents("two", &[("/tiles/*", "u")]));
        assert_eq!(lost.differs, ["/overview (missing)"]);
        let message = PinnedContents::default().compare(&known).not_compared;
        assert!(message.len() == 1 && message[0].contains("does not list"), "{message:?}");
    }

    #[test]
    fn what_is_rounded_with_the_image_is_known() {
        let names =
            ["/tiles@scale", "/detectors/ABF/clean/*", "/overview@factor", "/metadata@audit"];
        assert!(names.iter().all(|name| is_of_image(name)));
        let names = ["/metadata@engine", "/valid_region", "/detectors/ABF@inner_mrad", "/@tiles"];
        assert!(!names.iter().any(|name| is_of_image(name)));
    }
}
