//! Pixels of a field, and the box of specimen around them.

use ndarray::Array2;

use crate::engine::Scan;
use crate::lengths;
use crate::recipe::region::Region;

/// A rectangle of pixels of the full field, or every `stride`-th pixel of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// Row and column of the first pixel in the full field.
    pub first: [usize; 2],
    /// Rows and columns that it spans.
    pub shape: [usize; 2],
    /// Only every `stride`-th row and column is imaged: 1 for all.
    pub stride: usize,
}

impl PixelRect {
    /// All of `shape` (rows, columns) pixels from pixel `first` (row, column) of the full field.
    pub fn new(first: [usize; 2], shape: [usize; 2]) -> Self {
        PixelRect { first, shape, stride: 1 }
    }

    /// Every `stride`-th pixel of the rectangle along each axis.
    #[must_use]
    pub fn every(self, stride: usize) -> Self {
        PixelRect { stride, ..self }
    }

    /// Rows and columns of the imaged pixels.
    pub fn sampled_shape(&self) -> [usize; 2] {
        self.shape.map(|n| n.div_ceil(self.stride))
    }

    /// The area that the rectangle covers.
    pub fn region(&self, pixel_nm: f64) -> Region {
        Region::of_pixels(self.first, self.shape, pixel_nm)
    }

    /// Picks the imaged pixels, [row, column], from an image of all pixels.
    pub(crate) fn sampled(&self, image: Array2<f64>) -> Array2<f64> {
        if self.stride == 1 {
            return image;
        }
        let [rows, columns] = self.sampled_shape();
        let at = |(i, j): (usize, usize)| image[[i * self.stride, j * self.stride]];
        Array2::from_shape_fn((rows, columns), at)
    }
}

/// Pixels to be simulated, with the specimen around them that an engine needs.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelBox {
    /// The area of the specimen, in nm of the full field.
    pub area: Region,
    /// Extent of the specimen along x, y and the beam in Angstrom.
    pub size_angstrom: [f64; 3],
    /// The scan of the pixels, in Angstrom from the corner of the area.
    pub scan: Scan,
}

impl PixelBox {
    /// The pixels of a rectangle with `margin_angstrom` of specimen around.
    pub fn new(pixels: &PixelRect, pixel_nm: f64, margin_angstrom: f64, thickness_nm: f64) -> Self {
        let (margin_nm, pixel_angstrom) =
            (lengths::nm(margin_angstrom), lengths::angstrom(pixel_nm));
        let scan = Scan {
            origin_angstrom: [lengths::angstrom(margin_nm) + 0.5 * pixel_angstrom; 2],
            step_angstrom: [pixel_angstrom * pixels.stride as f64; 2],
            shape: pixels.sampled_shape(),
        };
        let area = pixels.region(pixel_nm).grown(margin_nm);
        Self::of_area(area, scan, lengths::angstrom(thickness_nm))
    }

    /// A scan of an area of a specimen.
    pub(crate) fn of_area(area: Region, scan: Scan, thickness_angstrom: f64) -> Self {
        let [width, height] = area.size_angstrom();
        PixelBox { size_angstrom: [width, height, thickness_angstrom], area, scan }
    }
}
