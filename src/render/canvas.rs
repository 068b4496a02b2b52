//! An RGB image, and anti-aliased drawing on it.

use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::plane;
use std::path::Path;

/// A point (x to the right, y down) in pixels; the first pixel's centre is (0, 0).
pub(super) type Point = [f64; 2];

/// An 8-bit RGB image.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue of each pixel, row by row.
    pub pixels: Vec<u8>,
    /// Length of the scale bar in Angstrom, if one is drawn.
    pub bar_angstrom: Option<f64>,
}

impl RgbImage {
    /// An image of one colour.
    pub(super) fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        let pixels = color.repeat(width * height);
        RgbImage { width, height, pixels, bar_angstrom: None }
    }

    /// Writes a PNG through a temporary file, so that `path` is either complete or untouched.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let bytes = self.encode().map_err(|e| Error::io(path, "encode", e))?;
        atomic_write::write(path, &bytes)
    }

    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// What the encoder says, as for an image without pixels.
    pub fn encode(&self) -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Mixes `color` into one pixel.
    pub(super) fn blend(&mut self, x: usize, y: usize, color: [u8; 3], alpha: f64) {
        let start = 3 * (y * self.width + x);
        for (old, new) in self.pixels[start..start + 3].iter_mut().zip(color) {
            let mixed = f64::from(*old) + (f64::from(new) - f64::from(*old)) * alpha;
            *old = mixed.round() as u8;
        }
    }

    /// Colours the pixels of the rectangle `low..high` by `alpha` times the part of the pixel that
    /// lies inside the shape whose signed distance is `distance` (negative inside).
    fn paint(
        &mut self,
        low: Point,
        high: Point,
        color: [u8; 3],
        alpha: f64,
        distance: impl Fn(Point) -> f64,
    ) {
        let range = |low: f64, high: f64, size: usize| {
            let first = (low - 1.0).floor().max(0.0) as usize;
            let last = ((high + 1.0).ceil().max(-1.0) + 1.0).min(size as f64) as usize;
            first..last
        };
        for y in range(low[1], high[1], self.height) {
            for x in range(low[0], high[0], self.width) {
                let inside = (0.5 - distance([x as f64, y as f64])).clamp(0.0, 1.0);
                if inside > 0.0 {
                    self.blend(x, y, color, inside * alpha);
                }
            }
        }
    }

    /// Draws lines with round ends; where they overlap they count once.
    pub(super) fn stroke(
        &mut self,
        lines: &[Vec<Point>],
        thickness: f64,
        color: [u8; 3],
        alpha: f64,
    ) {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in lines.iter().flatten() {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis] - thickness);
                high[axis] = high[axis].max(point[axis] + thickness);
            }
        }
        self.paint(low, high, color, alpha, |p| {
            let nearest = lines
                .iter()
                .flat_map(|line| line.windows(2))
                .map(|ends| distance_to_segment(p, ends[0], ends[1]))
                .fold(f64::INFINITY, f64::min);
            nearest - thickness / 2.0
        });
    }

    /// Draws a circle.
    pub(super) fn ring(
        &mut self,
        center: Point,
        radius: f64,
        thickness: f64,
        color: [u8; 3],
        alpha: f64,
    ) {
        let reach = radius + thickness;
        let (low, high) = (center.map(|c| c - reach), center.map(|c| c + reach));
        self.paint(low, high, color, alpha, |p| {
            ((p[0] - center[0]).hypot(p[1] - center[1]) - radius).abs() - thickness / 2.0
        });
    }

    /// Fills a rectangle with round corners.
    pub(super) fn fill(
        &mut self,
        low: Point,
        high: Point,
        radius: f64,
        color: [u8; 3],
        alpha: f64,
    ) {
        let center = plane::add(low, high).map(|v| v / 2.0);
        let half = plane::sub(high, low).map(|v| v / 2.0 - radius);
        self.paint(low, high, color, alpha, |p| {
            let beyond = plane::sub(plane::sub(p, center).map(f64::abs), half);
            let outside = beyond[0].max(0.0).hypot(beyond[1].max(0.0));
            outside + beyond[0].max(beyond[1]).min(0.0) - radius
        });
    }
}

fn distance_to_segment(p: Point, a: Point, b: Point) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let from = [p[0] - a[0], p[1] - a[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    let t = if length2 > 0.0 {
        ((from[0] * along[0] + from[1] * along[1]) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (from[0] - t * along[0]).hypot(from[1] - t * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black(width: usize, height: usize) -> RgbImage {
        RgbImage::filled(width, height, [0; 3])
    }

    #[test]
    fn a_fill_covers_its_area_also_between_pixels() {
        let mut image = black(40, 30);
        image.fill([3.3, 4.6], [20.3, 12.1], 0.0, [255; 3], 1.0);
        let area: f64 = image.pixels.iter().step_by(3).map(|&p| f64::from(p) / 255.0).sum();
        assert!((area - 17.0 * 7.5).abs() < 2.0, "{area}");
    }

    #[test]
    fn a_stroke_has_its_thickness_and_is_clipped() {
        let mut image = black(40, 30);
        image.stroke(&[vec![[10.0, -50.0], [10.0, 90.0]]], 3.0, [255; 3], 1.0);
        let row: f64 = image.pixels[..120].iter().step_by(3).map(|&p| f64::from(p) / 255.0).sum();
        assert!((row - 3.0).abs() < 0.05, "{row}");
        let before = image.clone();
        image.stroke(&[vec![[-90.0, -50.0], [-80.0, -50.0]]], 3.0, [255; 3], 1.0);
        image.stroke(&[], 3.0, [255; 3], 1.0);
        assert_eq!(image, before);
    }
}
