//! Images as a simulation makes them, and the electrons that are counted in them.

use ndarray::{Array3, ArrayView3, Axis};

use crate::engine::{Scan, SourceBlur};
use crate::error::Result;
use crate::imaging::Noise;

/// What images of scans are measured in.
pub const FRACTION_OF_BEAM: &str = "fraction of the incident beam";
/// What images of a plane wave are measured in.
pub(super) const OF_INCIDENT_WAVE: &str = "intensity; that of the incident wave is 1";

/// An image of one detector, or of the lens, at one defocus.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedImage {
    /// Name of the detector, with the defocus in a series.
    pub name: String,
    /// (thickness, y, x)
    pub data: Array3<f32>,
    /// What the values are.
    pub units: &'static str,
    /// The defocus in Angstrom.
    pub defocus_angstrom: f64,
    /// Inner and outer angle in mrad of a detector.
    pub annulus_mrad: Option<[f64; 2]>,
    /// Electrons counted, where a dose is asked for: (thickness, y, x).
    pub counts: Option<Array3<u32>>,
    /// Whether it is what counted electrons say of another image.
    pub noisy: bool,
}

/// The name of an image: that of its detector, with the defocus in a series.
pub(super) fn name_of(detector: &str, series_defocus_angstrom: Option<f64>) -> String {
    series_defocus_angstrom
        .map_or_else(|| detector.to_owned(), |defocus| format!("{detector}_defocus_{defocus}A"))
}

/// The name of the noisy image beside one.
pub fn noisy_name(name: &str) -> String {
    format!("{name}_noisy")
}

impl SimulatedImage {
    /// What the counts say of the image: over the electrons of a pixel. `None` where none were counted.
    pub fn noisy(&self, electrons_per_pixel: f64) -> Option<SimulatedImage> {
        let share = |n: &u32| (f64::from(*n) / electrons_per_pixel) as f32;
        let data = self.counts.as_ref()?.map(share);
        let name = noisy_name(&self.name);
        Some(SimulatedImage { name, data, counts: None, noisy: true, ..self.clone() })
    }

    /// Counts electrons, as image number `n`; each image and thickness has draws of its own.
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

/// Images (thickness, y, x) with the margin that the source takes, blurred by it.
pub(super) fn blurred(blur: &SourceBlur, sharp: ArrayView3<f32>) -> Result<Array3<f32>> {
    let images: Vec<_> = sharp.outer_iter().map(|image| blur.image(image)).collect();
    let shape = images.first().map_or((0, 0), |image| image.dim());
    let mut out = Array3::zeros((images.len(), shape.0, shape.1));
    for (mut to, image) in out.outer_iter_mut().zip(&images) {
        to.assign(image);
    }
    Ok(out)
}
