//! Orthogonal supercells that look along a zone axis.

use super::lattice::{Mat3, Vec3, cross, determinant, dot, inverse, norm, row_times, wrap_unit};
use super::supercell::check_size;
use super::{Atom, Structure};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// A lattice direction \[uvw\].
type Indices = [i64; 3];

/// Largest index tried for the x and y axes.
const LARGEST_INDEX: i64 = 24;
/// Largest index accepted for the zone and for `up`.
const LARGEST_GIVEN: i32 = 100;
/// Deviation from a right angle that counts as none, in radian.
const TOLERANCE: f64 = 1e-3;
/// Largest index of the directions among which the best failure is looked for.
const REPORT_INDEX: i64 = 6;

impl Structure {
    /// The orthogonal supercell whose z axis is the lattice direction `zone` and whose y axis is
    /// `up`, or else the shortest lattice vector perpendicular to the zone; x completes a
    /// right-handed box. Indices refer to the vectors of this cell, so that the direction `[11-20]` of a
    /// hexagonal crystal is `[110]`. Angles within 1 mrad of 90 degrees are taken as right, and the atoms are
    /// strained accordingly. A cell that is such a box already is returned as it is.
    ///
    /// # Errors
    /// [`Error::Invalid`] if no such box has indices up to 24; it names the best angles.
    pub fn oriented(&self, zone: [i32; 3], up: Option<[i32; 3]>) -> Result<Structure> {
        let z = reduced(Setting::Zone, zone)?;
        let y = up.map(|up| reduced(Setting::Up, up)).transpose()?;
        if z == [0, 0, 1] && y.is_none_or(|y| y == [0, 1, 0]) && self.orthogonal_box().is_ok() {
            return Ok(self.clone());
        }
        let [x, y] = match y {
            Some(y) => [self.find_x(z, y)?, y],
            None => self.find_axes(z)?,
        };
        self.in_box([x, y, z])
    }

    fn find_x(&self, z: Indices, y: Indices) -> Result<Indices> {
        let off = deviation(&self.cell, y, z);
        if off > TOLERANCE {
            return Err(Error::invalid(
                Setting::Up,
                format!("{y:?}"),
                format!(
                    "it must be perpendicular to the zone {z:?}, but encloses {:.3} degrees with \
                     it; leave it out to have one chosen",
                    angle(&self.cell, y, z)
                ),
            ));
        }
        let candidates = perpendicular(&self.cell, z);
        match candidates.iter().find(|&&x| fits(&self.cell, x, y)) {
            Some(&x) => Ok(right_handed(&self.cell, x, y, z)),
            None => Err(self.no_box(z, Some(y))),
        }
    }

    fn find_axes(&self, z: Indices) -> Result<[Indices; 2]> {
        let candidates = perpendicular(&self.cell, z);
        for &y in &candidates {
            if let Some(&x) = candidates.iter().find(|&&x| fits(&self.cell, x, y)) {
                return Ok([right_handed(&self.cell, x, y, z), y]);
            }
        }
        Err(self.no_box(z, None))
    }

    /// The error, with the axes among small indices that come nearest to right angles.
    fn no_box(&self, z: Indices, y: Option<Indices>) -> Error {
        let cell = &self.cell;
        let all = directions(REPORT_INDEX);
        let ys = y.map_or_else(|| all.clone(), |y| vec![y]);
        let mut best = (f64::INFINITY, [0; 3], [0; 3]);
        for &y in ys.iter().filter(|&&y| deviation(cell, y, z) < 0.2) {
            for &x in all.iter().filter(|&&x| deviation(cell, x, z) < 0.2) {
                let worst =
                    deviation(cell, x, y).max(deviation(cell, x, z)).max(deviation(cell, y, z));
                if worst < best.0 {
                    best = (worst, x, y);
                }
            }
        }
        let (worst, x, y) = best;
        let nearest = if worst.is_finite() {
            format!(
                "; the nearest, x = {x:?} and y = {y:?}, is {:.3} degrees off a right angle",
                worst.to_degrees()
            )
        } else {
            String::new()
        };
        Error::invalid(
            Setting::Zone,
            format!("{z:?}"),
            format!(
                "no orthogonal box with indices up to {LARGEST_INDEX} has this z axis{nearest}; \
                 choose another zone, or strain the cell to a right angle"
            ),
        )
    }

    /// Fills the box spanned by the lattice vectors `axes`.
    fn in_box(&self, axes: [Indices; 3]) -> Result<Structure> {
        let cells = hermite_diagonal(axes);
        check_size(cells.iter().map(|&n| n as u128).product(), self.atoms.len())?;
        let vectors: Mat3 = axes.map(|n| cartesian(&self.cell, n));
        let Some(to_fraction) = inverse(&vectors) else {
            return Err(Error::invalid(
                Setting::Zone,
                format!("{axes:?}"),
                "the box has no volume",
            ));
        };
        let lengths = vectors.map(norm);
        let mut atoms = Vec::with_capacity(self.atoms.len());
        for i in 0..cells[0] {
            for j in 0..cells[1] {
                for k in 0..cells[2] {
                    let shift = cartesian(&self.cell, [i, j, k]);
                    atoms.extend(self.atoms.iter().map(|atom| {
                        let moved = std::array::from_fn(|a| atom.position[a] + shift[a]);
                        let fraction = row_times(moved, &to_fraction).map(wrap_unit);
                        let position = std::array::from_fn(|a| fraction[a] * lengths[a]);
                        Atom { position, ..*atom }
                    }));
                }
            }
        }
        let mut cell = [[0.0; 3]; 3];
        for (axis, length) in lengths.into_iter().enumerate() {
            cell[axis][axis] = length;
        }
        Ok(Structure { cell, atoms })
    }
}

