//! The size of the electron source in images of a field: rectangles are made with a margin and blurred.
//!
//! The margin is as wide as the blur's reach, so nothing wraps around. A margin that would begin before the full field, whose pixels count
//! from 0, is filled with the mirror image of the field. This touches only the outermost pixels of a full field.

use ndarray::Array2;

use super::displaced_atoms::DisplacedAtoms;
use super::imaging_cost::ImagingCost;
use super::pixels::PixelRect;
use super::region_imager::{
    DetectorChoice, ImageBlocks, ImagerFacts, RasterDetail, RegionImager, SharedLibrary,
};
use super::turned_raster::TurnedRaster;
use crate::engine::{Scan, Source, SourceBlur};
use crate::error::Result;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{Recipe, Region};

/// An imager whose images are blurred by a source.
pub(crate) struct SourceImager {
    inner: Box<dyn RegionImager>,
    source: Source,
    pixel_angstrom: f64,
}

impl SourceImager {
    /// Blurs an imager by the recipe's source, or returns it unchanged for a point source.
    pub(crate) fn blurring(inner: Box<dyn RegionImager>, recipe: &Recipe) -> Box<dyn RegionImager> {
        let pixel_angstrom = recipe.field.pixel_angstrom();
        match recipe.optics.source() {
            Some(source) => Box::new(SourceImager { inner, source, pixel_angstrom }),
            None => inner,
        }
    }
}

/// The images of a rectangle for a source. `sharp` makes images of a wider rectangle for a point source.
///
/// # Errors
/// Errors of `sharp` and of the source.
pub(crate) fn blurred(
    (source, pixel_angstrom): (Source, f64),
    pixels: &PixelRect,
    sharp: impl FnOnce(&PixelRect) -> Result<Vec<Array2<f64>>>,
) -> Result<Vec<Array2<f64>>> {
    let scan =
        Scan { origin_angstrom: [0.0; 2], step_angstrom: [pixel_angstrom; 2], shape: pixels.shape };
    let blur = SourceBlur::new(source, &scan, [f64::INFINITY; 2])?;
    let [x, y] = blur.margin();
    let margin = [y, x];
    let before = plane::min(margin, pixels.first);
    let wide = PixelRect::new(
        plane::sub(pixels.first, before),
        plane::add(plane::add(pixels.shape, before), margin),
    );
    let lacks = plane::sub(margin, before);
    let blurred = |image: Array2<f64>| {
        let image = if lacks == [0, 0] { image } else { mirrored(&image, lacks) };
        pixels.sampled(blur.blurred(image))
    };
    Ok(sharp(&wide)?.into_iter().map(blurred).collect())
}

/// Number of pixels that images need on every side for a source.
///
/// # Errors
/// Errors of the source.
pub(crate) fn margin_px(source: Source, pixel_angstrom: f64) -> Result<usize> {
    let step_angstrom = [pixel_angstrom; 2];
    let scan = Scan { origin_angstrom: [0.0; 2], step_angstrom, shape: [1, 1] };
    Ok(SourceBlur::new(source, &scan, [f64::INFINITY; 2])?.margin()[0])
}

/// Continues an image beyond its first rows and columns by its mirror image. The numbers of added rows and columns are given.
fn mirrored(image: &Array2<f64>, [above, left]: [usize; 2]) -> Array2<f64> {
    let (rows, columns) = image.dim();
    let at = |i: usize, before: usize, n: usize| {
        if i >= before { i - before } else { (before - i).min(n - 1) }
    };
    Array2::from_shape_fn((rows + above, columns + left), |(i, j)| {
        image[[at(i, above, rows), at(j, left, columns)]]
    })
}

impl RegionImager for SourceImager {
    fn facts(&self) -> ImagerFacts {
        let mut facts = self.inner.facts();
        facts.parameters["source"] = serde_json::json!(self.source);
        facts
    }

    fn library_mut(&mut self) -> Option<&mut dyn SharedLibrary> {
        self.inner.library_mut()
    }

    fn blocks(&self) -> Option<&dyn ImageBlocks> {
        self.inner.blocks()
    }

    fn images_of(
        &self,
        pixels: &PixelRect,
        detectors: DetectorChoice,
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        blurred((self.source, self.pixel_angstrom), pixels, |wide| {
            self.inner.images_of(wide, detectors, configurations, progress)
        })
    }

    fn images_at(
        &self,
        _: &TurnedRaster,
        _: RasterDetail,
        _: DetectorChoice,
        _: usize,
        _: &dyn Progress,
    ) -> Result<Option<Vec<Array2<f64>>>> {
        Ok(None)
    }

    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        self.inner.atoms(area, configuration)
    }

    fn cost(&self, subtile: [usize; 2], subtiles: usize) -> Result<ImagingCost> {
        self.inner.cost(subtile, subtiles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(first: [usize; 2], shape: [usize; 2]) -> Array2<f64> {
        let at = |(i, j): (usize, usize)| {
            2.0 + (0.9 * (first[0] + i) as f64).cos() + (0.7 * (first[1] + j) as f64 + 0.3).sin()
        };
        Array2::from_shape_fn((shape[0], shape[1]), at)
    }

    /// Waves are damped by the Fourier transform of the Gaussian, in the middle of the field and at its edge. Every other pixel agrees with
    /// the image of all.
    #[test]
    fn rectangles_are_blurred_with_a_margin() {
        let (source, pixel) = (Source::gaussian(0.9), 0.2);
        let sigma = 0.9 / (8.0 * std::f64::consts::LN_2).sqrt();
        let damped = |turn: f64| (-0.5 * (turn * sigma / pixel).powi(2)).exp();
        let made = |first: [usize; 2], stride: usize| {
            let pixels = PixelRect::new(first, [12, 15]).every(stride);
            let sharp = |wide: &PixelRect| Ok(vec![wave(wide.first, wide.shape)]);
            blurred((source, pixel), &pixels, sharp).unwrap().remove(0)
        };
        let image = made([40, 30], 1);
        for ((i, j), v) in image.indexed_iter() {
            let (y, x) = (0.9 * (40 + i) as f64, 0.7 * (30 + j) as f64 + 0.3);
            let expected = 2.0 + damped(0.9) * y.cos() + damped(0.7) * x.sin();
            assert!((v - expected).abs() < 2e-3, "{i} {j}: {v} {expected}");
        }
        let every = made([40, 30], 3);
        assert_eq!(every[[2, 4]], image[[6, 12]]);
        // Far from the edge, the image is as inside the field.
        let edge = made([0, 0], 1);
        let inside =
            2.0 + damped(0.9) * (0.9_f64 * 11.0).cos() + damped(0.7) * (0.7_f64 * 14.0 + 0.3).sin();
        assert!((edge[[11, 14]] - inside).abs() < 2e-3);
    }
}
