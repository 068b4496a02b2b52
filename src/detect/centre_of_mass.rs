//! The centre of mass as a detector: two images of the mean angle of the electrons that it counts.
//!
//! Engines add intensities times weights from 0 to 1. So a centre of mass is measured as five weighted intensities, of which the images are
//! made at the end: `<k> = R (2 S / E - 1)` with the electrons E, the share `S = sum (1 + k / R) / 2` and a reach R that no angle on the
//! detector exceeds. The squares `Q = sum (k / R)^2` give the scatter of one electron, `R^2 Q / E - <k>^2`, and so the noise of a dose.

use ndarray::{Array, Array2, ArrayView, Dimension, Zip};
use serde::{Deserialize, Serialize};

use super::Detector;

/// The reach R of the weights in outer angles. Pixels on the soft edge of a detector lie beyond its outer angle.
const REACH: f64 = 2.0;
/// Names of the two images, after that of the detector.
const AXES: [&str; 2] = ["x", "y"];

/// The part of a centre of mass that a [`Detector`] is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CentreOfMass {
    /// Two images, of x and of y: the form in which users ask for it.
    Images,
    /// The image of the mean angle along x in mrad.
    X,
    /// The image of the mean angle along y in mrad.
    Y,
    /// Measured by engines: all electrons.
    Electrons,
    /// Measured by engines: electrons weighted by `(1 + k.u / R) / 2`, with the direction u (x, y).
    Share([f64; 2]),
    /// Measured by engines: electrons weighted by `(k.u / R)^2`.
    Square([f64; 2]),
}

impl CentreOfMass {
    /// The weight of an electron at an angle (x, y) in mrad.
    pub(super) fn weight(self, [x, y]: [f64; 2], outer_mrad: f64) -> f64 {
        let along = |[u, v]: [f64; 2]| (x * u + y * v) / (REACH * outer_mrad);
        match self {
            CentreOfMass::Share(u) => 0.5 * (1.0 + along(u)),
            CentreOfMass::Square(u) => along(u).powi(2),
            _ => 1.0,
        }
    }

    /// The mean weight of electrons at an angle in mrad, over all azimuths.
    pub(super) fn mean_weight(self, theta_mrad: f64, outer_mrad: f64) -> f64 {
        match self {
            CentreOfMass::Share(_) => 0.5,
            CentreOfMass::Square(_) => 0.5 * (theta_mrad / (REACH * outer_mrad)).powi(2),
            _ => 1.0,
        }
    }

    /// Whether the mean weight depends on the angle.
    pub(super) fn varies(self) -> bool {
        matches!(self, CentreOfMass::Square(_))
    }

    /// Whether engines measure it.
    pub(super) fn is_measured(self) -> bool {
        !matches!(self, CentreOfMass::Images | CentreOfMass::X | CentreOfMass::Y)
    }

    /// The part as seen from a frame, whose rows rotate directions of the frame into directions of this part.
    pub(super) fn seen_from(self, [[a, b], [c, d]]: [[f64; 2]; 2]) -> Self {
        let turned = |[x, y]: [f64; 2]| [a * x + c * y, b * x + d * y];
        match self {
            CentreOfMass::Share(u) => CentreOfMass::Share(turned(u)),
            CentreOfMass::Square(u) => CentreOfMass::Square(turned(u)),
            other => other,
        }
    }
}

impl Detector {
    /// Unit of images of electrons.
    pub(crate) const FRACTION_OF_BEAM: &str = "fraction of the incident beam";

    /// Makes an annulus (usually a disk) that gives the images `NAME_x` and `NAME_y` of the centre of mass.
    #[must_use]
    pub fn with_centre_of_mass(self) -> Self {
        Detector { centre_of_mass: Some(CentreOfMass::Images), ..self }
    }

    /// Whether values are angles in mrad, not electrons.
    pub fn is_deflection(&self) -> bool {
        matches!(self.centre_of_mass, Some(CentreOfMass::X | CentreOfMass::Y))
    }

