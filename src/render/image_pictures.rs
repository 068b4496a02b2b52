//! PNG files and pages beside the results.

use std::f64::consts::PI;
use std::path::Path;

use ndarray::{Array2, ArrayView2};

use super::html::{ImageOfStack, StackPage};
use super::{Contrast, Picture};
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::io::{ImageSeries, ImageStack, WorldFile};
use crate::lengths;
use crate::recipe::OVERVIEW_FACTOR;

/// Pixels that are not square by more than this are resampled.
const SQUARE: f64 = 1.005;
/// Images up to this many pixels are enlarged, to about so many.
const SMALL: usize = 512;
const ENLARGED: usize = 1024;
/// Worlds up to this many pixels wide are drawn from all their pixels, others from the overview.
const WHOLE_WORLD: usize = 3000;

/// What is drawn over an image, and which values are black and white.
#[derive(Debug, Clone, Copy, Default)]
pub struct GreyScale {
    /// Draw a scale bar.
    pub scale_bar: bool,
    /// Draw the grey values with the numbers that black and white stand for.
    pub grey_bar: bool,
    /// Values of black and white; `None`: the percentiles 0.1 and 99.9 of the image.
    pub limits: Option<[f32; 2]>,
}

impl GreyScale {
    /// One scale for all images of a series: black and white are the percentiles 0.1 and 99.9 of all their values.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values that cannot be drawn.
    pub fn of_series(series: &ImageSeries) -> Result<Self> {
        let values: Vec<f32> = series.data().into_iter().collect();
        let limits = Picture::new(&values, [1, values.len()])?.limits()?;
        Ok(GreyScale { limits: Some(limits), ..GreyScale::default() })
    }

    /// The share of values below black or above white, from 0 to 1.
    pub fn clipped(&self, image: ArrayView2<f32>) -> f64 {
        let Some([low, high]) = self.limits else { return 0.0 };
        let beyond = image.iter().filter(|v| **v < low || **v > high).count();
        beyond as f64 / image.len().max(1) as f64
    }

    /// An image with pixels of `step` (x, y) Angstrom as a PNG.
    ///
    /// # Errors
    /// Values that cannot be drawn.
    pub fn png(&self, image: ArrayView2<f32>, step: [f64; 2]) -> Result<Vec<u8>> {
        let (image, pixel) = resampled(image, step);
        let (rows, columns) = image.dim();
        let values: Vec<f32> = image.into_iter().collect();
        let mut picture = Picture::new(&values, [rows, columns])?;
        picture.pixel_angstrom = self.scale_bar.then_some(pixel);
        picture.grey_bar = self.grey_bar;
        // An image of one value has no contrast.
        if let Some([min, max]) = self.limits.filter(|[min, max]| min < max) {
            picture.contrast = Contrast::Range { min, max };
        }
        picture.png()
    }
}

/// Writes an image with pixels of `step` (x, y) Angstrom.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for values that cannot be drawn.
pub fn write(path: &Path, image: ArrayView2<f32>, step: [f64; 2], scale_bar: bool) -> Result<()> {
    atomic_write::write(path, &png(image, step, scale_bar)?)
}

/// Writes a page of images of one scan.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for values that cannot be drawn.
pub fn write_page(
    path: &Path,
    title: &str,
    facts: Vec<(String, String)>,
    stacks: &[ImageStack],
) -> Result<()> {
    let Some(first) = stacks.first() else { return Ok(()) };
    let page = StackPage {
        title: title.to_owned(),
        facts,
        step_angstrom: first.step_angstrom,
        origin_angstrom: first.origin_angstrom,
        thicknesses_angstrom: first.thicknesses_angstrom.to_vec(),
        images: stacks
            .iter()
            .map(|s| ImageOfStack { name: s.name, quantity: s.units, data: s.data.view() })
            .collect(),
    };
    page.page()?.write(path)
}

/// The whole of a world as a PNG.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for values that cannot be drawn.
pub fn of_world(world: &WorldFile) -> Result<Vec<u8>> {
    let [rows, columns] = world.shape();
    let pixel = lengths::angstrom(world.metadata().pixel_size_nm);
    if rows.max(columns) <= WHOLE_WORLD {
        return png(world.stitched(0..rows, 0..columns)?.view(), [pixel; 2], true);
    }
    png(world.overview()?.view(), [pixel * OVERVIEW_FACTOR as f64; 2], true)
}

/// Writes the whole of a world as a PNG.
///
/// # Errors
/// Errors of the world file and of writing; [`Error::Invalid`] for values that cannot be drawn.
pub fn write_world(world: &WorldFile, path: &Path) -> Result<()> {
    std::fs::write(path, of_world(world)?).map_err(|e| Error::io(path, "write", e))
}

