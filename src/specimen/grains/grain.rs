//! The lattice of one grain of a polycrystal.

use crate::plane;

/// The lattice of one grain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grain {
    /// A lattice point in Angstrom.
    pub origin: [f64; 2],
    /// Cosine and sine of the rotation.
    pub rotation: [f64; 2],
    /// Whether the rotated lattice is mirrored (x to -x).
    pub mirrored: bool,
    /// The grain spans `x[0] < x <= x[1]`, in Angstrom.
    pub x: [f64; 2],
}

impl Grain {
    /// Returns the position of the point (u, v) in Angstrom; u and v in units of the edges of `cell`.
    pub(crate) fn position(&self, cell: [f64; 3], u: f64, v: f64) -> [f64; 2] {
        let [c, s] = self.rotation;
        let (u, v) = (cell[0] * u, cell[1] * v);
        let dx = c * u - s * v;
        let x = if self.mirrored { self.origin[0] - dx } else { self.origin[0] + dx };
        [x, self.origin[1] + (s * u + c * v)]
    }

    /// Returns the mirror image about the line `x = plane`: cells with the same indices lie at mirrored places.
    pub(crate) fn mirror_image(&self, plane: f64) -> Grain {
        Grain {
            origin: [2.0 * plane - self.origin[0], self.origin[1]],
            rotation: self.rotation,
            mirrored: !self.mirrored,
            x: [plane, f64::INFINITY],
        }
    }

    /// Returns the ranges of cells (i, j) that cover a rectangle `[[x0, x1], [y0, y1]]` in Angstrom.
    pub(crate) fn cells(
        &self,
        cell: [f64; 3],
        rect: [[f64; 2]; 2],
    ) -> [std::ops::RangeInclusive<i64>; 2] {
        let [c, s] = self.rotation;
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for x in rect[0] {
            for y in rect[1] {
                let right = x - self.origin[0];
                let (dx, dy) = (if self.mirrored { -right } else { right }, y - self.origin[1]);
                let uv = [(c * dx + s * dy) / cell[0], (c * dy - s * dx) / cell[1]];
                for k in 0..2 {
                    low[k] = f64::min(low[k], uv[k]);
                    high[k] = f64::max(high[k], uv[k]);
                }
            }
        }
        plane::per_axis(low, high, |low, high| low.floor() as i64 - 1..=high.ceil() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cover_what_a_grain_shows_and_its_mirror_image_agrees() {
        let rotation = [0.8, 0.6];
        let left = Grain { origin: [1.0, 2.0], rotation, mirrored: false, x: [0.0, 9.0] };
        let right = left.mirror_image(9.0);
        let cell = [3.0, 4.0, 5.0];
        for (u, v) in [(2.5, -1.25), (-4.0, 7.0)] {
            let (l, r) = (left.position(cell, u, v), right.position(cell, u, v));
            assert!((l[0] + r[0] - 18.0).abs() < 1e-12 && l[1] == r[1]);
            for (grain, p) in [(left, l), (right, r)] {
                let [is, js] = grain.cells(cell, [[p[0], p[0]], [p[1], p[1]]]);
                assert!(is.contains(&(u.floor() as i64)) && js.contains(&(v.floor() as i64)));
            }
        }
    }
}