    /// Unit of the values of an image.
    pub fn units(&self) -> &'static str {
        if self.is_deflection() { "mrad" } else { Self::FRACTION_OF_BEAM }
    }

    /// The detectors as users see them, each with an image: of a centre of mass two.
    pub fn images(&self) -> Vec<Detector> {
        if self.centre_of_mass != Some(CentreOfMass::Images) {
            return vec![self.clone()];
        }
        let axis = |(name, part)| self.part(&format!("_{name}"), part);
        AXES.into_iter().zip([CentreOfMass::X, CentreOfMass::Y]).map(axis).collect()
    }

    /// The detectors that engines measure: of a centre of mass five.
    pub fn measured(&self) -> Vec<Detector> {
        if self.centre_of_mass != Some(CentreOfMass::Images) {
            return vec![self.clone()];
        }
        let axes = [[1.0, 0.0], [0.0, 1.0]];
        let [x, y] = axes.map(CentreOfMass::Share);
        let [xx, yy] = axes.map(CentreOfMass::Square);
        let parts = [("", CentreOfMass::Electrons), (".x", x), (".y", y), (".xx", xx), (".yy", yy)];
        parts.into_iter().map(|(name, part)| self.part(name, part)).collect()
    }

    fn part(&self, name: &str, part: CentreOfMass) -> Self {
        let name = format!("{}{name}", self.name);
        Detector { name, centre_of_mass: Some(part), ..self.clone() }
    }
}

/// An image that users see, and the measured images that it is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct ShownImage {
    /// The detector as users see it.
    pub detector: Detector,
    /// Number of the measured detector; of a centre of mass that of its electrons.
    pub number: usize,
    /// The axis (0: x, 1: y) of a centre of mass.
    pub axis: Option<usize>,
}

/// The images that users see of the detectors that an engine measures.
pub fn shown_images(measured: &[Detector]) -> Vec<ShownImage> {
    let shown = |(number, detector): (usize, &Detector)| match detector.centre_of_mass {
        None => vec![ShownImage { detector: detector.clone(), number, axis: None }],
        Some(CentreOfMass::Electrons) => {
            let images = detector.clone().with_centre_of_mass().images().into_iter().enumerate();
            images.map(|(k, detector)| ShownImage { detector, number, axis: Some(k) }).collect()
        }
        Some(_) => Vec::new(),
    };
    measured.iter().enumerate().flat_map(shown).collect()
}

impl ShownImage {
    /// The numbers of the measured images of a centre of mass: electrons, share and square. `None` for an image that is measured itself.
    pub fn parts(&self) -> Option<[usize; 3]> {
        self.axis.map(|k| [self.number, self.number + 1 + k, self.number + 3 + k])
    }

    /// The image that users see, from the images that are measured.
    pub(crate) fn image_of(&self, measured: &[Array2<f32>]) -> Array2<f32> {
        match self.parts() {
            None => measured[self.number].clone(),
            Some(parts) => {
                let [mean, _] = self.angles(parts.map(|number| measured[number].view()));
                mean
            }
        }
    }

    fn reach_mrad(&self) -> f64 {
        REACH * self.detector.outer_mrad
    }

    /// The mean angle of a pixel in mrad, from the electrons and the share of a pixel; 0 without electrons.
    fn mean_mrad(&self, electrons: f64, share: f64) -> f64 {
        match electrons > 0.0 {
            true => {
                let most = self.detector.outer_mrad;
                (self.reach_mrad() * (2.0 * share / electrons - 1.0)).clamp(-most, most)
            }
            false => 0.0,
        }
    }

    /// The mean angle and the standard deviation of one electron in mrad, from electrons, share and square of a pixel.
    pub(crate) fn angle_of(&self, parts: [f64; 3]) -> [f64; 2] {
        [self.mean_mrad(parts[0], parts[1]), self.deviation_mrad(parts)]
    }

