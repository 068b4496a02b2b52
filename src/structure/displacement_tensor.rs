//! Thermal displacements that differ with the direction.

use super::lattice::{Mat3, determinant};
use super::site::LARGEST_SIGMA_ANGSTROM;
use crate::error::{Error, Result};
use crate::setting::Setting;
use std::f64::consts::PI;

/// Places of the six components in the matrix.
const COMPONENTS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];
/// Differences of components below this share of the trace are rounding.
const ROUNDING: f64 = 1e-9;
/// Principal values down to this share of the trace below 0 count as 0: files round their components.
const LEAST_PRINCIPAL: f64 = -1e-6;

/// Mean square displacements of an atom, `U_ij = <u_i u_j>` in square Angstrom, on the axes x, y and z.
///
/// K. N. Trueblood et al., Acta Cryst. A 52 (1996) 770, describes the notations and their conversion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacementTensor {
    components: [f64; 6],
}

/// Converts three independent normal numbers to a displacement with the covariance of a tensor, in units of the tensor's root mean square:
/// the lower triangle of the Cholesky factor of `3 U / trace U`, row by row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anisotropy([f32; 6]);

impl DisplacementTensor {
    /// Makes a tensor from its matrix in square Angstrom.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a matrix that is not symmetric, with a negative principal value, or with one above 1 square Angstrom.
    pub fn new(u: [[f64; 3]; 3]) -> Result<Self> {
        match fault(&u) {
            None => Ok(Self::of_symmetric(&u)),
            Some(expected) => Err(Error::invalid(Setting::Displacements, rows(&u), expected)),
        }
    }

    /// Makes a tensor from a matrix without [`fault`].
    pub(super) fn of_symmetric(u: &Mat3) -> Self {
        DisplacementTensor { components: COMPONENTS.map(|[i, j]| 0.5 * (u[i][j] + u[j][i])) }
    }

    /// Returns the matrix in square Angstrom.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        let mut matrix = [[0.0; 3]; 3];
        for ([i, j], value) in COMPONENTS.into_iter().zip(self.components) {
            (matrix[i][j], matrix[j][i]) = (value, value);
        }
        matrix
    }

    /// Returns a third of the trace: the equivalent isotropic value in square Angstrom.
    fn mean(&self) -> f64 {
        let [xx, yy, zz, ..] = self.components;
        (xx + yy + zz) / 3.0
    }

    /// Returns the tensor without its isotropic part.
    fn deviation(&self) -> Mat3 {
        let (mut matrix, mean) = (self.matrix(), self.mean());
        (0..3).for_each(|i| matrix[i][i] -= mean);
        matrix
    }

    /// Returns the root mean square displacement along an axis in Angstrom, averaged over all directions.
    pub fn sigma_angstrom(&self) -> f64 {
        self.mean().max(0.0).sqrt()
    }

    /// Returns the tensor of an atom that is turned with its surroundings; the rows of `rotation` are the new axes in the old frame.
    pub(super) fn turned(&self, rotation: &Mat3) -> Self {
        // The isotropic part has no direction: an isotropic tensor keeps its bits.
        let mut matrix = sandwich(rotation, &self.deviation());
        (0..3).for_each(|i| matrix[i][i] += self.mean());
        Self::of_symmetric(&matrix)
    }

    /// Returns the dependence on the direction; `None` if all directions are alike.
    pub(super) fn anisotropy(&self) -> Option<Anisotropy> {
        let mean = self.mean();
        let largest = self.deviation().as_flattened().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        if largest <= ROUNDING * 3.0 * mean {
            return None;
        }
        let u = self.matrix().map(|row| row.map(|x| x / mean));
        let mut root = [[0.0; 3]; 3];
        for j in 0..3 {
            let pivot = u[j][j] - (0..j).map(|k| root[j][k] * root[j][k]).sum::<f64>();
            // No displacement is left in this direction.
            if pivot <= ROUNDING {
                continue;
            }
            root[j][j] = pivot.sqrt();
            for i in j + 1..3 {
                let known: f64 = (0..j).map(|k| root[i][k] * root[j][k]).sum();
                root[i][j] = (u[i][j] - known) / root[j][j];
            }
        }
        let lower = [[0, 0], [1, 0], [1, 1], [2, 0], [2, 1], [2, 2]];
        Some(Anisotropy(lower.map(|[i, j]: [usize; 2]| root[i][j] as f32)))
    }
}

impl Anisotropy {
    /// Returns the displacement of three independent normal numbers, in units of the root mean square.
    pub(crate) fn displacement(&self, n: [f64; 3]) -> [f64; 3] {
        let [xx, yx, yy, zx, zy, zz] = self.0.map(f64::from);
        [xx * n[0], yx * n[0] + yy * n[1], zx * n[0] + zy * n[1] + zz * n[2]]
    }

    /// Returns the tensor for a root mean square displacement, in its square unit.
    pub(crate) fn tensor(&self, sigma: f64) -> [[f64; 3]; 3] {
        let columns =
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|n| self.displacement(n));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| columns.iter().map(|c| sigma * sigma * c[i] * c[j]).sum())
        })
    }

    /// Returns the components as they are stored.
    pub fn components(&self) -> [f32; 6] {
        self.0
    }
}

/// Returns what is wrong with a tensor in square Angstrom.
pub(super) fn fault(u: &Mat3) -> Option<String> {
    let size = u.as_flattened().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    if !u.as_flattened().iter().all(|x| x.is_finite()) {
        return Some("expected finite numbers".into());
    }
    if COMPONENTS.iter().any(|&[i, j]| (u[i][j] - u[j][i]).abs() > 1e-6 * size) {
        return Some("expected a symmetric matrix".into());
    }
    let [least, _, most] = principal_values(u);
    let largest = LARGEST_SIGMA_ANGSTROM * LARGEST_SIGMA_ANGSTROM;
    if most > largest {
        return Some(format!(
            "its largest principal value is {most:.4} square Angstrom, expected at most {largest}"
        ));
    }
    let trace = u[0][0] + u[1][1] + u[2][2];
    (least < LEAST_PRINCIPAL * trace.abs() || trace < 0.0).then(|| {
        format!("its smallest principal value is {least:.6} square Angstrom, expected none below 0")
    })
}

/// Returns the eigenvalues of a symmetric matrix, the smallest first.
pub(super) fn principal_values(u: &Mat3) -> [f64; 3] {
    let mean = (u[0][0] + u[1][1] + u[2][2]) / 3.0;
    let mut rest = *u;
    (0..3).for_each(|i| rest[i][i] -= mean);
    let size = (rest.as_flattened().iter().map(|x| x * x).sum::<f64>() / 6.0).sqrt();
    if size == 0.0 {
        return [mean; 3];
    }
    let half = 0.5 * determinant(&rest.map(|row| row.map(|x| x / size)));
    let turn = libm::acos(half.clamp(-1.0, 1.0)) / 3.0;
    [2.0, 4.0, 0.0].map(|thirds| mean + 2.0 * size * libm::cos(turn + thirds * PI / 3.0))
}

/// Returns `m u m^T`.
pub(super) fn sandwich(m: &Mat3, u: &Mat3) -> Mat3 {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let along = |k: usize| (0..3).map(|l| u[k][l] * m[j][l]).sum::<f64>();
            (0..3).map(|k| m[i][k] * along(k)).sum()
        })
    })
}

fn rows(u: &Mat3) -> String {
    let row = |r: &[f64; 3]| format!("[{}, {}, {}]", r[0], r[1], r[2]);
    format!("[{}]", u.iter().map(row).collect::<Vec<_>>().join(", "))
}
