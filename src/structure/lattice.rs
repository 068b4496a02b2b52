//! Three-vectors, cells whose vectors are the rows of a matrix, and common divisors of indices.

use std::ops::Rem;

/// A Cartesian or fractional vector.
pub(crate) type Vec3 = [f64; 3];
/// Three row vectors.
pub(crate) type Mat3 = [Vec3; 3];

/// Scalar product.
#[inline]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[inline]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Length.
#[inline]
pub fn norm(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// Difference `a - b`.
#[inline]
pub(crate) fn subtract(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Multiplies the row vector `v` by the matrix `m`: fractional to Cartesian if `m` is a cell.
#[inline]
pub fn row_times(v: Vec3, m: &Mat3) -> Vec3 {
    let [x, y, z] = v;
    [
        x * m[0][0] + y * m[1][0] + z * m[2][0],
        x * m[0][1] + y * m[1][1] + z * m[2][1],
        x * m[0][2] + y * m[1][2] + z * m[2][2],
    ]
}

/// Returns the signed volume of the cell; negative if its vectors are left-handed.
pub fn determinant(m: &Mat3) -> f64 {
    dot(m[0], cross(m[1], m[2]))
}

/// Returns the inverse matrix (Cartesian to fractional), or `None` for a flat cell.
pub(crate) fn inverse(m: &Mat3) -> Option<Mat3> {
    let volume = determinant(m);
    if volume == 0.0 || !volume.is_finite() {
        return None;
    }
    let columns = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
    Some(std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i] / volume)))
}

/// Returns the unit normal of the plane with Miller indices in a cell.
pub fn plane_normal(cell: &Mat3, miller: [i32; 3]) -> Vec3 {
    let to_fraction = inverse(cell).unwrap_or([[0.0; 3]; 3]);
    let normal: Vec3 =
        std::array::from_fn(|k| (0..3).map(|i| f64::from(miller[i]) * to_fraction[k][i]).sum());
    let length = norm(normal);
    normal.map(|n| n / length)
}

/// Returns the distances between opposite faces of the cell.
pub fn face_distances(m: &Mat3) -> Vec3 {
    let volume = determinant(m).abs();
    std::array::from_fn(|i| volume / norm(cross(m[(i + 1) % 3], m[(i + 2) % 3])))
}

/// Moves a fractional coordinate into [0, 1); values within `1e-9` below 1 become 0.
pub(crate) fn wrap_unit(x: f64) -> f64 {
    let wrapped = x - x.floor();
    if wrapped >= 1.0 - 1e-9 { 0.0 } else { wrapped }
}

/// Returns the greatest common divisor of two integers; with negative integers its sign is arbitrary.
pub(crate) fn gcd<T: Copy + Default + PartialEq + Rem<Output = T>>(a: T, b: T) -> T {
    if b == T::default() { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn greatest_common_divisors() {
        assert_eq!(gcd(12_u32, 18), 6);
        assert_eq!(gcd(0_usize, 7), 7);
        assert_eq!([-4, 0, 10].into_iter().fold(0_i32, gcd).abs(), 2);
    }

    #[test]
    fn inverse_undoes_the_cell() {
        let cell = [[3.0, 0.1, 0.0], [-1.0, 2.0, 0.3], [0.2, 0.4, 5.0]];
        let back = row_times(row_times([0.1, 0.7, -0.4], &cell), &inverse(&cell).unwrap());
        for (x, expected) in back.iter().zip([0.1, 0.7, -0.4]) {
            assert!((x - expected).abs() < 1e-14);
        }
        assert_eq!(inverse(&[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 0.0, 1.0]]), None);
    }

    #[test]
    fn wrapping_puts_rounding_errors_at_zero() {
        assert_eq!(wrap_unit(-1e-17), 0.0);
        assert_eq!(wrap_unit(1.25), 0.25);
        assert_eq!(wrap_unit(-0.25), 0.75);
        assert_eq!(wrap_unit(0.9999999999), 0.0);
    }
}
