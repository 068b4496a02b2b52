//! From a matrix of values to a picture.

use super::canvas::RgbImage;
use super::colormap::Colormap;
use super::enlarge::{Enlarge, Matrix, SizeChange, check_finite, enlarge, shrink};
use super::overlay::{Marker, draw_bar, draw_caption, draw_grey_bar, draw_marker};
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::path::Path;

/// Sizes of a picture's longer side that are accepted, in pixels.
const SIDES: [usize; 2] = [16, 32_768];
/// Percentiles are taken of at most so many values.
const SAMPLE: usize = 4_000_000;

/// Which values become the first and the last colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Contrast {
    /// Percentiles of the image, in percent.
    Percentile {
        /// Becomes the first colour.
        low: f64,
        /// Becomes the last colour.
        high: f64,
    },
    /// Given values, so that pictures can be compared.
    Range {
        /// Becomes the first colour.
        min: f32,
        /// Becomes the last colour.
        max: f32,
    },
}

impl Default for Contrast {
    fn default() -> Self {
        Contrast::Percentile { low: 0.1, high: 99.9 }
    }
}

/// An image and how it is shown. The public fields may be changed before rendering.
#[derive(Debug, Clone)]
pub struct Picture<'a> {
    values: &'a [f32],
    shape: [usize; 2],
    /// Colours; gray by default.
    pub colormap: Colormap,
    /// Contrast; percentiles 0.1 to 99.9 by default.
    pub contrast: Contrast,
    /// Longest side of the picture in pixels, 1024 by default. The image is enlarged or averaged
    /// by the whole factor that comes nearest.
    pub max_side: usize,
    /// How an image smaller than `max_side` is enlarged.
    pub enlarge: Enlarge,
    /// Width of an image pixel in Angstrom; with it a scale bar is drawn, where it fits.
    pub pixel_angstrom: Option<f64>,
    /// Marks, drawn in this order.
    pub markers: Vec<Marker>,
    /// A line of text in the upper left corner, where it fits.
    pub caption: Option<String>,
    /// Draw the colours with the first and the last value, where they fit.
    pub grey_bar: bool,
}

impl<'a> Picture<'a> {
    /// A picture of `shape` = (rows, columns) values, row by row.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the shape is empty or does not match, or a value is not finite.
    pub fn new(values: &'a [f32], shape: [usize; 2]) -> Result<Self> {
        if shape.contains(&0) || shape[0].checked_mul(shape[1]) != Some(values.len()) {
            return Err(Error::invalid(
                Setting::ImageShape,
                format!("{} x {}", shape[0], shape[1]),
                format!("expected rows x columns of {} values, at least one", values.len()),
            ));
        }
        check_finite(values, shape[1])?;
        Ok(Picture {
            values,
            shape,
            colormap: Colormap::default(),
            contrast: Contrast::default(),
            max_side: 1024,
            enlarge: Enlarge::default(),
            pixel_angstrom: None,
            markers: Vec::new(),
            caption: None,
            grey_bar: false,
        })
    }

    /// Renders and writes a PNG, which appears complete or not at all.
    ///
    /// # Errors
    /// As [`Picture::render`], and [`Error::Io`].
    pub fn write_png(&self, path: &Path) -> Result<()> {
        self.render()?.write_png(path)
    }

    /// Renders a PNG.
    ///
    /// # Errors
    /// As [`Picture::render`].
    pub(crate) fn png(&self) -> Result<Vec<u8>> {
        self.render()?.encode().map_err(|e| {
            Error::invalid(Setting::ImageShape, e, "expected an image that PNG can hold")
        })
    }

    /// Renders the picture.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a setting is outside its limits.
    pub fn render(&self) -> Result<RgbImage> {
        let (scale, matrix) = self.resampled()?;
        let [min, max] = self.limits()?;
        let colors = self.colormap.table();
        let pixels = matrix.values.iter().flat_map(|&v| colors[level(v, min, max)]).collect();
        let [height, width] = matrix.shape;
        let mut image = RgbImage { width, height, pixels, bar_angstrom: None };
        for marker in &self.markers {
            draw_marker(&mut image, marker, scale)?;
        }
        if let Some(pixel) = self.pixel_angstrom {
            if !(pixel.is_finite() && pixel > 0.0) {
                return Err(Error::invalid(
                    Setting::PixelAngstrom,
                    pixel,
                    "expected a positive number",
                ));
            }
            image.bar_angstrom = draw_bar(&mut image, pixel / scale.factor());
        }
        if self.grey_bar {
            draw_grey_bar(&mut image, &colors, [min, max]);
        }
        if let Some(caption) = &self.caption {
            draw_caption(&mut image, caption);
        }
        Ok(image)
    }