/// An image with pixels of `step` (x, y) Angstrom as a PNG.
///
/// # Errors
/// Errors of the file; [`Error::Invalid`] for values that cannot be drawn.
pub(crate) fn png(image: ArrayView2<f32>, step: [f64; 2], scale_bar: bool) -> Result<Vec<u8>> {
    GreyScale { scale_bar, ..GreyScale::default() }.png(image, step)
}

/// The image with square pixels, enlarged to about 1024 pixels if it is small, and that pixel.
pub fn resampled(image: ArrayView2<f32>, [x, y]: [f64; 2]) -> (Array2<f32>, f64) {
    let (rows, columns) = image.dim();
    if x.max(y) / x.min(y) < SQUARE && rows.max(columns) > SMALL {
        return (image.to_owned(), (x * y).sqrt());
    }
    let extent = [rows as f64 * y, columns as f64 * x];
    let finest = extent[0].max(extent[1]) / ENLARGED as f64;
    let pixel = if rows.max(columns) > SMALL { x.min(y) } else { finest };
    let size = extent.map(|l| ((l / pixel).round() as usize).max(1));
    let along_x = interpolate(image, size[1]);
    (interpolate(along_x.t(), size[0]).reversed_axes(), pixel)
}

/// The image (rows = y, columns = x) with `size` columns and as many rows as before, in its own unit,
/// by Lanczos interpolation over three pixels: near what belongs to an image sampled at its Nyquist limit.
pub(crate) fn interpolate(image: ArrayView2<f32>, size: usize) -> Array2<f32> {
    let (rows, columns) = image.dim();
    let mut out = Array2::zeros((rows, size));
    for i in 0..size {
        let at = (i as f64 + 0.5) * columns as f64 / size as f64 - 0.5;
        let first = at.floor() as i64 - 2;
        let weights: Vec<f64> = (first..first + 6).map(|p| lanczos(at - p as f64)).collect();
        let sum: f64 = weights.iter().sum();
        for (p, weight) in (first..).zip(weights) {
            let column = image.column(p.clamp(0, columns as i64 - 1) as usize);
            out.column_mut(i).scaled_add((weight / sum) as f32, &column);
        }
    }
    out
}

fn lanczos(x: f64) -> f64 {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) };
    if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One scale for a series: the image with the larger values is brighter, and what lies beyond the scale is counted.
    #[test]
    fn images_of_a_series_share_one_scale() {
        let dark = ndarray::Array3::from_shape_fn((1, 40, 40), |(_, i, j)| (40 * i + j) as f32);
        let bright = dark.mapv(|v| v + 1600.0);
        let stack = |name, data, defocus| ImageStack {
            name,
            data,
            units: "",
            step_angstrom: [0.2; 2],
            origin_angstrom: [0.0; 2],
            thicknesses_angstrom: &[10.0],
            defocus_angstrom: Some(defocus),
            annulus_mrad: None,
            sector_degrees: None,
            electrons_per_pixel: None,
        };
        let both =
            [stack("A_defocus_0A", dark.view(), 0.0), stack("A_defocus_10A", bright.view(), 10.0)];
        let series = ImageSeries::group(&both);
        let scale = GreyScale::of_series(&series[0]).unwrap();
        assert_eq!(scale.limits, Some([3.0, 3196.0]));
        let images = [&dark, &bright].map(|d| d.index_axis(ndarray::Axis(0), 0));
        assert!((scale.clipped(images[0]) - 3.0 / 1600.0).abs() < 1e-12);
        let pictures = images.map(|image| scale.png(image, [0.2; 2]).unwrap());
        let own = GreyScale::default();
        let alone = images.map(|image| own.png(image, [0.2; 2]).unwrap());
        assert!(pictures[0] != pictures[1] && alone[1] != pictures[1]);
    }

    #[test]
    fn pixels_become_square() {
        let image = Array2::from_shape_fn((4, 3), |(i, _)| i as f32);
        let (out, pixel) = resampled(image.view(), [0.4, 0.2]);
        assert_eq!(out.dim(), (683, 1024));
        assert!((pixel - 1.2 / 1024.0).abs() < 1e-12);
        let large = Array2::from_shape_fn((600, 3), |(i, _)| i as f32);
        assert_eq!(resampled(large.view(), [0.2, 0.2]).0, large);
        assert_eq!(resampled(large.view(), [0.4, 0.2]).0.dim(), (600, 6));
    }

    #[test]
    fn a_wave_near_the_nyquist_limit_keeps_its_shape() {
        let wave = |x: f64| (2.0 * PI * 0.3 * x).cos();
        let image = Array2::from_shape_fn((1, 40), |(_, i)| wave(i as f64) as f32);
        let fine = interpolate(image.view(), 400);
        for i in 100..300 {
            let expected = wave((i as f64 + 0.5) / 10.0 - 0.5);
            assert!((f64::from(fine[[0, i]]) - expected).abs() < 0.06, "{i}");
        }
    }
}
