//! The page of a file of images: a recording, a series of recordings, or simulated images.

use super::Page;
use super::header::PageHeader;
use super::plain_images::{PlainImages, SeriesPlace};
use crate::error::{Error, Result};
use crate::io::{ImageKind, StoredImage, StoredImages};
use crate::lengths;
use crate::setting::Setting;

/// Largest number of pixels of all images of a page: about 400 MB of HTML.
const MOST_PIXELS: usize = 100_000_000;

/// What the page of a file of images shows.
#[derive(Debug, Clone)]
pub struct StoredPage {
    /// Name of the file.
    pub title: String,
    /// Name of the images; all if none.
    pub name: Option<String>,
    /// Number of the image in each stack; all if none.
    pub index: Option<usize>,
}

/// Images of one name: their name in the file, and whether the noise-free image of this detector is meant.
struct Named<'a> {
    name: &'a str,
    ideal: bool,
}

impl StoredPage {
    /// Makes the page.
    ///
    /// # Errors
    /// Errors of the file; [`Error::Invalid`] for more pixels than a page holds.
    pub fn page(&self, stored: &StoredImages) -> Result<Page> {
        let mut images = PlainImages::default();
        let mut shown: Option<([usize; 2], [f64; 2])> = None;
        for named in self.named(stored) {
            let first = named.read(stored, self.index)?;
            let numbers = self.index.map_or(0..first.of, |index| index..index + 1);
            let (rows, columns) = first.values.dim();
            if (images.len() + numbers.len()) * rows * columns > MOST_PIXELS {
                let expected = format!(
                    "a page holds at most {MOST_PIXELS} pixels; choose one image by its name or its number"
                );
                return Err(Error::invalid(Setting::Page, &self.title, expected));
            }
            let (shape, step) = *shown.get_or_insert(([rows, columns], first.step_angstrom));
            let series = first.of > 1;
            for number in numbers {
                let image = named.read(stored, series.then_some(number))?;
                if image.values.dim() != (shape[0], shape[1]) || image.step_angstrom != step {
                    let expected = "expected images of one size and pixel";
                    return Err(Error::invalid(Setting::Images, named.name, expected));
                }
                let at = SeriesPlace { number: series.then_some(number), ..SeriesPlace::default() };
                let quantity = image.units.unwrap_or_default();
                images.add(named.shown(), &at, quantity, image.values.view())?;
            }
        }
        let Some((shape, step)) = shown else {
            return Err(Error::invalid(Setting::Images, 0, "expected at least one"));
        };
        images.page(PageHeader {
            title: self.title.clone(),
            unit: "nm",
            size: [shape[1], shape[0]],
            pixel: lengths::nm(step),
            facts: facts(stored, shape, step),
            ..PageHeader::default()
        })
    }

    /// The images that are shown, in the order of the page.
    fn named<'a>(&'a self, stored: &'a StoredImages) -> Vec<Named<'a>> {
        if let Some(name) = &self.name {
            return vec![Named { name, ideal: false }];
        }
        let names = stored.names.iter().map(String::as_str);
        let both = |name: &'a str| [false, true].map(|ideal| Named { name, ideal });
        match stored.kind {
            // The first detector of a recording that names its detectors is the image `recording`.
            ImageKind::Recording if stored.names.len() > 2 => {
                names.skip(2).flat_map(both).collect()
            }
            _ => names.map(|name| Named { name, ideal: false }).collect(),
        }
    }
}

impl Named<'_> {
    fn read(&self, stored: &StoredImages, index: Option<usize>) -> Result<StoredImage> {
        match self.ideal {
            true => stored.ideal(self.name),
            false => stored.image(self.name, index),
        }
    }

    fn shown(&self) -> String {
        match (self.ideal, self.name) {
            (false, "ideal") => "noise-free".into(),
            (false, name) => name.into(),
            (true, name) => format!("{name}, noise-free"),
        }
    }
}

/// Names and values to be read by people.
fn facts(
    stored: &StoredImages,
    [rows, columns]: [usize; 2],
    step: [f64; 2],
) -> Vec<(String, String)> {
    let [x, y] = lengths::nm(step);
    let [width, height] = [columns as f64 * x, rows as f64 * y];
    let kind = match stored.kind {
        ImageKind::Simulated => "simulated images",
        ImageKind::Recording => "recording",
    };
    let mut facts = vec![
        ("file".to_owned(), kind.to_owned()),
        ("field".to_owned(), format!("{width:.2} \u{d7} {height:.2} nm")),
        ("pixels".to_owned(), format!("{columns} \u{d7} {rows} of {x:.5} \u{d7} {y:.5} nm")),
    ];
    facts.extend(stored.command_line.clone().map(|line| ("command".to_owned(), line)));
    facts
}