    fn resampled(&self) -> Result<(SizeChange, Matrix)> {
        if !(SIDES[0]..=SIDES[1]).contains(&self.max_side) {
            let expected = format!("expected {} to {}", SIDES[0], SIDES[1]);
            return Err(Error::invalid(Setting::LongestSidePixels, self.max_side, expected));
        }
        let scale = SizeChange::to_fit(self.shape, self.max_side);
        let matrix = match scale {
            SizeChange::Down(n) => shrink(self.values, self.shape, n),
            SizeChange::Up(n) => enlarge(self.values, self.shape, n, self.enlarge),
        };
        Ok((scale, matrix))
    }

    /// The values of the first and the last colour.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a contrast outside its limits.
    pub fn limits(&self) -> Result<[f32; 2]> {
        match self.contrast {
            Contrast::Range { min, max } if min.is_finite() && max.is_finite() && min < max => {
                Ok([min, max])
            }
            Contrast::Range { min, max } => {
                let value = format!("{min} to {max}");
                Err(Error::invalid(Setting::ContrastRange, value, "expected finite min < max"))
            }
            Contrast::Percentile { low, high } if 0.0 <= low && low < high && high <= 100.0 => {
                Ok(percentiles(self.values, [low, high]))
            }
            Contrast::Percentile { low, high } => {
                let value = format!("{low} to {high}");
                let expected = "expected 0 <= low < high <= 100";
                Err(Error::invalid(Setting::ContrastPercentiles, value, expected))
            }
        }
    }
}

/// Index of a value's colour; an image without contrast is all of the middle one.
fn level(value: f32, min: f32, max: f32) -> usize {
    let range = f64::from(max) - f64::from(min);
    if range <= 0.0 {
        return 128;
    }
    let fraction = (f64::from(value) - f64::from(min)) / range;
    (fraction * 255.0).round().clamp(0.0, 255.0) as usize
}

/// Values at the given percentages, by nearest rank; of an even sample if there are many.
fn percentiles(values: &[f32], percent: [f64; 2]) -> [f32; 2] {
    let step = values.len().div_ceil(SAMPLE).max(1);
    let mut sample: Vec<f32> = values.iter().step_by(step).copied().collect();
    percent.map(|p| match p {
        0.0 => values.iter().copied().fold(f32::INFINITY, f32::min),
        100.0 => values.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        _ => {
            let rank = (p / 100.0 * (sample.len() - 1) as f64).round() as usize;
            *sample.select_nth_unstable_by(rank, f32::total_cmp).1
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_leave_out_the_extremes() {
        let mut values: Vec<f32> = (0..=1000).map(|v| v as f32).collect();
        assert_eq!(percentiles(&values, [0.1, 99.9]), [1.0, 999.0]);
        assert_eq!(percentiles(&values, [0.0, 100.0]), [0.0, 1000.0]);
        values.reverse();
        assert_eq!(percentiles(&values, [25.0, 50.0]), [250.0, 500.0]);
        assert_eq!(percentiles(&[7.0], [0.1, 99.9]), [7.0, 7.0]);
    }

    #[test]
    fn levels_are_clamped() {
        assert_eq!(level(-9.0, 0.0, 1.0), 0);
        assert_eq!(level(0.5, 0.0, 1.0), 128);
        assert_eq!(level(9.0, 0.0, 1.0), 255);
        assert_eq!(level(3.0, 3.0, 3.0), 128);
        assert_eq!(level(0.0, -f32::MAX, f32::MAX), 128);
    }

    #[test]
    fn settings_are_checked() {
        let values = [0.0, 1.0, 2.0, 3.0];
        assert!(Picture::new(&values, [3, 2]).is_err());
        assert!(Picture::new(&[], [0, 2]).is_err());
        assert!(Picture::new(&values, [usize::MAX, 4]).is_err());
        assert!(Picture::new(&[0.0, f32::NAN], [1, 2]).is_err());
        let good = Picture::new(&values, [2, 2]).unwrap();
        assert!(good.render().is_ok());
        let fails = |change: fn(&mut Picture)| {
            let mut picture = good.clone();
            change(&mut picture);
            picture.render().is_err()
        };
        assert!(fails(|p| p.max_side = 0));
        assert!(fails(|p| p.max_side = usize::MAX));
        assert!(fails(|p| p.pixel_angstrom = Some(f64::NAN)));
        assert!(fails(|p| p.pixel_angstrom = Some(0.0)));
        assert!(fails(|p| p.contrast = Contrast::Range { min: 1.0, max: 1.0 }));
        assert!(fails(|p| p.contrast = Contrast::Percentile { low: 50.0, high: f64::NAN }));
    }
}
