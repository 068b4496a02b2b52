//! `stemgen view` of diffraction patterns.

use anyhow::bail;
use ndarray::{Array2, Axis};
use stemgen::io::PatternFile;
use stemgen::progress::Progress;
use stemgen::render::html::{CubePage, Page};
use stemgen::render::{Contrast, Picture, RgbImage, WorldPicture};

/// Makes the page of a file of patterns.
///
/// # Errors
/// A file of rings; damaged patterns; Ctrl-C.
pub fn page(file: &PatternFile, title: String, progress: &dyn Progress) -> anyhow::Result<Page> {
    let Some(page) = CubePage::of(file.header(), title) else {
        bail!(
            "sums over rings have no page; `stemgen integrate` makes images of them, and `stemgen patterns` without --radial simulates pixels"
        );
    };
    Ok(page.page(&|rows| file.rows(rows), progress)?)
}

/// Draws the mean pattern; also returns a description of the picture. Colours show the fourth root of the intensities.
///
/// # Errors
/// A file of rings; damaged patterns; Ctrl-C.
pub fn picture(
    file: &PatternFile,
    view: &WorldPicture,
    progress: &dyn Progress,
) -> anyhow::Result<(RgbImage, String)> {
    let header = file.header();
    let Some(detector) = header.detector.pixels() else {
        bail!("sums over rings have no picture; `stemgen integrate` makes images of them");
    };
    let [rows, columns] = header.scan.shape;
    let mut mean = Array2::<f64>::zeros((detector.pixels, detector.pixels));
    progress.start("reading", "rows", rows as u64);
    for row in 0..rows {
        if progress.interrupted() {
            return Err(stemgen::Error::Interrupted.into());
        }
        for pattern in file.rows(row..row + 1)?.index_axis(Axis(0), 0).outer_iter() {
            mean.zip_mut_with(&pattern, |sum, v| *sum += f64::from(*v));
        }
        progress.advance(1);
    }
    progress.finish();
    let shown = mean.iter().map(|v| (v.max(0.0) / (rows * columns) as f64).powf(0.25) as f32);
    let shown: Vec<f32> = shown.collect();
    let mut picture = Picture::new(&shown, [detector.pixels; 2])?;
    picture.max_side = view.longest_side_px as usize;
    picture.colormap = view.colormap;
    let [low, high] = view.contrast_percentiles;
    picture.contrast = Contrast::Percentile { low, high };
    let words = format!(
        "mean of {columns} x {rows} patterns to {} mrad (fourth root)",
        detector.max_angle_mrad
    );
    Ok((picture.render()?, words))
}
