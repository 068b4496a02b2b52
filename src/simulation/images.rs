//! Simulated images, and the electrons that are counted in them.

use ndarray::{Array3, ArrayView3, Axis};

use crate::engine::{Scan, SourceBlur};
use crate::error::Result;
use crate::imaging::Noise;

/// Unit of images of scans.
pub(crate) const FRACTION_OF_BEAM: &str = "fraction of the incident beam";
/// Unit of images of a plane wave.
pub(super) const OF_INCIDENT_WAVE: &str = "intensity; that of the incident wave is 1";

/// An image of one detector, or of the lens, at one defocus.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedImage {
    /// Name of the detector, with the defocus in a series.
    pub name: String,
    /// (thickness, y, x)
    pub data: Array3<f32>,
    /// Unit of the values.
    pub units: &'static str,
    /// The defocus in Angstrom.
    pub defocus_angstrom: f64,
    /// Inner and outer angle in mrad of a detector.
    pub annulus_mrad: Option<[f64; 2]>,
    /// Azimuths in degrees of a sector of this annulus.
    pub sector_degrees: Option<[f64; 2]>,
    /// Counted electrons if the request gives a dose: (thickness, y, x).
    pub counts: Option<Array3<u32>>,
    /// Whether the image shows the counted electrons of another image.
    pub noisy: bool,
}

/// The name of an image: the name of its detector, with the defocus in a series.
pub(super) fn name_of(detector: &str, series_defocus_angstrom: Option<f64>) -> String {
    series_defocus_angstrom
        .map_or_else(|| detector.to_owned(), |defocus| format!("{detector}_defocus_{defocus}A"))
}

/// The name of the noisy image that belongs to an image.
pub fn noisy_name(name: &str) -> String {
    format!("{name}_noisy")
}

impl SimulatedImage {
    /// The noisy image: counts divided by the electrons of a pixel. `None` if none were counted.
    pub fn noisy(&self, electrons_per_pixel: f64) -> Option<SimulatedImage> {
        let share = |n: &u32| (f64::from(*n) / electrons_per_pixel) as f32;
        let data = self.counts.as_ref()?.map(share);
        let name = noisy_name(&self.name);
        Some(SimulatedImage { name, data, counts: None, noisy: true, ..self.clone() })
    }

    /// Counts electrons, as image number `n`. Each image and thickness has its own random numbers.
    pub(super) fn count(&mut self, n: usize, seed: u64, electrons_per_pixel: f64, scan: &Scan) {
        let (thicknesses, rows, columns) = self.data.dim();
        let mut counts = Array3::zeros((thicknesses, rows, columns));
        for (t, sharp) in self.data.outer_iter().enumerate() {
            let noise = Noise {
                seed,
                electrons_per_pixel,
                origin_px: [(n * thicknesses + t) * rows, 0],
                full_width_px: scan.shape[1],
                detector: 0,
            };
            counts.index_axis_mut(Axis(0), t).assign(&noise.counted(&sharp.to_owned()));
        }
        self.counts = Some(counts);
    }
}

/// Blurs images (thickness, y, x) by the source, and cuts off the margin that the source needs.
pub(super) fn blurred(blur: &SourceBlur, sharp: ArrayView3<f32>) -> Result<Array3<f32>> {
    let images: Vec<_> = sharp.outer_iter().map(|image| blur.image(image)).collect();
    let shape = images.first().map_or((0, 0), |image| image.dim());
    let mut out = Array3::zeros((images.len(), shape.0, shape.1));
    for (mut to, image) in out.outer_iter_mut().zip(&images) {
        to.assign(image);
    }
    Ok(out)
}
