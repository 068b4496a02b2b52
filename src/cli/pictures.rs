//! PNG files beside the results.

use ndarray::{Array2, ArrayView2};
use std::path::Path;
use stemgen::io::WorldFile;
use stemgen::io::schema::OVERVIEW_FACTOR;
use stemgen::render::Picture;

/// Pixels that are not square by more than this are resampled.
const SQUARE: f64 = 1.005;
/// Worlds up to this many pixels wide are drawn from all their pixels, others from the overview.
const WHOLE_WORLD: usize = 3000;

/// Writes an image with pixels of `step` (x, y) Angstrom.
pub fn write(path: &Path, image: ArrayView2<f32>, step: [f64; 2]) -> anyhow::Result<()> {
    let (image, pixel) = squared(image, step);
    let (rows, columns) = image.dim();
    let values: Vec<f32> = image.into_iter().collect();
    let mut picture = Picture::new(&values, [rows, columns])?;
    picture.pixel_angstrom = Some(pixel);
    Ok(picture.write_png(path)?)
}

/// Writes the whole of a world.
pub fn write_world(path: &Path, world: &WorldFile) -> anyhow::Result<()> {
    let [rows, columns] = world.shape();
    let pixel = 10.0 * world.metadata().pixel_size_nm;
    if rows.max(columns) <= WHOLE_WORLD {
        return write(path, world.stitched(0..rows, 0..columns)?.view(), [pixel; 2]);
    }
    write(path, world.overview()?.view(), [pixel * OVERVIEW_FACTOR as f64; 2])
}

/// The image with square pixels of the smaller step, by linear interpolation, and that step.
fn squared(image: ArrayView2<f32>, [x, y]: [f64; 2]) -> (Array2<f32>, f64) {
    let pixel = x.min(y);
    let (rows, columns) = image.dim();
    if x.max(y) / pixel < SQUARE {
        return (image.to_owned(), (x * y).sqrt());
    }
    let size = |n: usize, step: f64| ((n as f64 * step / pixel).round() as usize).max(1);
    let (new_rows, new_columns) = (size(rows, y), size(columns, x));
    let place = |i: usize, from: usize, to: usize| {
        let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, from as f64 - 1.0);
        let low = at as usize;
        (low, (low + 1).min(from - 1), (at - low as f64) as f32)
    };
    let value = |(i, j)| {
        let (r0, r1, a) = place(i, rows, new_rows);
        let (c0, c1, b) = place(j, columns, new_columns);
        let along = |r: usize| (1.0 - b) * image[[r, c0]] + b * image[[r, c1]];
        (1.0 - a) * along(r0) + a * along(r1)
    };
    (Array2::from_shape_fn((new_rows, new_columns), value), pixel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_become_square() {
        let image = Array2::from_shape_fn((4, 3), |(i, _)| i as f32);
        let (out, pixel) = squared(image.view(), [0.4, 0.2]);
        assert_eq!((out.dim(), pixel), ((4, 6), 0.2));
        assert_eq!(out.column(5), image.column(0));
        assert_eq!(squared(image.view(), [0.2, 0.2]).0, image);
    }
}
