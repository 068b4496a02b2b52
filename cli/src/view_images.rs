//! `stemgen view` of simulated images and recordings.

use super::hints::hinted;

use anyhow::anyhow;
use stemgen::io::{ImageKind, StoredImages};
use stemgen::render::{Contrast, Picture, RgbImage, WorldPicture, image_pictures};

/// The image of a file that is drawn.
pub struct ViewedImage<'a> {
    /// Name of the image; `None`: the first image, or the ideal image of a recording with `--clean`.
    pub name: Option<&'a str>,
    /// Number of the image in a stack; `None`: the last.
    pub index: Option<usize>,
}

/// Draws an image; also returns a description of the picture.
///
/// # Errors
/// Errors of the file; a clean image of a file that holds no recording.
pub fn picture(
    images: &StoredImages,
    choice: &ViewedImage<'_>,
    view: &WorldPicture,
) -> anyhow::Result<(RgbImage, String)> {
    let own = ["recording", "ideal"];
    let (name, image) = match (view.clean, choice.name, images.kind) {
        (true, None, ImageKind::Recording) => ("ideal", images.image("ideal", choice.index)?),
        (true, Some(name), ImageKind::Recording) if !own.contains(&name) => {
            (name, images.ideal(name)?)
        }
        (true, ..) => {
            let fault = anyhow!("--clean: is for worlds and for detectors of recordings");
            return Err(hinted(
                fault,
                format!(
                    "leave out --clean; the images of --detector are {}",
                    images.names.join(", ")
                ),
            ));
        }
        (false, Some(name), _) => (name, images.image(name, choice.index)?),
        (false, None, _) => (&images.names[0][..], images.image(&images.names[0], choice.index)?),
    };
    let (rows, columns) = image.values.dim();
    let size = [columns, rows].map(|n| n as f64);
    let [width, height] = [0, 1].map(|k| 0.1 * size[k] * image.step_angstrom[k]);
    let (values, pixel) = image_pictures::resampled(image.values.view(), image.step_angstrom);
    let shape = values.dim();
    let values: Vec<f32> = values.into_iter().collect();
    let mut picture = Picture::new(&values, [shape.0, shape.1])?;
    picture.pixel_angstrom = Some(pixel);
    picture.max_side = view.longest_side_px as usize;
    picture.colormap = view.colormap;
    let [low, high] = view.contrast_percentiles;
    picture.contrast = Contrast::Percentile { low, high };
    let number = match image.of {
        1 => String::new(),
        n => format!(", number {} of 0 to {}", choice.index.unwrap_or(n - 1), n - 1),
    };
    Ok((picture.render()?, format!("{name}{number}, {width:.2} x {height:.2} nm")))
}
