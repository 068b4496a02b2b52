//! Images of a page without truth: each with its pyramid.

use ndarray::{ArrayView2, s};

use super::blobs::Blobs;
use super::header::{PageHeader, PageImage, Start};
use super::pyramid::{Pyramid, TILE};
use super::world::place;
use super::{Page, colormaps};
use crate::error::Result;

/// Images of one size, in the order of the page.
#[derive(Default)]
pub(super) struct PlainImages {
    images: Vec<PageImage>,
    pyramids: Vec<Pyramid>,
}

/// Place of an image in its series.
#[derive(Default)]
pub(super) struct SeriesPlace {
    /// As in [`PageImage`].
    pub thickness: Option<f64>,
    /// As in [`PageImage`].
    pub number: Option<usize>,
}

impl PlainImages {
    /// Number of images.
    pub(super) fn len(&self) -> usize {
        self.images.len()
    }

    /// Adds an image.
    ///
    /// # Errors
    /// Errors of [`Pyramid::new`].
    pub(super) fn add(
        &mut self,
        name: String,
        at: &SeriesPlace,
        quantity: String,
        values: ArrayView2<f32>,
    ) -> Result<()> {
        let (rows, columns) = values.dim();
        let read = |rows| Ok(values.slice(s![rows, ..]).to_owned());
        let pyramid = Pyramid::new([rows, columns], &read)?;
        self.images.push(PageImage {
            name,
            thickness: at.thickness,
            number: at.number,
            quantity,
            scale: 1.0,
            offset: 0.0,
            stored: None,
            electrons: None,
            exact: pyramid.exact,
            levels: Vec::new(),
        });
        self.pyramids.push(pyramid);
        Ok(())
    }

    /// Makes the page; `header` holds title, lengths and facts.
    ///
    /// # Errors
    /// Errors of [`Page::new`].
    pub(super) fn page(mut self, header: PageHeader) -> Result<Page> {
        let mut blobs = Blobs::default();
        place(&mut self.images, &mut self.pyramids, 1, &mut blobs);
        place(&mut self.images, &mut self.pyramids, 0, &mut blobs);
        let header = PageHeader {
            tile: TILE,
            images: self.images,
            colormaps: colormaps(),
            start: Start::default(),
            ..header
        };
        Page::new(&header, &blobs)
    }
}