    /// The images of the mean angle and of the standard deviation of one electron, in mrad, from the images of electrons, share and square.
    pub fn angles<A: Copy + Into<f64>, D: Dimension>(
        &self,
        parts: [ArrayView<'_, A, D>; 3],
    ) -> [Array<f32, D>; 2] {
        let [electrons, share, square] = &parts;
        let [mut mean, mut deviation] = [(); 2].map(|()| Array::zeros(electrons.raw_dim()));
        Zip::from(&mut mean).and(&mut deviation).and(electrons).and(share).and(square).for_each(
            |mean, deviation, &e, &s, &q| {
                [*mean, *deviation] =
                    self.angle_of([e.into(), s.into(), q.into()]).map(|v| v as f32);
            },
        );
        [mean, deviation]
    }

    /// The standard deviation of the angle of one electron in mrad.
    fn deviation_mrad(&self, [electrons, share, square]: [f64; 3]) -> f64 {
        if electrons <= 0.0 {
            return 0.0;
        }
        let mean = self.mean_mrad(electrons, share);
        let variance = self.reach_mrad().powi(2) * square / electrons - mean * mean;
        variance.max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::{DetectorMap, Pattern};
    use num_complex::Complex32;

    /// Mean and standard deviation of the angles of a pattern, also where it is seen from a turned frame.
    #[test]
    fn images_are_the_mean_angles_of_a_pattern() {
        let detector = Detector::new("COM", 0.0, 30.0).with_centre_of_mass();
        let measured = detector.measured();
        let shown = shown_images(&measured);
        let names: Vec<&str> = shown.iter().map(|s| s.detector.name.as_str()).collect();
        assert_eq!((names, measured.len()), (vec!["COM_x", "COM_y"], 5));
        assert_eq!(detector.images(), [&shown[0], &shown[1]].map(|s| s.detector.clone()));
        let pattern = Pattern {
            shape: (64, 64),
            stride: 64,
            limit_mrad: 1e9,
            ramp_mrad: 0.0,
            pixel_mrad: [1.0; 2],
        };
        let angles = |iy: usize, ix: usize| [ix, iy].map(|n| n as f64 - 32.0);
        let psi: Vec<Complex32> = (0..64 * 64)
            .map(|n| {
                let [x, y] = angles(n / 64, n % 64);
                let v = (-((x - 5.0).powi(2) + 2.0 * (y + 3.0).powi(2)) / 200.0).exp();
                Complex32::new(v as f32, 0.0)
            })
            .collect();
        let mut sums = [0.0_f64; 5];
        for (n, v) in psi.iter().enumerate() {
            let [x, y] = angles(n / 64, n % 64);
            if x.hypot(y) < 30.0 {
                let p = f64::from(v.norm_sqr());
                [p, p * x, p * y, p * x * x, p * y * y]
                    .iter()
                    .zip(&mut sums)
                    .for_each(|(v, sum)| *sum += v);
            }
        }
        let found = |measured: &[Detector], k: usize| {
            let map = DetectorMap::new(measured, pattern, angles, |_, _| 1.0);
            let mut values = [0.0; 5];
            map.collect(&psi, 1.0, &mut values);
            let parts = shown[k].parts().unwrap().map(|n| values[n]);
            [shown[k].mean_mrad(parts[0], parts[1]), shown[k].deviation_mrad(parts)]
        };
        let [mx, my] = [1, 2].map(|k| sums[k] / sums[0]);
        for (k, mean) in [(0, mx), (1, my)] {
            let deviation = (sums[3 + k] / sums[0] - mean * mean).sqrt();
            let [a, b] = found(&measured, k);
            assert!((a - mean).abs() < 1e-4 && (b - deviation).abs() < 1e-4, "{a} {b}");
        }
        // The axes of a frame that is turned by 90 degrees.
        let frame = [[0.0, -1.0], [1.0, 0.0]];
        let turned: Vec<Detector> = measured.iter().map(|d| d.seen_from(frame)).collect();
        assert!((found(&turned, 0)[0] + my).abs() < 1e-4, "{my}");
        assert!((found(&turned, 1)[0] - mx).abs() < 1e-4, "{mx}");
        let straight = [[1.0, 0.0], [0.0, 1.0]];
        assert!(measured.iter().all(|d| d.seen_from(straight) == *d));
        assert_eq!(shown[0].mean_mrad(0.0, 0.0), 0.0);
    }
}
