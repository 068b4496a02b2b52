//! Simulated images, and the electrons that are counted in them.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};

use crate::detect::{ShownImage, shown_images};
use crate::engine::{Images, Plan, SourceBlur};
use crate::error::Result;
use crate::imaging::Noise;

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
    /// Counted electrons if the request gives a dose: (thickness, y, x). For a centre of mass all electrons that its detector counts.
    pub counts: Option<Array3<u32>>,
    /// For a centre of mass, the mean angle in mrad of the counted electrons: (thickness, y, x).
    pub counted_mrad: Option<Array3<f32>>,
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
    /// The noisy image: counts divided by the electrons of a pixel, or the mean angle of the counted electrons. `None` if none were
    /// counted.
    pub fn noisy(&self, electrons_per_pixel: f64) -> Option<SimulatedImage> {
        let share = |n: &u32| (f64::from(*n) / electrons_per_pixel) as f32;
        let counts = self.counts.as_ref()?;
        let data = self.counted_mrad.clone().unwrap_or_else(|| counts.map(share));
        let (name, counted_mrad) = (noisy_name(&self.name), None);
        let (counts, noisy) = (None, true);
        Some(SimulatedImage { name, data, counts, counted_mrad, noisy, ..self.clone() })
    }

    /// Counts electrons, as image number `n`. Each image and thickness has its own random numbers.
    pub(super) fn count(&mut self, n: usize, dose: &CountedDose) {
        let of = |(t, sharp): (usize, ArrayView2<f32>)| {
            dose.noise(n, t, self.data.dim()).counted(&sharp.to_owned())
        };
        let counts: Vec<_> = self.data.outer_iter().enumerate().map(of).collect();
        self.counts = Some(stacked(&counts));
    }

    /// Counts the electrons of a centre of mass, of which both images have the number `n`. `measured` are the images
    /// that the engine measured: (thickness, y, x).
    pub(super) fn count_deflected(
        &mut self,
        n: usize,
        shown: &ShownImage,
        measured: &[Array3<f32>],
        dose: &CountedDose,
    ) {
        let (Some(axis), Some(parts)) = (shown.axis, shown.parts()) else { return };
        let [_, deviation] = shown.angles(parts.map(|number| measured[number].view()));
        let (mut counts, mut counted) = (Vec::new(), Vec::new());
        for (t, electrons) in measured[shown.number].outer_iter().enumerate() {
            let noise = dose.noise(n, t, self.data.dim());
            let mut image = self.data.index_axis(Axis(0), t).to_owned();
            let electrons = electrons.to_owned();
            counts.push(noise.counted(&electrons));
            let of_one = deviation.index_axis(Axis(0), t).to_owned();
            noise.deflect(&mut image, 0, (&electrons, &of_one), axis);
            counted.push(image);
        }
        (self.counts, self.counted_mrad) = (Some(stacked(&counts)), Some(stacked(&counted)));
    }
}

/// The dose of a simulation.
pub(super) struct CountedDose {
    /// Seed of the noise.
    pub seed: u64,
    /// Electrons that fall on one pixel.
    pub electrons_per_pixel: f64,
}

impl CountedDose {
    /// The noise of image number `n` at thickness number `t`; images have the shape (thickness, y, x).
    fn noise(
        &self,
        n: usize,
        t: usize,
        (thicknesses, rows, columns): (usize, usize, usize),
    ) -> Noise {
        Noise {
            seed: self.seed,
            electrons_per_pixel: self.electrons_per_pixel,
            origin_px: [(n * thicknesses + t) * rows, 0],
            full_width_px: columns,
            detector: 0,
        }
    }
}

/// Images (y, x), one for each thickness, as one array.
fn stacked<T: Clone + Default>(images: &[Array2<T>]) -> Array3<T> {
    let views: Vec<_> = images.iter().map(|image| image.view()).collect();
    ndarray::stack(Axis(0), &views).unwrap_or_default()
}

/// The image that users see, from the measured images (thickness, y, x).
pub(super) fn shown_image(shown: &ShownImage, measured: &[Array3<f32>]) -> Array3<f32> {
    let Some(parts) = shown.parts() else { return measured[shown.number].clone() };
    let [mean, _] = shown.angles(parts.map(|number| measured[number].view()));
    mean
}

/// The images that users see, of the images that a plan measures.
pub(super) fn shown_of(found: Images, plan: &Plan) -> Images {
    let shown = shown_images(&plan.settings.detectors);
    if shown.iter().all(|shown| shown.axis.is_none()) {
        return found;
    }
    let measured: Vec<_> = found.data.axis_iter(Axis(1)).map(|image| image.to_owned()).collect();
    let images: Vec<_> = shown.iter().map(|shown| shown_image(shown, &measured)).collect();
    let views: Vec<_> = images.iter().map(|image| image.view()).collect();
    let detectors = shown.iter().map(|shown| shown.detector.name.clone()).collect();
    Images { data: ndarray::stack(Axis(1), &views).unwrap_or_default(), detectors, ..found }
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
