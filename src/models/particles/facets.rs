//! Facets of a crystal and the polyhedra that they bound (G. Wulff, Z. Kristallogr. 34, 449 (1901)).

use super::point_group::point_group;
use crate::structure::Structure;
use crate::structure::lattice::{Vec3, cross, dot, norm, plane_normal, row_times, subtract};

/// Half the edge of the squares that facets are cut from, in units of the largest distance of a facet: what reaches it is not bounded.
const FAR: f64 = 1e3;
/// Two unit normals are one facet if they differ by less.
const SAME_NORMAL: f64 = 1e-3;

/// A half-space: points r with r . `normal` <= `distance`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facet {
    /// Unit vector out of the polyhedron.
    pub normal: Vec3,
    /// Distance from the centre; negative if the centre lies outside. Relative until the polyhedron has a size.
    pub distance: f64,
}

/// A polyhedron about the origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyhedron {
    /// The half-spaces that bound it.
    pub facets: Vec<Facet>,
}

impl Polyhedron {
    /// Makes the polyhedron of a crystal whose families of planes have surface energies. Each family is completed by the point group of
    /// the crystal. Where the group has no inversion, the opposite of a facet has the same energy unless it is listed.
    ///
    /// # Errors
    /// The index of a family that an earlier one of the list contains.
    pub fn of_families(crystal: &Structure, families: &[([i32; 3], f64)]) -> Result<Self, usize> {
        let group = point_group(crystal);
        let mut facets: Vec<Facet> = Vec::new();
        for (n, (miller, energy)) in families.iter().enumerate() {
            let normal = plane_normal(&crystal.cell, *miller);
            if known(&facets, normal) {
                return Err(n);
            }
            for matrix in &group {
                let image = row_times(normal, matrix);
                if !known(&facets, image) {
                    facets.push(Facet { normal: image, distance: *energy });
                }
            }
        }
        let opposite = |facet: &Facet| Facet { normal: facet.normal.map(|v| -v), ..*facet };
        let missing = facets.iter().map(opposite).filter(|o| !known(&facets, o.normal));
        let missing: Vec<Facet> = missing.collect();
        facets.extend(missing);
        Ok(Polyhedron { facets })
    }

    /// Returns the polyhedron multiplied by a length.
    pub fn scaled(&self, by: f64) -> Self {
        let facet = |f: &Facet| Facet { distance: by * f.distance, ..*f };
        Polyhedron { facets: self.facets.iter().map(facet).collect() }
    }

    /// Returns the polyhedron with a further facet.
    pub fn cut(&self, facet: Facet) -> Self {
        let mut facets = self.facets.clone();
        facets.push(facet);
        Polyhedron { facets }
    }

    /// Returns the corners of each facet, in order about it; empty where a facet is cut off. `None` if the facets bound no finite volume.
    pub fn polygons(&self) -> Option<Vec<Vec<Vec3>>> {
        let largest = self.facets.iter().map(|f| f.distance.abs()).fold(0.0, f64::max);
        let far = FAR * largest;
        let polygons: Vec<Vec<Vec3>> =
            (0..self.facets.len()).map(|n| self.polygon(n, far)).collect();
        let bounded = polygons.iter().flatten().all(|corner| norm(*corner) < 0.5 * far);
        let some = polygons.iter().filter(|polygon| polygon.len() > 2).count() > 3;
        (bounded && some).then_some(polygons)
    }

    fn polygon(&self, n: usize, far: f64) -> Vec<Vec3> {
        let Facet { normal, distance } = self.facets[n];
        let least = (0..3).min_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs()));
        let axis: Vec3 = std::array::from_fn(|k| f64::from(u8::from(Some(k) == least)));
        let u = cross(normal, axis);
        let u = u.map(|c| c / norm(u));
        let v = cross(normal, u);
        let corner = |[a, b]: [f64; 2]| {
            std::array::from_fn(|k| distance * normal[k] + far * (a * u[k] + b * v[k]))
        };
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let mut polygon: Vec<Vec3> = square.into_iter().map(corner).collect();
        for (m, other) in self.facets.iter().enumerate() {
            if m != n {
                polygon = clipped(&polygon, other);
            }
        }
        polygon
    }

    /// Returns the volume; `None` if it is not finite, or there is none.
    pub fn volume(&self) -> Option<f64> {
        let polygons = self.polygons()?;
        let part = |(facet, polygon): (&Facet, &Vec<Vec3>)| facet.distance * area(polygon) / 3.0;
        let volume: f64 = self.facets.iter().zip(&polygons).map(part).sum();
        (volume > 0.0).then_some(volume)
    }

    /// Returns the depth of a point below the nearest facet; negative outside.
    pub fn depth(&self, at: Vec3) -> f64 {
        let below = |f: &Facet| f.distance - dot(at, f.normal);
        self.facets.iter().map(below).fold(f64::INFINITY, f64::min)
    }
}

