//! Rings of equal width in scattering angle, from which any annulus of whole rings can be summed later.

use ndarray::Array2;

use super::MOST_MRAD;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Most rings of a detector.
pub(crate) const MOST_RINGS: usize = 4096;
/// An angle counts as the edge of a ring if it differs by at most this part of the ring's width.
const ON_EDGE: f64 = 1e-6;

/// Rings around the optical axis: ring `i` counts electrons with `i width <= theta < (i + 1) width`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadialBins {
    /// Width of each ring in mrad.
    pub width_mrad: f64,
    /// Number of rings.
    pub rings: usize,
}

impl RadialBins {
    /// The rings of a width up to an angle (mrad).
    ///
    /// # Errors
    /// [`Error::Invalid`] for a width that is not above 0, an angle that is no whole number of widths or above 1570 mrad, and for more
    /// than 4096 rings.
    pub fn new(width_mrad: f64, max_angle_mrad: f64) -> Result<Self> {
        if !(width_mrad > 0.0 && width_mrad <= MOST_MRAD) {
            let expected = "expected a width in mrad above 0, and at most 1570 (a right angle)";
            return Err(Error::invalid(Setting::RingWidthMrad, width_mrad, expected));
        }
        if !(max_angle_mrad > 0.0 && max_angle_mrad <= MOST_MRAD) {
            let expected = "expected an angle in mrad above 0, and at most 1570 (a right angle)";
            return Err(Error::invalid(Setting::MaxAngleMrad, max_angle_mrad, expected));
        }
        let rings = max_angle_mrad / width_mrad;
        if (rings - rings.round()).abs() > ON_EDGE || rings.round() < 1.0 {
            let whole = rings.round().max(1.0) * width_mrad;
            let expected = format!(
                "is not a multiple of the ring width, {width_mrad} mrad; the nearest multiple is {whole} mrad"
            );
            return Err(Error::invalid(Setting::MaxAngleMrad, max_angle_mrad, expected));
        }
        if rings.round() > MOST_RINGS as f64 {
            let expected = format!("makes more than {MOST_RINGS} rings; use wider rings");
            return Err(Error::invalid(Setting::RingWidthMrad, width_mrad, expected));
        }
        Ok(RadialBins { width_mrad, rings: rings.round() as usize })
    }

    /// The outer angle of the last ring in mrad.
    pub fn max_angle_mrad(&self) -> f64 {
        self.edge_mrad(self.rings)
    }

    /// The inner angle of ring `i` in mrad.
    pub(crate) fn edge_mrad(&self, i: usize) -> f64 {
        i as f64 * self.width_mrad
    }

    /// Calls `put` with each ring that contains a part of a diffraction pattern's pixel at `theta_mrad`, and with the pixel's share on it.
    /// Edges are `ramp_mrad` wide, like the edges of [`Detector`](super::Detector)s; with 0 a pixel lies on one ring. The shares on the
    /// rings of an annulus add to the share on the annulus.
    pub(crate) fn shares(&self, theta_mrad: f64, ramp_mrad: f64, mut put: impl FnMut(usize, f64)) {
        let below = |theta: f64| (theta / self.width_mrad).max(0.0) as usize;
        if ramp_mrad <= 0.0 {
            let mut ring = below(theta_mrad);
            // The quotient is rounded, so the edges decide.
            while ring > 0 && theta_mrad < self.edge_mrad(ring) {
                ring -= 1;
            }
            while theta_mrad >= self.edge_mrad(ring + 1) {
                ring += 1;
            }
            if ring < self.rings {
                put(ring, 1.0);
            }
            return;
        }
        let beyond = |edge: usize| match edge {
            0 => 1.0,
            _ => ((theta_mrad - self.edge_mrad(edge)) / ramp_mrad + 0.5).clamp(0.0, 1.0),
        };
        let last = below(theta_mrad + 0.5 * ramp_mrad).min(self.rings - 1);
        for ring in below(theta_mrad - 0.5 * ramp_mrad)..=last {
            let share = beyond(ring) - beyond(ring + 1);
            if share > 0.0 {
                put(ring, share);
            }
        }
    }

