//! Notes on images of the library. They explain why an image is not in the cache.

use std::fmt::Display;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::engine::Settings;
use crate::numerics::NUMERICS_VERSION;
use crate::specimen::units::library_cell::LibraryCell;
use crate::specimen::units::occupation::DefectKind;
use crate::structure::elements;

/// Describes an image of the library, in words and digests. It is stored in the image's file in the cache.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ImageNote {
    /// Version of the numerics.
    pub numerics: u32,
    /// Digest of the settings of the engine.
    pub settings: String,
    /// Standard deviations of the displacements.
    pub sigma: String,
    /// Digest of the sites of the library cell: crystal, thickness, strain, boundary.
    pub sites: String,
    /// The kind of defect.
    pub process: String,
    /// Share of defects among the neighbours.
    pub rate: f64,
    /// Library cell and phonon configuration.
    pub image: [usize; 2],
}

/// Images that have to be simulated, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct NewImages {
    /// Number of images.
    pub images: usize,
    /// Their difference from all images in the cache.
    pub why: String,
}

impl NewImages {
    /// A number of images, and why they are new.
    pub(crate) fn new(images: usize, why: String) -> Self {
        NewImages { images, why }
    }
}

impl ImageNote {
    /// Describes an image (library cell, configuration) of library cells with the elements `numbers`; `sigma` gives the standard deviation
    /// of an element's displacements in Angstrom.
    pub(crate) fn new(
        library_cell: &LibraryCell,
        numbers: &[u8],
        (settings, sigma): (&Settings, &dyn Fn(u8) -> f64),
        image: [usize; 2],
    ) -> Self {
        let sigmas = numbers.iter().map(|n| format!("{} {}", elements::symbol(*n), sigma(*n)));
        ImageNote {
            numerics: NUMERICS_VERSION,
            settings: digest(serde_json::to_string(settings).unwrap_or_default()),
            sigma: sigmas.collect::<Vec<_>>().join(", "),
            sites: digest(sites(library_cell)),
            process: library_cell.process.map_or_else(|| "none".to_owned(), in_words),
            rate: library_cell.rate,
            image,
        }
    }

    /// The difference between this image and the most similar of the kept ones, in words.
    pub(crate) fn difference(&self, kept: &[ImageNote]) -> String {
        let Some((_, nearest)) = kept.iter().map(|k| (self.likeness(k), k)).max_by_key(|n| n.0)
        else {
            return "no image of this material is kept".into();
        };
        let now = |what: &str, old: &dyn Display, new: &dyn Display| {
            format!("{what} {new}; images are kept for {old}")
        };
        if self.numerics != nearest.numerics {
            return "the kept images are of another version of the program".into();
        }
        if self.settings != nearest.settings {
            return "the kept images are for another microscope or other numerics".into();
        }
        if self.sigma != nearest.sigma {
            return now("displacements (A)", &nearest.sigma, &self.sigma);
        }
        if self.process != nearest.process {
            return now("defects:", &nearest.process, &self.process);
        }
        if self.rate != nearest.rate {
            let alike = kept.iter().filter(|k| self.likeness(k) == self.likeness(nearest));
            let mut rates: Vec<f64> = alike.map(|k| k.rate).collect();
            rates.sort_by(f64::total_cmp);
            rates.dedup();
            let percent = |r: &f64| format!("{} %", (1e4 * r).round() / 1e2);
            let rates = rates.iter().map(percent).collect::<Vec<_>>().join(", ");
            return now("neighbours with defects on about", &rates, &percent(&self.rate));
        }
        if self.sites != nearest.sites {
            return "another crystal, thickness, strain or boundary than the kept images".into();
        }
        "more contents or phonon configurations of a kind that is kept".into()
    }

    /// Similarity of two notes: the number of equal parts before the first different one, in the order of their weight.
    fn likeness(&self, other: &ImageNote) -> usize {
        let same = [
            self.numerics == other.numerics,
            self.settings == other.settings,
            self.sigma == other.sigma,
            self.process == other.process,
            self.sites == other.sites,
            self.rate == other.rate,
        ];
        same.iter().take_while(|s| **s).count()
    }
}

fn digest(text: String) -> String {
    Sha256::digest(text)[..8].iter().map(|b| format!("{b:02x}")).collect()
}

fn in_words(process: DefectKind) -> String {
    let host = elements::symbol(process.element);
    match process.by {
        Some(by) => format!("{} for {host}", elements::symbol(by)),
        None => format!("{host} vacancies"),
    }
}

/// The sites of a library cell as text, without their occupation.
fn sites(library_cell: &LibraryCell) -> String {
    let members = library_cell.units.iter().flat_map(|u| &u.members);
    let sites = members.chain(&library_cell.surroundings).flatten();
    let text = sites.map(|s| format!("{:.5?} {};", s.position, s.number));
    format!("{:?} {}", library_cell.box_angstrom, text.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn note() -> ImageNote {
        ImageNote {
            numerics: 1,
            settings: "a".into(),
            sigma: "Mg 0.05".into(),
            sites: "b".into(),
            process: "Ca for Mg".into(),
            rate: 0.015,
            image: [0, 0],
        }
    }

    #[test]
    fn the_nearest_image_tells_what_is_new() {
        let new = note();
        assert_eq!(new.difference(&[]), "no image of this material is kept");
        let old = ImageNote { numerics: 0, ..note() };
        assert!(new.difference(std::slice::from_ref(&old)).contains("another version"));
        let rate = |rate| ImageNote { rate, ..note() };
        let message = new.difference(&[old.clone(), rate(0.04), rate(0.08)]);
        assert_eq!(message, "neighbours with defects on about 1.5 %; images are kept for 4 %, 8 %");
        let more = ImageNote { image: [3, 1], ..note() };
        assert!(new.difference(&[rate(0.04), more]).contains("more contents"));
        let thicker = ImageNote { sites: "c".into(), ..note() };
        assert!(new.difference(&[thicker]).contains("thickness"));
    }
}