fn known(facets: &[Facet], normal: Vec3) -> bool {
    facets.iter().any(|f| norm(subtract(f.normal, normal)) < SAME_NORMAL)
}

/// Cuts off what lies outside a half-space (I. Sutherland and G. Hodgman, Commun. ACM 17, 32 (1974)).
fn clipped(polygon: &[Vec3], by: &Facet) -> Vec<Vec3> {
    let over = |p: Vec3| dot(p, by.normal) - by.distance;
    let mut kept = Vec::new();
    for (k, &from) in polygon.iter().enumerate() {
        let to = polygon[(k + 1) % polygon.len()];
        let (a, b) = (over(from), over(to));
        if a <= 0.0 {
            kept.push(from);
        }
        if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
            kept.push(std::array::from_fn(|i| from[i] + a / (a - b) * (to[i] - from[i])));
        }
    }
    kept
}

/// Returns the area of a plane polygon.
pub fn area(polygon: &[Vec3]) -> f64 {
    let Some((first, rest)) = polygon.split_first() else { return 0.0 };
    let parts = rest.windows(2).map(|w| cross(subtract(w[0], *first), subtract(w[1], *first)));
    0.5 * norm(parts.fold([0.0; 3], |sum, part| std::array::from_fn(|k| sum[k] + part[k])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals::crystal;

    fn wulff(name: &str, families: &[([i32; 3], f64)]) -> Polyhedron {
        Polyhedron::of_families(&crystal(name).unwrap(), families).unwrap()
    }

    #[test]
    fn volumes_of_simple_forms_are_known() {
        let near =
            |a: Option<f64>, b: f64| assert!((a.unwrap() / b - 1.0).abs() < 1e-9, "{a:?} {b}");
        near(wulff("pt", &[([1, 0, 0], 1.0)]).volume(), 8.0);
        // A regular octahedron of inradius r has the volume 4 sqrt(3) r^3.
        near(wulff("pt", &[([1, 1, 1], 1.0)]).volume(), 4.0 * 3f64.sqrt());
        // A rhombic dodecahedron of inradius r: 4 sqrt(2) r^3.
        near(wulff("pt", &[([1, 1, 0], 1.0)]).volume(), 4.0 * 2f64.sqrt());
        // A regular truncated octahedron of edge 1: volume 8 sqrt(2), {100} at sqrt(2), {111} at sqrt(6) / 2.
        let [square, hexagon] = [2f64.sqrt(), 6f64.sqrt() / 2.0];
        let truncated = wulff("pt", &[([1, 0, 0], square), ([1, 1, 1], hexagon)]);
        near(truncated.volume(), 8.0 * 2f64.sqrt());
        let polygons = truncated.polygons().unwrap();
        assert_eq!(polygons.iter().filter(|p| p.len() == 4).count(), 6);
        assert_eq!(polygons.iter().filter(|p| p.len() == 6).count(), 8);
        // Half of it, cut through the centre.
        let half = truncated.cut(Facet { normal: [0.0, 0.0, 1.0], distance: 0.0 });
        near(half.volume(), 4.0 * 2f64.sqrt());
        let cap = truncated.cut(Facet { normal: [0.0, 0.0, 1.0], distance: -1.0 });
        assert!(cap.volume().unwrap() < 4.0 * 2f64.sqrt() && cap.volume().unwrap() > 0.0);
    }

    #[test]
    fn families_follow_the_point_group_and_open_forms_have_no_volume() {
        assert_eq!(wulff("pt", &[([2, 1, 0], 1.0)]).facets.len(), 24);
        assert_eq!(wulff("gan", &[([1, 0, 0], 1.0), ([0, 0, 1], 1.0)]).facets.len(), 8);
        assert_eq!(wulff("gan", &[([0, 0, 1], 1.0)]).volume(), None);
        // {111} and its opposite differ in GaAs: a truncated tetrahedron.
        let listed = wulff("gaas", &[([1, 1, 1], 1.0), ([-1, -1, -1], 2.0)]);
        assert_eq!(listed.facets.len(), 8);
        assert!(listed.facets.iter().any(|f| f.distance == 2.0));
        let one = wulff("gaas", &[([1, 1, 1], 1.0)]);
        assert_eq!(one.facets.len(), 8);
        let twice = Polyhedron::of_families(
            &crystal("pt").unwrap(),
            &[([1, 1, 1], 1.0), ([-1, 1, 1], 1.0)],
        );
        assert_eq!(twice, Err(1));
    }
}