    /// The weights of the rings, `[0, ring]`, that make an annulus (mrad).
    ///
    /// # Errors
    /// [`Error::Invalid`] for an annulus whose edges are not edges of rings, and for one beyond the last ring.
    pub(crate) fn weights(&self, name: &str, annulus_mrad: [f64; 2]) -> Result<Array2<f32>> {
        let [inner, outer] = annulus_mrad;
        let bad = |expected: String| {
            Err(Error::invalid(Setting::Detector, format!("{name}={inner}-{outer}"), expected))
        };
        if !(inner >= 0.0 && outer > inner) {
            return bad(
                "the outer angle must exceed the inner, which must not be negative".to_owned()
            );
        }
        let [from, to] = annulus_mrad.map(|angle| angle / self.width_mrad);
        let most = self.max_angle_mrad();
        if to > self.rings as f64 + ON_EDGE {
            return bad(format!(
                "the rings reach to {most:.1} mrad; simulate them with a larger `max_angle_mrad`"
            ));
        }
        let off = |edge: f64| (edge - edge.round()).abs() > ON_EDGE;
        if off(from) || off(to) || from.round() >= to.round() {
            let near = [from.floor(), to.ceil()].map(|edge| edge * self.width_mrad);
            return bad(format!(
                "begins or ends inside a ring; the rings are {} mrad wide, and {}-{} mrad consists of whole rings",
                self.width_mrad, near[0], near[1]
            ));
        }
        let within = from.round() as usize..to.round() as usize;
        let weight = |(_, ring)| f32::from(u8::from(within.contains(&ring)));
        Ok(Array2::from_shape_fn((1, self.rings), weight))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Detector;
    use super::*;

    /// Rings contain the intensity of detectors between their edges, for any ramp.
    #[test]
    fn shares_of_rings_add_to_those_of_annuli() {
        for (width, inner, outer) in [(1.0, 68.0, 200.0), (0.1, 4.3, 21.0), (2.5, 0.0, 40.0)] {
            let bins = RadialBins::new(width, 250.0).unwrap();
            let annulus = Detector::new("A", inner, outer);
            let weights = bins.weights("A", [inner, outer]).unwrap();
            for ramp in [0.0, 0.4, 1.6, 3.2] {
                for n in 0..2501 {
                    let theta = 0.1 * f64::from(n);
                    let (mut sum, mut all) = (0.0, 0.0);
                    bins.shares(theta, ramp, |ring, share| {
                        sum += share * f64::from(weights[[0, ring]]);
                        all += share;
                    });
                    assert!((sum - annulus.share_on(theta, ramp)).abs() < 1e-9, "{theta} {ramp}");
                    assert!(theta > 248.0 || (all - 1.0).abs() < 1e-9, "{theta} {ramp}: {all}");
                }
            }
        }
    }

    #[test]
    fn annuli_of_parts_of_rings_are_refused_with_the_next() {
        let bins = RadialBins::new(2.0, 100.0).unwrap();
        let refused = |annulus| bins.weights("A", annulus).unwrap_err().to_string();
        assert!(
            refused([67.0, 90.0]).contains("66-90 mrad consists of whole rings"),
            "{}",
            refused([67.0, 90.0])
        );
        assert!(refused([68.0, 200.0]).contains("reach to 100.0 mrad"));
        assert!(refused([40.0, 40.0]).contains("must exceed"));
        assert!(bins.weights("A", [f64::NAN, 40.0]).is_err());
        assert_eq!(bins.weights("A", [68.0, 90.0]).unwrap().sum(), 11.0);
        let width = |width, most| RadialBins::new(width, most).unwrap_err().to_string();
        assert!(width(0.0, 100.0).contains("above 0") && width(f64::NAN, 1.0).contains("above 0"));
        assert!(width(3.0, 100.0).contains("multiple is 99 mrad"), "{}", width(3.0, 100.0));
        assert!(width(0.01, 100.0).contains("4096"));
        assert!(width(1.0, f64::INFINITY).contains("1570"));
    }
}