fn reduced(setting: Setting, given: [i32; 3]) -> Result<Indices> {
    let fault = |expected: &str| Error::invalid(setting, format!("{given:?}"), expected);
    if given == [0; 3] {
        return Err(fault("expected a lattice direction such as [1, 1, 0]"));
    }
    if given.iter().any(|i| i.unsigned_abs() > LARGEST_GIVEN.unsigned_abs()) {
        return Err(fault("expected indices from -100 to 100"));
    }
    let indices = given.map(i64::from);
    let divisor = indices.iter().fold(0, |a, &b| gcd(a, b));
    Ok(indices.map(|i| i / divisor))
}

fn gcd(a: i64, b: i64) -> i64 {
    if b == 0 { a.abs() } else { gcd(b, a % b) }
}

fn cartesian(cell: &Mat3, n: Indices) -> Vec3 {
    row_times(n.map(|i| i as f64), cell)
}

/// Angle between two lattice directions in degrees.
fn angle(cell: &Mat3, a: Indices, b: Indices) -> f64 {
    let (a, b) = (cartesian(cell, a), cartesian(cell, b));
    (dot(a, b) / (norm(a) * norm(b))).clamp(-1.0, 1.0).acos().to_degrees()
}

/// How far the angle between two lattice directions is from 90 degrees, in radian.
fn deviation(cell: &Mat3, a: Indices, b: Indices) -> f64 {
    let (a, b) = (cartesian(cell, a), cartesian(cell, b));
    (dot(a, b) / (norm(a) * norm(b))).clamp(-1.0, 1.0).asin().abs()
}

fn fits(cell: &Mat3, a: Indices, b: Indices) -> bool {
    deviation(cell, a, b) <= TOLERANCE
}

/// `x` or its opposite.
fn right_handed(cell: &Mat3, x: Indices, y: Indices, z: Indices) -> Indices {
    let (vx, vy, vz) = (cartesian(cell, x), cartesian(cell, y), cartesian(cell, z));
    if dot(vx, cross(vy, vz)) < 0.0 { x.map(|i| -i) } else { x }
}

/// All directions without a common divisor, one of each opposite pair, indices up to `bound`.
fn directions(bound: i64) -> Vec<Indices> {
    let range = -bound..=bound;
    let mut list = Vec::new();
    for w in range.clone() {
        for v in range.clone() {
            for u in range.clone() {
                // The last index that is not zero is positive, so [010] stands for [0-10].
                let first = [w, v, u].into_iter().find(|&i| i != 0).unwrap_or(0);
                if first > 0 && gcd(gcd(u, v), w) == 1 {
                    list.push([u, v, w]);
                }
            }
        }
    }
    list
}

/// The directions perpendicular to `z` within the tolerance, shortest first; of equal ones that
/// with fewer negative indices, then that along the later cell vector.
fn perpendicular(cell: &Mat3, z: Indices) -> Vec<Indices> {
    let mut list: Vec<(f64, Indices)> = directions(LARGEST_INDEX)
        .into_iter()
        .filter(|&n| fits(cell, n, z))
        .map(|n| (norm(cartesian(cell, n)), n))
        .collect();
    let unit = determinant(cell).abs().cbrt() * 1e-6;
    list.sort_by_key(|&(length, [u, v, w])| {
        let negative = [u, v, w].iter().filter(|&&i| i < 0).count();
        ((length / unit).round() as u64, negative, std::cmp::Reverse((w, v, u)))
    });
    list.into_iter().map(|(_, n)| n).collect()
}

/// The diagonal of the Hermite normal form of the sublattice spanned by `rows`. The translations
/// [i, j, k] below it are one of each class, so that none is lost or doubled at a face.
fn hermite_diagonal(mut rows: [Indices; 3]) -> Indices {
    for column in 0..3 {
        // Euclid's algorithm on the rows leaves one nonzero entry at the top.
        loop {
            let smallest = (column..3)
                .filter(|&r| rows[r][column] != 0)
                .min_by_key(|&r| rows[r][column].abs());
            let Some(pivot) = smallest else { break };
            rows.swap(column, pivot);
            let top = rows[column];
            let mut done = true;
            for row in rows.iter_mut().skip(column + 1) {
                let factor = row[column].div_euclid(top[column]);
                *row = std::array::from_fn(|i| row[i] - factor * top[i]);
                done &= row[column] == 0;
            }
            if done {
                break;
            }
        }
    }
    std::array::from_fn(|i| rows[i][i].abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hermite_diagonal_has_the_volume() {
        assert_eq!(hermite_diagonal([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), [1, 1, 1]);
        let d = hermite_diagonal([[1, -1, 0], [1, 1, -2], [1, 1, 1]]);
        assert_eq!(d.iter().product::<i64>(), 6);
        let d = hermite_diagonal([[3, 5, 7], [-2, 4, 9], [11, 0, 6]]);
        assert_eq!(d.iter().product::<i64>(), 319);
    }

    #[test]
    fn directions_are_primitive_and_unique() {
        let list = directions(2);
        assert_eq!(list.len(), (125 - 27) / 2);
        assert!(list.contains(&[0, 1, 0]) && !list.contains(&[0, -1, 0]));
        assert!(!list.contains(&[2, 0, 0]));
    }

    #[test]
    fn indices_are_checked() {
        let s =
            Structure { cell: [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]], atoms: vec![] };
        assert!(s.oriented([0, 0, 0], None).is_err());
        assert!(s.oriented([0, 0, i32::MIN], None).is_err());
        let error = s.oriented([0, 0, 1], Some([0, 1, 1])).unwrap_err().to_string();
        assert!(error.contains("encloses 45.000 degrees"), "{error}");
    }
}
