//! Reads Cartesian coordinates of a CIF in Angstrom, and their frame.

use super::cif_numbers::with_uncertainty;
use super::tokens::DataBlock;
use crate::error::Result;
use crate::structure::displacement_tensor::sandwich;
use crate::structure::lattice::{Mat3, Vec3, inverse, row_times, subtract};
use crate::structure::source_text::SourceText;

/// Columns of Cartesian coordinates.
pub const CARTESIAN: [&str; 3] = ["_atom_site_cartn_x", "_atom_site_cartn_y", "_atom_site_cartn_z"];

/// Converts Cartesian coordinates to fractions of the cell: `fraction = (position - origin) * matrix`, as row vectors.
pub struct CartesianFrame {
    origin: Vec3,
    matrix: Mat3,
}

impl CartesianFrame {
    /// Returns the frame that the file gives as a matrix (`_atom_sites_Cartn_tran_matrix_11` and so on; in mmCIF
    /// `_atom_sites.fract_transf_matrix[1][1]`). Without a matrix, a lies along x and b in the plane of x and y.
    pub fn of(
        text: &SourceText,
        block: &DataBlock,
        cell: &Mat3,
        notes: &mut Vec<String>,
    ) -> Result<Self> {
        let entry = |name: String| -> Result<Option<f64>> {
            let Some((line, word)) = block.get(&[&name]) else { return Ok(None) };
            with_uncertainty(text, line, &name, word).map(Some)
        };
        let to_cartesian =
            |i: usize, j: usize| entry(format!("_atom_sites_cartn_tran_matrix_{}{}", i + 1, j + 1));
        let to_fraction = |i: usize, j: usize| {
            entry(format!("_atom_sites_fract_transf_matrix[{}][{}]", i + 1, j + 1))
        };
        let standard = inverse(cell).unwrap_or_default();
        let frame = if let Some(rows) = matrix(to_cartesian)? {
            let origin = vector(|i| entry(format!("_atom_sites_cartn_tran_vector_{}", i + 1)))?;
            let Some(matrix) = inverse(&transposed(rows)) else {
                let message = "the matrix _atom_sites_Cartn_tran_matrix has no inverse";
                return Err(text.error(block.line, message));
            };
            CartesianFrame { origin, matrix }
        } else if let Some(rows) = matrix(to_fraction)? {
            let shift = vector(|i| entry(format!("_atom_sites_fract_transf_vector[{}]", i + 1)))?;
            let matrix = transposed(rows);
            let origin = inverse(&matrix).map(|back| row_times(shift.map(|x| -x), &back));
            CartesianFrame { origin: origin.unwrap_or_default(), matrix }
        } else {
            CartesianFrame { origin: [0.0; 3], matrix: standard }
        };
        let turned = frame.matrix.iter().flatten().zip(standard.iter().flatten());
        if turned.into_iter().any(|(a, b)| (a - b).abs() > 1e-3) {
            notes.push(
                "Cartesian coordinates were turned into the cell by the matrix of the file".into(),
            );
        } else if frame.matrix == standard
            && block.get(&["_atom_sites_cartn_transform_axes"]).is_some()
        {
            notes.push(
                "Cartesian coordinates were read with a along x and b in the xy plane; check \
                 _atom_sites_Cartn_transform_axes"
                    .into(),
            );
        }
        Ok(frame)
    }

    /// Returns the fractions of the cell of a Cartesian position in Angstrom.
    pub fn fractions(&self, position: Vec3) -> Vec3 {
        row_times(subtract(position, self.origin), &self.matrix)
    }

    /// Returns the components along the vectors of the cell of a tensor with these Cartesian components.
    pub fn tensor_along_cell(&self, u: &Mat3) -> Mat3 {
        sandwich(&transposed(self.matrix), u)
    }
}

fn matrix(entry: impl Fn(usize, usize) -> Result<Option<f64>>) -> Result<Option<Mat3>> {
    let mut found = [[0.0; 3]; 3];
    for (i, row) in found.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            match entry(i, j)? {
                Some(number) => *value = number,
                None => return Ok(None),
            }
        }
    }
    Ok(Some(found))
}

fn vector(entry: impl Fn(usize) -> Result<Option<f64>>) -> Result<Vec3> {
    let mut found = [0.0; 3];
    for (i, value) in found.iter_mut().enumerate() {
        *value = entry(i)?.unwrap_or(0.0);
    }
    Ok(found)
}

fn transposed(m: Mat3) -> Mat3 {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}
