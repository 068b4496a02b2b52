//! Coincidence angles of symmetric tilt boundaries about the beam, for lattices that are square or hexagonal across it.
//!
//! The boundary lies along a lattice vector, which half the misorientation rotates onto y. On a square lattice that is (k, h) with
//! tan(theta / 2) = k / h, where h and k have no common divisor, and Sigma = h^2 + k^2, or half of that if both are odd. On a hexagonal
//! lattice, in a centred box of edges a and sqrt(3) a, Sigma = h^2 + 3 k^2 or 3 h^2 + k^2 without their factors of 4 and 3 (S. Ranganathan,
//! Acta Cryst. 21 (1966) 197).

use super::lattice::gcd;

/// Largest h that is searched.
const MAX_INDEX: u32 = 60;
/// Largest difference of a stated angle from the coincidence angle, in degrees.
const TOLERANCE_DEG: f64 = 0.05;
/// Relative difference of lengths that count as equal.
const SAME_LENGTH: f64 = 1e-4;

/// A lattice in projection along the beam, described by its rectangular cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PlaneLattice {
    /// a x a.
    Square,
    /// a x sqrt(3) a, centred.
    HexagonalAlongX,
    /// sqrt(3) a x a, centred.
    HexagonalAlongY,
}

impl PlaneLattice {
    /// Returns the lattice of a crystal's cell, whose edges are in Angstrom.
    ///
    /// # Errors
    /// A sentence for other lattices.
    pub(crate) fn of([a, b, _]: [f64; 3]) -> Result<Self, String> {
        let ratio = |expected: f64| (b / a / expected - 1.0).abs() < SAME_LENGTH;
        let root = 3f64.sqrt();
        let known = [
            (1.0, PlaneLattice::Square),
            (root, PlaneLattice::HexagonalAlongX),
            (1.0 / root, PlaneLattice::HexagonalAlongY),
        ];
        let found = known.into_iter().find(|(expected, _)| ratio(*expected));
        found.map(|(_, lattice)| lattice).ok_or_else(|| {
            format!(
                "coincidence boundaries need a lattice that is square or hexagonal across the beam, not {a:.3} x {b:.3} A; leave sigma out"
            )
        })
    }

    /// Returns twice the lattice vector (k, h) in units of the cell's first edge if the lattice is centred; else the vector itself.
    fn vector(self, [k, h]: [f64; 2]) -> [f64; 2] {
        match self {
            PlaneLattice::Square => [k, h],
            PlaneLattice::HexagonalAlongX => [k, 3f64.sqrt() * h],
            PlaneLattice::HexagonalAlongY => [k, h / 3f64.sqrt()],
        }
    }

    /// Returns the area of the primitive cell in units of the square of the cell's first edge.
    fn area(self) -> f64 {
        match self {
            PlaneLattice::Square => 1.0,
            PlaneLattice::HexagonalAlongX => 0.5 * 3f64.sqrt(),
            PlaneLattice::HexagonalAlongY => 0.5 / 3f64.sqrt(),
        }
    }

    /// Returns the greatest half angle in degrees before the angles repeat.
    fn most_half_deg(self) -> f64 {
        if self == PlaneLattice::Square { 45.0 } else { 30.0 }
    }
}

/// Half of an exact coincidence angle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HalfAngle {
    /// The lattice.
    pub lattice: PlaneLattice,
    /// Index of the boundary's direction along the second edge of the cell.
    pub h: u32,
    /// Index of the boundary's direction along the first edge.
    pub k: u32,
}

impl HalfAngle {
    /// Returns half the misorientation in radians.
    pub(crate) fn radians(self) -> f64 {
        let [across, along] = self.vector();
        libm::atan2(across, along)
    }
    /// Returns the distance between neighbouring lattice lines parallel to the boundary, in units of the cell's first edge.
    pub(crate) fn line_spacing(self) -> f64 {
        self.lattice.area() / self.period()
    }
    /// Returns the period along the boundary, in units of the cell's first edge.
    pub(crate) fn period(self) -> f64 {
        let [across, along] = self.vector();
        let centred = self.lattice != PlaneLattice::Square && self.h % 2 == self.k % 2;
        (across * across + along * along).sqrt() * if centred { 0.5 } else { 1.0 }
    }
    fn vector(self) -> [f64; 2] {
        self.lattice.vector([self.k, self.h].map(f64::from))
    }
    fn degrees(self) -> f64 {
        2.0 * self.radians().to_degrees()
    }
    /// Returns the coincidence index; `None` if the angle has no index of its own.
    fn index(self) -> Option<u32> {
        let HalfAngle { h, k, .. } = self;
        if gcd(h, k) != 1 || self.degrees() > 2.0 * self.lattice.most_half_deg() - 1e-9 {
            return None;
        }
        let mut sum = match self.lattice {
            PlaneLattice::Square => {
                let sum = h * h + k * k;
                return Some(if h % 2 == 1 && k % 2 == 1 { sum / 2 } else { sum });
            }
            PlaneLattice::HexagonalAlongX => 3 * h * h + k * k,
            PlaneLattice::HexagonalAlongY => h * h + 3 * k * k,
        };
        for factor in [4, 3] {
            while sum % factor == 0 {
                sum /= factor;
            }
        }
        Some(sum)
    }
}

