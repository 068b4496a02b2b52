//! The displacement field of straight edge dislocations along the beam, in an isotropic infinite medium.

/// An edge dislocation whose line runs along z. Lengths are in Angstrom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeDislocation {
    /// Place (x, y) of the line.
    pub position: [f64; 2],
    /// Burgers vector (x, y): the displacement gained on a circuit from x to y about the line.
    pub burgers: [f64; 2],
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Whether the displacement jumps on the side of the line to which the Burgers vector points; else it jumps on the other side.
    pub cut_ahead: bool,
}

impl EdgeDislocation {
    /// Returns the displacement (x, y) of the atom that lies at (x, y) in the undisturbed crystal.
    ///
    /// Along the Burgers vector it is b / 2 pi (theta + x y / (2 (1 - nu) r^2)), and normal to it
    /// -b / 2 pi ((1 - 2 nu) / (4 (1 - nu)) ln(r^2 / b^2) + (x^2 - y^2) / (4 (1 - nu) r^2)), with x along the Burgers vector
    /// (J. P. Hirth and J. Lothe, Theory of Dislocations, 2nd ed., Wiley 1982, equations 3-45 and 3-46). It is 0 on the line itself.
    ///
    /// The jump by one Burgers vector lies on the slip plane: a crystal that has the Burgers vector as a lattice vector is whole there, and
    /// no half plane has to be cut out. Within about two Burgers vectors of the line linear elasticity does not hold: the atoms there
    /// lie where the formula puts them, not where a relaxed core has them.
    pub fn displacement(&self, at: [f64; 2]) -> [f64; 2] {
        let length = (self.burgers[0].powi(2) + self.burgers[1].powi(2)).sqrt();
        // The arc tangent jumps on the negative x axis.
        let sign = if self.cut_ahead { -1.0 } else { 1.0 };
        let along = self.burgers.map(|b| sign * b / length);
        let normal = [-along[1], along[0]];
        let from = [at[0] - self.position[0], at[1] - self.position[1]];
        let x = from[0] * along[0] + from[1] * along[1];
        let y = from[0] * normal[0] + from[1] * normal[1];
        let square = x * x + y * y;
        if square == 0.0 {
            return [0.0; 2];
        }
        let nu = self.poisson_ratio;
        let scale = sign * length / (2.0 * std::f64::consts::PI);
        let u = scale * (libm::atan2(y, x) + x * y / (2.0 * (1.0 - nu) * square));
        let dilation = (1.0 - 2.0 * nu) / (4.0 * (1.0 - nu));
        let logarithm = libm::log(square / (length * length));
        let v = -scale * (dilation * logarithm + (x * x - y * y) / (4.0 * (1.0 - nu) * square));
        std::array::from_fn(|k| u * along[k] + v * normal[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(burgers: [f64; 2], cut_ahead: bool) -> EdgeDislocation {
        EdgeDislocation { position: [3.0, -2.0], burgers, poisson_ratio: 0.3, cut_ahead }
    }

    #[test]
    fn circuits_close_to_the_burgers_vector() {
        for (burgers, ahead) in [([3.9, 0.0], false), ([0.0, -3.9], false), ([2.0, 3.0], true)] {
            let field = edge(burgers, ahead);
            for radius in [2.0, 50.0] {
                // The circuit leaves out the jump: steps larger than half of it are the jump itself.
                let point = |n: i32| {
                    let angle = (f64::from(n) + 0.5) * std::f64::consts::PI / 500.0;
                    [3.0 + radius * angle.cos(), -2.0 + radius * angle.sin()]
                };
                let mut sum = [0.0; 2];
                let half = 0.5 * burgers[0].hypot(burgers[1]);
                for n in 0..1000 {
                    let [a, b] = [n, n + 1].map(|n| field.displacement(point(n)));
                    let step = [b[0] - a[0], b[1] - a[1]];
                    if step[0].hypot(step[1]) < half {
                        sum = [sum[0] + step[0], sum[1] + step[1]];
                    }
                }
                let error = (sum[0] - burgers[0]).hypot(sum[1] - burgers[1]);
                assert!(error < 0.02 * half, "{burgers:?} {radius}: {sum:?}");
            }
        }
    }

    /// Strains of the same book, equations 3-43 (stresses) with Hooke's law: e_xx = -b y / (4 pi (1 - nu)) ((3 - 2 nu) x^2 + (1 - 2 nu) y^2)
    /// / r^4, and the dilation e_xx + e_yy = -b (1 - 2 nu) y / (2 pi (1 - nu) r^2).
    #[test]
    fn strains_are_those_of_the_stresses() {
        let (b, nu) = (3.0, 0.3);
        let field = EdgeDislocation {
            position: [0.0; 2],
            burgers: [b, 0.0],
            poisson_ratio: nu,
            cut_ahead: false,
        };
        let h = 1e-4;
        for [x, y] in [[5.0, 7.0], [-6.0, 2.0], [1.0, -20.0], [30.0, 0.5]] {
            let d = |k: usize, direction: [f64; 2]| {
                let at =
                    |s: f64| field.displacement([x + s * direction[0], y + s * direction[1]])[k];
                (at(h) - at(-h)) / (2.0 * h)
            };
            let square: f64 = x * x + y * y;
            let pi = std::f64::consts::PI;
            let xx = -b * y / (4.0 * pi * (1.0 - nu))
                * ((3.0 - 2.0 * nu) * x * x + (1.0 - 2.0 * nu) * y * y)
                / square.powi(2);
            let dilation = -b * (1.0 - 2.0 * nu) * y / (2.0 * pi * (1.0 - nu) * square);
            let shear = b * x * (x * x - y * y) / (4.0 * pi * (1.0 - nu) * square.powi(2));
            let found = [d(0, [1.0, 0.0]), d(1, [0.0, 1.0])];
            assert!((found[0] - xx).abs() < 1e-7, "{x} {y}: {} {xx}", found[0]);
            assert!((found[0] + found[1] - dilation).abs() < 1e-7);
            let found = 0.5 * (d(0, [0.0, 1.0]) + d(1, [1.0, 0.0]));
            assert!((found - shear).abs() < 1e-7, "{x} {y}: {found} {shear}");
        }
    }

    #[test]
    fn the_side_of_the_jump_is_a_shift_of_one_half() {
        let at = [10.0, 5.0];
        let [behind, ahead] = [false, true].map(|cut| edge([3.0, 0.0], cut).displacement(at));
        assert!(((behind[0] - ahead[0]).abs() - 1.5).abs() < 1e-12);
        assert!((behind[1] - ahead[1]).abs() < 1e-12);
    }
}
