//! Rotations as unit quaternions (w, x, y, z), from the frame of a particle to the frame of the specimen.

use super::Vec3;
use crate::structure::lattice::{cross, dot, norm};

/// A unit quaternion (w, x, y, z).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation(pub [f64; 4]);

impl Rotation {
    /// Turns nothing.
    pub const NONE: Self = Rotation([1.0, 0.0, 0.0, 0.0]);

    /// Rotation by `angle` radian about `axis` (of any length).
    pub fn about(axis: Vec3, angle: f64) -> Self {
        let scale = libm::sin(0.5 * angle) / norm(axis);
        Rotation([libm::cos(0.5 * angle), axis[0] * scale, axis[1] * scale, axis[2] * scale])
    }

    /// Returns the shortest rotation that takes the direction `from` to z.
    pub fn to_z(from: Vec3) -> Self {
        let length = norm(from);
        let z = [0.0, 0.0, 1.0];
        let axis = cross(from, z);
        let angle = libm::acos((from[2] / length).clamp(-1.0, 1.0));
        match dot(axis, axis) > 1e-20 * length * length {
            true => Rotation::about(axis, angle),
            false => Rotation::about([1.0, 0.0, 0.0], angle),
        }
    }

    /// Makes a uniformly distributed rotation from three numbers uniform in (0, 1) (K. Shoemake, Graphics Gems III, 1992).
    pub fn uniform([u, v, w]: [f64; 3]) -> Self {
        let turn = |x: f64| 2.0 * std::f64::consts::PI * x;
        let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
        let (v, w) = (turn(v), turn(w));
        Rotation([b * libm::cos(w), a * libm::sin(v), a * libm::cos(v), b * libm::sin(w)])
    }

    /// Returns this rotation after `first`.
    pub fn after(self, first: Rotation) -> Self {
        let ([w, x, y, z], [a, b, c, d]) = (self.0, first.0);
        Rotation([
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ])
    }

    /// Returns the rotation that undoes this one.
    pub fn inverse(self) -> Self {
        let [w, x, y, z] = self.0;
        Rotation([w, -x, -y, -z])
    }

    /// Rotates a vector.
    pub fn apply(self, v: Vec3) -> Vec3 {
        let [w, x, y, z] = self.0;
        let q = [x, y, z];
        let t = cross(q, v).map(|c| 2.0 * c);
        let u = cross(q, t);
        std::array::from_fn(|k| v[k] + w * t[k] + u[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_turn_and_combine() {
        let close = |a: Vec3, b: Vec3| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-12);
        let quarter = Rotation::about([0.0, 0.0, 2.0], std::f64::consts::FRAC_PI_2);
        assert!(close(quarter.apply([1.0, 0.0, 5.0]), [0.0, 1.0, 5.0]));
        for v in [[1.0, 1.0, 1.0], [0.0, 0.0, -3.0], [0.0, 0.0, 2.0], [-1.0, 4.0, 0.2]] {
            assert!(close(Rotation::to_z(v).apply(v), [0.0, 0.0, norm(v)]), "{v:?}");
        }
        let (a, b) = (Rotation::uniform([0.2, 0.7, 0.4]), Rotation::uniform([0.9, 0.1, 0.3]));
        let v = [0.3, -2.0, 1.0];
        assert!(close(a.after(b).apply(v), a.apply(b.apply(v))));
        assert!((norm(a.apply(v)) - norm(v)).abs() < 1e-12);
    }
}
