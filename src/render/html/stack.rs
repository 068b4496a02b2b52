//! The page of simulated images.

use ndarray::{ArrayView3, Axis};

use super::Page;
use super::header::PageHeader;
use super::plain_images::{PlainImages, SeriesPlace};
use crate::error::{Error, Result};
use crate::render::enlarge::check_finite;
use crate::setting::Setting;

/// Images of one detector.
#[derive(Debug, Clone)]
pub(crate) struct ImageOfStack<'a> {
    /// Name of the detector.
    pub name: &'a str,
    /// What the values are.
    pub quantity: &'a str,
    /// (thickness, y, x)
    pub data: ArrayView3<'a, f32>,
}

/// Images of one scan.
#[derive(Debug, Clone)]
pub(crate) struct StackPage<'a> {
    /// Name of the structure.
    pub title: String,
    /// Names and values to be read by people.
    pub facts: Vec<(String, String)>,
    /// Pixel (x, y) in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Position (x, y) of the first pixel in Angstrom.
    pub origin_angstrom: [f64; 2],
    /// Thicknesses in Angstrom.
    pub thicknesses_angstrom: Vec<f64>,
    /// The images, all of one size.
    pub images: Vec<ImageOfStack<'a>>,
}

impl StackPage<'_> {
    /// Makes the page.
    ///
    /// # Errors
    /// [`Error::Invalid`] for no image, images of different sizes, or a value that is not finite.
    pub(crate) fn page(&self) -> Result<Page> {
        let Some(first) = self.images.first() else {
            return Err(Error::invalid(Setting::Images, 0, "expected at least one"));
        };
        let (_, rows, columns) = first.data.dim();
        let mut images = PlainImages::default();
        for image in &self.images {
            if image.data.dim() != (self.thicknesses_angstrom.len(), rows, columns) {
                let expected = format!("expected {rows} x {columns} pixels at each thickness");
                let shape = format!("{:?} of `{}`", image.data.dim(), image.name);
                return Err(Error::invalid(Setting::ImageShape, shape, expected));
            }
            for (slice, thickness) in image.data.axis_iter(Axis(0)).zip(&self.thicknesses_angstrom)
            {
                let values = slice.as_standard_layout();
                check_finite(values.as_slice().unwrap_or_default(), columns)?;
                let at = SeriesPlace { thickness: Some(*thickness), ..SeriesPlace::default() };
                images.add(image.name.to_owned(), &at, image.quantity.to_owned(), slice)?;
            }
        }
        images.page(PageHeader {
            title: self.title.clone(),
            unit: "\u{c5}",
            size: [columns, rows],
            pixel: self.step_angstrom,
            origin: self.origin_angstrom,
            facts: self.facts.clone(),
            ..PageHeader::default()
        })
    }
}
