//! Coincidence angles of symmetric tilt boundaries about \[001\] of a cubic crystal.
//!
//! For the boundary plane (h k 0), tan(theta / 2) = k / h and, h and k having no common divisor,
//! Sigma = h^2 + k^2, or half of that when both are odd.

use super::lattice::gcd;

/// Largest h that is searched.
const MAX_INDEX: u32 = 60;
/// How far a stated angle may be from the coincidence angle, in degrees.
const TOLERANCE_DEG: f64 = 0.05;

/// An exact half angle: tan = k / h.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HalfAngle {
    /// Boundary plane (h k 0).
    pub h: u32,
    /// Boundary plane (h k 0).
    pub k: u32,
}

impl HalfAngle {
    /// Half the misorientation in radians.
    pub fn radians(self) -> f64 {
        libm::atan2(f64::from(self.k), f64::from(self.h))
    }
    /// Distance between neighbouring lattice lines parallel to the boundary, in units of a.
    pub fn line_spacing(self) -> f64 {
        1.0 / self.period()
    }
    /// Period along the boundary, in units of a.
    pub fn period(self) -> f64 {
        f64::from(self.h * self.h + self.k * self.k).sqrt()
    }
    fn degrees(self) -> f64 {
        2.0 * self.radians().to_degrees()
    }
}

/// The boundary of coincidence index `sigma` whose misorientation is `degrees`.
///
/// # Errors
/// A sentence that names the angles which `sigma` has.
pub fn half_angle(sigma: u32, degrees: f64) -> Result<HalfAngle, String> {
    let of_sigma: Vec<HalfAngle> = (1..=MAX_INDEX)
        .flat_map(|h| (1..=h).map(move |k| HalfAngle { h, k }))
        .filter(|p| index(*p) == Some(sigma))
        .collect();
    let fits = |p: &&HalfAngle| (p.degrees() - degrees).abs() < TOLERANCE_DEG;
    of_sigma.iter().find(fits).copied().ok_or_else(|| {
        let angles: Vec<String> = of_sigma.iter().map(|p| format!("{:.2}", p.degrees())).collect();
        match angles.is_empty() {
            true => format!("no [001] coincidence boundary has this index (h up to {MAX_INDEX})"),
            false => format!(
                "misorientation_deg = {degrees} is not an angle of it; expected {}, or no sigma",
                angles.join(" or ")
            ),
        }
    })
}

fn index(plane: HalfAngle) -> Option<u32> {
    let HalfAngle { h, k } = plane;
    let sum = h * h + k * k;
    (gcd(h, k) == 1 && h != k).then_some(if h % 2 == 1 && k % 2 == 1 { sum / 2 } else { sum })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_boundaries() {
        let cases = [(5, 36.87, (3, 1)), (13, 22.62, (5, 1)), (85, 8.80, (13, 1))];
        for (sigma, degrees, (h, k)) in cases {
            assert_eq!(half_angle(sigma, degrees), Ok(HalfAngle { h, k }));
        }
        assert_eq!(half_angle(5, 53.13), Ok(HalfAngle { h: 2, k: 1 }));
    }

    #[test]
    fn a_wrong_angle_is_told_the_right_ones() {
        let message = half_angle(5, 30.0).unwrap_err();
        assert!(message.contains("36.87") && message.contains("53.13"), "{message}");
    }
}
