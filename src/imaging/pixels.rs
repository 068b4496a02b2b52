//! Pixels to be simulated, and the box of specimen around them.

use crate::engine::Scan;
use crate::recipe::region::Region;

/// A rectangle of pixels of the full field, with as much specimen around it as an engine needs.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelBox {
    /// The specimen, in nm of the full field.
    pub area: Region,
    /// Its extent along x, y and the beam in Angstrom.
    pub size_angstrom: [f64; 3],
    /// The pixels, in Angstrom from the corner of the area.
    pub scan: Scan,
}

impl PixelBox {
    /// Every `stride`-th of `shape` pixels from pixel `first`, both (row, column), with `margin_angstrom` around.
    pub fn new(
        (first, shape, stride): ([usize; 2], [usize; 2], usize),
        pixel_nm: f64,
        margin_angstrom: f64,
        thickness_nm: f64,
    ) -> Self {
        let margin_nm = 0.1 * margin_angstrom;
        let scan = Scan {
            origin_angstrom: [10.0 * margin_nm + 5.0 * pixel_nm; 2],
            step_angstrom: [10.0 * pixel_nm * stride as f64; 2],
            shape: shape.map(|n| n.div_ceil(stride)),
        };
        let area = Region::of_pixels(first, shape, pixel_nm).grown(margin_nm);
        Self::of_area(area, scan, 10.0 * thickness_nm)
    }

    /// A scan of an area of a specimen.
    pub fn of_area(area: Region, scan: Scan, thickness_angstrom: f64) -> Self {
        let size = |r: [f64; 2]| 10.0 * (r[1] - r[0]);
        PixelBox { size_angstrom: [size(area.x), size(area.y), thickness_angstrom], area, scan }
    }
}
