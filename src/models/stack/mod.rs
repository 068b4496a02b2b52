//! Specimens made of several crystals: how lattices fit, where atomic planes lie, faults, dislocations and amorphous layers. Lengths are in
//! Angstrom.
//!
//! [`lattice_fit`] strains a lattice to fit another; [`atomic_planes`] finds the planes of a crystal, and [`layer_places`] stacks them;
//! [`fault_planes`] mirrors and shifts crystals; [`edge_dislocation`] displaces atoms; [`random_packing`] packs amorphous layers;
//! [`least_distances`] removes atoms that overlap.

pub mod atomic_planes;
pub mod edge_dislocation;
pub mod fault_planes;
pub mod lattice_fit;
pub mod layer_places;
pub mod least_distances;
pub mod random_packing;

use crate::structure::lattice::{Vec3, dot};

/// A rotation or reflection with a shift: `r -> r M + t`, lengths in Angstrom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Isometry {
    /// The orthogonal matrix M, row by row.
    pub linear: [Vec3; 3],
    /// The shift t.
    pub shift: Vec3,
}

impl Isometry {
    /// Leaves every point where it is.
    pub const IDENTITY: Self =
        Isometry { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], shift: [0.0; 3] };

    /// Shifts every point by `by`.
    pub fn translation(by: Vec3) -> Self {
        Isometry { shift: by, ..Self::IDENTITY }
    }

    /// Turns every point from +x to +y about the line along z through `centre` (x, y); the angle is in radian.
    pub fn about_beam(angle: f64, [x, y]: [f64; 2]) -> Self {
        let (sin, cos) = libm::sincos(angle);
        let linear = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let turned = Isometry { linear, shift: [0.0; 3] }.apply([x, y, 0.0]);
        Isometry { linear, shift: [x - turned[0], y - turned[1], 0.0] }
    }

    /// Mirrors every point at the plane of points r with r . `normal` = `distance`; the normal has unit length.
    pub fn reflection(normal: Vec3, distance: f64) -> Self {
        let row = |i: usize| {
            std::array::from_fn(|j| f64::from(u8::from(i == j)) - 2.0 * normal[i] * normal[j])
        };
        Isometry { linear: [row(0), row(1), row(2)], shift: normal.map(|n| 2.0 * distance * n) }
    }

    /// Returns the image of a point.
    pub fn apply(&self, r: Vec3) -> Vec3 {
        let m = &self.linear;
        std::array::from_fn(|j| r[0] * m[0][j] + r[1] * m[1][j] + r[2] * m[2][j] + self.shift[j])
    }

    /// Returns the point whose image is `r`.
    pub fn undo(&self, r: Vec3) -> Vec3 {
        let moved: Vec3 = std::array::from_fn(|k| r[k] - self.shift[k]);
        self.linear.map(|row| dot(row, moved))
    }

    /// Returns the isometry that applies `first` and then this one.
    pub fn after(&self, first: &Isometry) -> Isometry {
        let without_shift = Isometry { shift: [0.0; 3], ..*self };
        Isometry {
            linear: first.linear.map(|row| without_shift.apply(row)),
            shift: self.apply(first.shift),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_is_its_own_inverse_and_shifts_follow_it() {
        let unit = [0.6, 0.0, 0.8];
        let mirror = Isometry::reflection(unit, 2.0);
        let r = [1.0, -2.0, 0.5];
        let near = |a: Vec3, b: Vec3| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-12);
        assert!(near(mirror.apply(mirror.apply(r)), r));
        assert!((dot(mirror.apply(r), unit) - (4.0 - dot(r, unit))).abs() < 1e-12);
        let both = Isometry::translation([1.0, 2.0, 3.0]).after(&mirror);
        let expected = mirror.apply(r);
        assert!(near(both.apply(r), [expected[0] + 1.0, expected[1] + 2.0, expected[2] + 3.0]));
        assert!(near(both.undo(both.apply(r)), r));
        let quarter = Isometry::about_beam(std::f64::consts::FRAC_PI_2, [1.0, 2.0]);
        assert!(near(quarter.apply([2.0, 2.0, 5.0]), [1.0, 3.0, 5.0]));
        assert!(near(quarter.undo([1.0, 3.0, 5.0]), [2.0, 2.0, 5.0]));
    }
}
