//! Images of the patch around a column, in each phonon configuration.

use ndarray::Array2;

use crate::engine::{Plan, Scan, Simulation, Site, SourceBlur};
use crate::error::Result;
use crate::progress::{Progress, ProgressShare};

/// The probes of a patch: the points of a square raster within a circle.
#[derive(Debug, Clone)]
pub struct ColumnPatch {
    /// The raster around the circle.
    scan: Scan,
    /// Indices in the raster of the points within the circle.
    inside: Vec<usize>,
    /// The raster with the margin of the source; `None` for a point source.
    blur: Option<SourceBlur>,
}

impl ColumnPatch {
    /// The points of a raster of `step` around `centre`, which is one of them, within `radius` (Angstrom).
    pub fn new(centre: [f64; 2], radius: f64, step: f64) -> Self {
        let reach = (radius / step).floor() as usize;
        let side = 2 * reach + 1;
        let off = |n: usize| (n as f64 - reach as f64) * step;
        let within = |index: &usize| off(index / side).hypot(off(index % side)) <= radius;
        let origin_angstrom = centre.map(|x| x - reach as f64 * step);
        ColumnPatch {
            scan: Scan { origin_angstrom, step_angstrom: [step; 2], shape: [side; 2] },
            inside: (0..side * side).filter(within).collect(),
            blur: None,
        }
    }

    /// The patch for a source of finite size in a box (x, y) in Angstrom.
    ///
    /// # Errors
    /// Errors of [`SourceBlur::new`].
    pub fn blurred(self, source: Option<crate::engine::Source>, size: [f64; 2]) -> Result<Self> {
        let blur = source.map(|source| SourceBlur::new(source, &self.scan, size)).transpose()?;
        Ok(ColumnPatch { blur, ..self })
    }

    /// Area of a pixel in square Angstrom.
    pub fn area_angstrom2(&self) -> f64 {
        self.scan.step_angstrom[0] * self.scan.step_angstrom[1]
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.inside.len()
    }

    /// The raster of the propagated probes.
    pub fn raster(&self) -> &Scan {
        self.blur.as_ref().map_or(&self.scan, |blur| blur.scan())
    }

    /// Indices in the raster of the propagated probes.
    pub fn probes(&self) -> Vec<usize> {
        match &self.blur {
            Some(blur) => (0..blur.scan().len()).collect(),
            None => self.inside.clone(),
        }
    }

    /// Simulates the patch in the first `configurations`. Returns (configuration, pixel) in fractions of the beam for each detector.
    ///
    /// # Errors
    /// Errors of [`Simulation::some_probes`].
    pub fn images(
        &self,
        (simulation, plan): (&mut Simulation<'_>, &Plan),
        sites: &[Site],
        configurations: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let detectors = plan.settings.detectors.len();
        let mut images = vec![Array2::zeros((configurations as usize, self.len())); detectors];
        let probes = self.probes();
        for configuration in 0..configurations {
            let share = ProgressShare::new(progress, probes.len());
            let values =
                simulation.some_probes(sites, self.raster(), &probes, configuration, &share)?;
            share.complete();
            for (detector, image) in images.iter_mut().enumerate() {
                let of_detector = values.iter().skip(detector).step_by(detectors).copied();
                let pixels = self.pixels(of_detector.collect());
                image
                    .row_mut(configuration as usize)
                    .iter_mut()
                    .zip(pixels)
                    .for_each(|(p, v)| *p = v);
            }
        }
        Ok(images)
    }

    /// The pixels of the patch from the values of the propagated probes.
    fn pixels(&self, values: Vec<f64>) -> Vec<f64> {
        let Some(blur) = &self.blur else { return values };
        let shape = (blur.scan().shape[0], blur.scan().shape[1]);
        match Array2::from_shape_vec(shape, values) {
            Ok(sharp) => {
                let image = blur.blurred(sharp);
                let side = self.scan.shape[1];
                self.inside.iter().map(|index| image[[index / side, index % side]]).collect()
            }
            Err(_) => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_are_discs_around_their_centre() {
        let patch = ColumnPatch::new([5.0, 7.0], 1.2, 0.15);
        let area = patch.len() as f64 * patch.area_angstrom2();
        assert!((area / (std::f64::consts::PI * 1.44) - 1.0).abs() < 0.05, "{area}");
        let places: Vec<_> = patch.inside.iter().map(|i| patch.scan.position(*i)).collect();
        assert!(places.iter().any(|p| (p[0] - 5.0).hypot(p[1] - 7.0) < 1e-9));
        assert!(places.iter().all(|p| (p[0] - 5.0).hypot(p[1] - 7.0) <= 1.2 + 1e-9));
        assert_eq!(ColumnPatch::new([0.0; 2], 0.2, 0.5).len(), 1);
    }
}
