//! Makes orthogonal supercells whose z axis is a zone axis.

use super::alternatives::CopiedPlaces;
use super::lattice::{
    Mat3, Vec3, cross, determinant, dot, gcd, inverse, norm, row_times, wrap_unit,
};
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
/// Largest deviation from a right angle that is accepted, in radian.
const TOLERANCE: f64 = 1e-3;
/// Largest strain that may be allowed.
const MOST_STRAIN: f64 = 0.1;
/// The vectors of the cell.
const CELL_AXES: [Indices; 3] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
/// Largest index of the directions that an error compares.
const REPORT_INDEX: i64 = 6;

/// A crystal in an orthogonal box, and the strain that made it so.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OrientedBox {
    /// The atoms in the box.
    pub structure: Structure,
    /// The largest principal strain by which the cell was made orthogonal: 0.01 is one per cent.
    pub strain: f64,
    /// The lattice directions of the original cell that became x, y and z.
    pub axes: [[i64; 3]; 3],
}

/// Limits for the boxes that are accepted.
#[derive(Clone, Copy)]
struct BoxLimits {
    /// Largest deviation from a right angle in radian.
    angle: f64,
    /// Largest principal strain.
    strain: f64,
}

impl BoxLimits {
    const USUAL: Self = BoxLimits { angle: TOLERANCE, strain: f64::INFINITY };
}

impl Structure {
    /// Returns the orthogonal supercell whose z axis is the lattice direction `zone` and whose y axis is `up`, or else the shortest lattice
    /// vector perpendicular to the zone; x completes a right-handed box. Indices refer to the vectors of this cell, so that the direction
    /// `[11-20]` of a hexagonal crystal is `[110]`. Angles within 1 mrad of 90 degrees are taken as right angles, and the atoms are
    /// strained accordingly. A cell that already has this form is returned unchanged.
    ///
    /// # Errors
    /// [`Error::Invalid`] if no such box has indices up to 24; it names the best angles.
    pub fn oriented(&self, zone: [i32; 3], up: Option<[i32; 3]>) -> Result<Structure> {
        Ok(self.oriented_within(zone, up, None)?.structure)
    }

    /// Orients the crystal like [`Structure::oriented`], with a limit for the strain: the largest principal strain (0.01 is one per cent)
    /// that may make the angles of the box right angles. With a limit, the cell itself is the box if its strain is within the limit.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a limit outside 0 to 0.1, and if no such box has indices up to 24.
    pub(crate) fn oriented_within(
        &self,
        zone: [i32; 3],
        up: Option<[i32; 3]>,
        max_strain: Option<f64>,
    ) -> Result<OrientedBox> {
        let z = reduced(Setting::Zone, zone)?;
        let y = up.map(|up| reduced(Setting::Up, up)).transpose()?;
        if z == [0, 0, 1] && y.is_none_or(|y| y == [0, 1, 0]) && self.orthogonal_box().is_ok() {
            return Ok(OrientedBox { structure: self.clone(), strain: 0.0, axes: CELL_AXES });
        }
        let limits = match max_strain {
            None => BoxLimits::USUAL,
            // Shear by an angle causes a strain of half the angle.
            Some(strain) if (0.0..=MOST_STRAIN).contains(&strain) => {
                BoxLimits { angle: 2.0 * strain, strain }
            }
            Some(strain) => {
                let expected =
                    format!("expected a strain from 0 to {} per cent", 100.0 * MOST_STRAIN);
                return Err(Error::invalid(Setting::MaxStrain, 100.0 * strain, expected));
            }
        };
        let axes = match y {
            _ if max_strain.is_some() && self.is_box_of_its_own(z, y, limits) => CELL_AXES,
            Some(y) => [self.find_x(z, y, limits)?, y, z],
            None => self.find_axes(z, limits)?,
        };
        let strain = self.strain_of(axes);
        Ok(OrientedBox { structure: self.in_box(axes)?, strain, axes })
    }

    /// Whether the vectors of the cell are axes within the limits, in their order and right-handed.
    fn is_box_of_its_own(&self, z: Indices, y: Option<Indices>, limits: BoxLimits) -> bool {
        let [x, up, along] = CELL_AXES;
        let asked = z == along && y.is_none_or(|y| y == up);
        asked
            && determinant(&self.cell) > 0.0
            && [[x, up], [x, z], [up, z]]
                .iter()
                .all(|[a, b]| fits(&self.cell, *a, *b, limits.angle))
            && self.strain_of(CELL_AXES) <= limits.strain
    }