/// Finds the [`half_angle`] of the lattice of a crystal's cell, whose edges are in Angstrom.
///
/// # Errors
/// As [`PlaneLattice::of`] and [`half_angle`].
pub(crate) fn half_angle_in(cell: [f64; 3], sigma: u32, degrees: f64) -> Result<HalfAngle, String> {
    half_angle(PlaneLattice::of(cell)?, sigma, degrees)
}

/// Finds the boundary of coincidence index `sigma` whose misorientation is `degrees`.
///
/// # Errors
/// A sentence with the angles of this `sigma`.
pub(crate) fn half_angle(
    lattice: PlaneLattice,
    sigma: u32,
    degrees: f64,
) -> Result<HalfAngle, String> {
    let of_sigma: Vec<HalfAngle> = (1..=MAX_INDEX)
        .flat_map(|h| (1..=h).map(move |k| HalfAngle { lattice, h, k }))
        .filter(|p| p.index() == Some(sigma))
        .collect();
    let fits = |p: &&HalfAngle| (p.degrees() - degrees).abs() < TOLERANCE_DEG;
    of_sigma.iter().find(fits).copied().ok_or_else(|| {
        let mut angles: Vec<String> =
            of_sigma.iter().map(|p| format!("{:.2}", p.degrees())).collect();
        angles.dedup();
        match angles.is_empty() {
            true => format!(
                "no coincidence boundary about the beam has this index (h up to {MAX_INDEX})"
            ),
            false => format!(
                "misorientation_deg = {degrees} is not an angle of this sigma; expected {}, or leave sigma out",
                angles.join(" or ")
            ),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_boundaries() {
        let lattice = PlaneLattice::Square;
        let cases = [(5, 36.87, (3, 1)), (13, 22.62, (5, 1)), (85, 8.80, (13, 1))];
        for (sigma, degrees, (h, k)) in cases {
            assert_eq!(half_angle(lattice, sigma, degrees), Ok(HalfAngle { lattice, h, k }));
        }
        assert_eq!(half_angle(lattice, 5, 53.13), Ok(HalfAngle { lattice, h: 2, k: 1 }));
    }

    /// Angles of graphene's boundaries (O. V. Yazyev and S. G. Louie, Phys. Rev. B 81 (2010) 195420: 21.8 and 32.2 degrees). Their periods
    /// are the lengths of the lattice vectors (2, 1) and (3, 2): sqrt(7) a and sqrt(13) a.
    #[test]
    fn hexagonal_lattices_have_their_own() {
        let root = 3f64.sqrt();
        for lattice in [PlaneLattice::HexagonalAlongX, PlaneLattice::HexagonalAlongY] {
            let edge = if lattice == PlaneLattice::HexagonalAlongX { 1.0 } else { root };
            for (sigma, degrees) in [(7u32, 21.787), (13, 32.204), (7, 38.213), (13, 27.796)] {
                let found = half_angle(lattice, sigma, degrees).unwrap();
                assert!((found.degrees() - degrees).abs() < 1e-3, "{found:?}");
                let period = found.period() * edge;
                // The boundary lies along a lattice vector, so the square of its period is a whole number of a^2.
                let square = period * period;
                assert!((square - square.round()).abs() < 1e-9, "{sigma} {degrees}: {square}");
                let lines = found.line_spacing() * edge * period;
                assert!((lines - 0.5 * root).abs() < 1e-12);
            }
        }
        let found = half_angle(PlaneLattice::HexagonalAlongX, 7, 21.787).unwrap();
        assert!((found.period() - 7f64.sqrt()).abs() < 1e-12, "{found:?}");
        assert_eq!(PlaneLattice::of([3.16, 3.16 * root, 6.0]), Ok(PlaneLattice::HexagonalAlongX));
        assert!(PlaneLattice::of([3.0, 4.0, 5.0]).unwrap_err().contains("3.000 x 4.000"));
    }

    #[test]
    fn a_wrong_angle_is_refused_with_the_right_ones() {
        let message = half_angle(PlaneLattice::Square, 5, 30.0).unwrap_err();
        assert!(message.contains("36.87") && message.contains("53.13"), "{message}");
    }
}