    fn find_x(&self, z: Indices, y: Indices, limits: BoxLimits) -> Result<Indices> {
        let off = deviation(&self.cell, y, z);
        if off > limits.angle {
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
        let candidates = perpendicular(&self.cell, z, limits.angle);
        let found = candidates.iter().find(|&&x| self.fits_both(x, y, z, limits));
        match found {
            Some(&x) => Ok(right_handed(&self.cell, x, y, z)),
            None => Err(self.no_box(z, Some(y))),
        }
    }

    fn find_axes(&self, z: Indices, limits: BoxLimits) -> Result<[Indices; 3]> {
        let candidates = perpendicular(&self.cell, z, limits.angle);
        for &y in &candidates {
            if let Some(&x) = candidates.iter().find(|&&x| self.fits_both(x, y, z, limits)) {
                return Ok([right_handed(&self.cell, x, y, z), y, z]);
            }
        }
        Err(self.no_box(z, None))
    }

    fn fits_both(&self, x: Indices, y: Indices, z: Indices, limits: BoxLimits) -> bool {
        fits(&self.cell, x, y, limits.angle)
            && (limits.strain == f64::INFINITY || self.strain_of([x, y, z]) <= limits.strain)
    }

    /// Returns the largest principal strain that turns the lattice vectors into edges of equal length at right angles.
    fn strain_of(&self, axes: [Indices; 3]) -> f64 {
        let [x, y, z] = axes.map(|n| cartesian(&self.cell, n));
        let cosine = |a: Vec3, b: Vec3| dot(a, b) / (norm(a) * norm(b));
        let [a, b, c] = [cosine(x, y), cosine(x, z), cosine(y, z)];
        // The metric of unit vectors, 1 + m, has the squares of the stretches as eigenvalues; the three eigenvalues of m add to 0.
        let size = ((a * a + b * b + c * c) / 3.0).sqrt();
        if size == 0.0 {
            return 0.0;
        }
        let turn = libm::acos((a * b * c / size.powi(3)).clamp(-1.0, 1.0)) / 3.0;
        let eigenvalue =
            |k: f64| 2.0 * size * libm::cos(turn + 2.0 * std::f64::consts::PI * k / 3.0);
        let strain = |k: f64| (1.0 / (1.0 + eigenvalue(k)).max(0.0).sqrt() - 1.0).abs();
        [0.0, 1.0, 2.0].map(strain).into_iter().fold(0.0, f64::max)
    }

    /// Returns the error, with the axes of small indices whose angles are nearest to right angles.
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
                "no orthogonal box with indices up to {LARGEST_INDEX} has this z axis{nearest}; choose another zone, or allow more strain, \
                 which makes the angles 90 degrees"
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
        let turned = frame(&vectors);
        let places = CopiedPlaces::of(self);
        let mut atoms = Vec::with_capacity(self.atoms.len());
        let mut copy = 0;
        for i in 0..cells[0] {
            for j in 0..cells[1] {
                for k in 0..cells[2] {
                    let shift = cartesian(&self.cell, [i, j, k]);
                    atoms.extend(self.atoms.iter().map(|atom| {
                        let moved = std::array::from_fn(|a| atom.position[a] + shift[a]);
                        let fraction = row_times(moved, &to_fraction).map(wrap_unit);
                        let position = std::array::from_fn(|a| fraction[a] * lengths[a]);
                        let displacement = atom.displacement.map(|u| u.turned(&turned));
                        places.atom(&Atom { position, displacement, ..*atom }, copy)
                    }));
                    copy += 1;
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

/// Returns the axes x, y and z of a box with these nearly orthogonal edges: z is exact. Tensors are turned with the crystal, but not
/// strained.
fn frame(edges: &Mat3) -> Mat3 {
    let unit = |v: Vec3| v.map(|x| x / norm(v));
    let z = unit(edges[2]);
    let x = unit(cross(edges[1], z));
    [x, cross(z, x), z]
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
    let divisor = indices.into_iter().fold(0, gcd).abs();
    Ok(indices.map(|i| i / divisor))
}

fn cartesian(cell: &Mat3, n: Indices) -> Vec3 {
    row_times(n.map(|i| i as f64), cell)
}

/// Returns the angle between two lattice directions in degrees.
fn angle(cell: &Mat3, a: Indices, b: Indices) -> f64 {
    let (a, b) = (cartesian(cell, a), cartesian(cell, b));
    (dot(a, b) / (norm(a) * norm(b))).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Returns the difference of the angle between two lattice directions from 90 degrees, in radian.
fn deviation(cell: &Mat3, a: Indices, b: Indices) -> f64 {
    let (a, b) = (cartesian(cell, a), cartesian(cell, b));
    (dot(a, b) / (norm(a) * norm(b))).clamp(-1.0, 1.0).asin().abs()
}

fn fits(cell: &Mat3, a: Indices, b: Indices, tolerance: f64) -> bool {
    deviation(cell, a, b) <= tolerance
}

/// Returns `x` or its opposite, so that the axes are right-handed.
fn right_handed(cell: &Mat3, x: Indices, y: Indices, z: Indices) -> Indices {
    let (vx, vy, vz) = (cartesian(cell, x), cartesian(cell, y), cartesian(cell, z));
    if dot(vx, cross(vy, vz)) < 0.0 { x.map(|i| -i) } else { x }
}

/// Returns all directions without a common divisor, one of each opposite pair, with indices up to `bound`.
fn directions(bound: i64) -> Vec<Indices> {
    let range = -bound..=bound;
    let mut list = Vec::new();
    for w in range.clone() {
        for v in range.clone() {
            for u in range.clone() {
                // The last index that is not zero is positive: [010] represents [0-10].
                let first = [w, v, u].into_iter().find(|&i| i != 0).unwrap_or(0);
                if first > 0 && gcd(gcd(u, v), w).abs() == 1 {
                    list.push([u, v, w]);
                }
            }
        }
    }
    list
}

/// Returns the directions perpendicular to `z` within the tolerance, shortest first; among equal lengths the direction with fewer negative
/// indices first, then the direction along the later cell vector.
fn perpendicular(cell: &Mat3, z: Indices, tolerance: f64) -> Vec<Indices> {
    let mut list: Vec<(f64, Indices)> = directions(LARGEST_INDEX)
        .into_iter()
        .filter(|&n| fits(cell, n, z, tolerance))
        .map(|n| (norm(cartesian(cell, n)), n))
        .collect();
    let unit = determinant(cell).abs().cbrt() * 1e-6;
    list.sort_by_key(|&(length, [u, v, w])| {
        let negative = [u, v, w].iter().filter(|&&i| i < 0).count();
        ((length / unit).round() as u64, negative, std::cmp::Reverse((w, v, u)))
    });
    list.into_iter().map(|(_, n)| n).collect()
}

/// Returns the diagonal of the Hermite normal form of the sublattice spanned by `rows`. The translations [i, j, k] below it contain one of
/// each class, so that no atom is lost or doubled at a face.
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
    fn a_nearly_orthogonal_cell_is_strained_within_the_limit() {
        let relaxed = Structure {
            cell: [[7.8102, 0.0021, -0.0013], [0.0034, 7.8098, 0.0008], [-0.0011, 0.0005, 7.8121]],
            atoms: vec![Atom::new(38, [0.0; 3])],
        };
        assert!(relaxed.orthogonal_box().is_err());
        let made = relaxed.oriented_within([0, 0, 1], None, Some(0.001)).unwrap();
        assert_eq!(made.structure.atoms.len(), 1);
        let [x, y, z] = made.structure.orthogonal_box().unwrap();
        assert!(
            (x - 7.8102).abs() < 1e-5 && (y - 7.8098).abs() < 1e-5 && (z - 7.8121).abs() < 1e-5
        );
        // Half of the largest shear, (0.0021 + 0.0034) / 7.81, and a little for the other shears.
        assert!((3.5e-4..4.5e-4).contains(&made.strain), "{}", made.strain);
        assert!(relaxed.oriented_within([0, 0, 1], None, Some(1e-4)).is_err());
        let message = relaxed.oriented_within([0, 0, 1], None, Some(0.5)).unwrap_err().to_string();
        assert!(message.contains("from 0 to 10 per cent"), "{message}");
    }

    #[test]
    fn pure_shear_strains_by_half_its_angle() {
        let shear = 0.02_f64;
        let cell = [[4.0, 0.0, 0.0], [4.0 * shear.sin(), 4.0 * shear.cos(), 0.0], [0.0, 0.0, 5.0]];
        let s = Structure { cell, atoms: vec![] };
        assert!((s.strain_of(CELL_AXES) - 0.5 * shear).abs() < 2e-4);
        let orthogonal =
            Structure { cell: [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 5.0]], atoms: vec![] };
        assert_eq!(orthogonal.strain_of(CELL_AXES), 0.0);
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
