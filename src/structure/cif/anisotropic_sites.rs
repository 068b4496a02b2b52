//! Reads the anisotropic displacements in a CIF, and turns them to the images of their sites.

use std::collections::HashMap;
use std::f64::consts::PI;

use super::atom_tables::CifSite;
use super::cartesian_sites::CartesianFrame;
use super::cif_numbers::with_uncertainty;
use super::displacements::{COMPONENTS, Notation};
use super::symmetry::Operation;
use super::tokens::{CifValue, DataBlock, Loop};
use crate::error::Result;
use crate::structure::displacement_tensor::{
    DisplacementTensor, fault, principal_values, sandwich,
};
use crate::structure::lattice::{Mat3, inverse, norm};
use crate::structure::source_text::SourceText;

/// Column of the labels, and of the identifiers of mmCIF.
const LABEL: &str = "_atom_site_aniso_label";
const ID: &str = "_atom_site_anisotrop_id";
/// Components are rounded to this part of a square Angstrom, which removes rounding of the conversion.
const PER_SQUARE_ANGSTROM: f64 = 1e12;

/// The anisotropic displacement of a site: its components `<u^i u^j>` along the vectors of the cell, where the position is a fraction.
#[derive(Debug, Clone, Copy)]
pub struct SiteTensor(Mat3);

impl SiteTensor {
    /// Returns the tensor of the image of the site in square Angstrom, on the axes x, y and z.
    fn image(&self, operation: &Operation, cell: &Mat3) -> Mat3 {
        let along_cell = sandwich(&operation.rotation.map(|row| row.map(f64::from)), &self.0);
        let columns = std::array::from_fn(|i| std::array::from_fn(|j| cell[j][i]));
        sandwich(&columns, &along_cell)
            .map(|row| row.map(|u| (u * PER_SQUARE_ANGSTROM).round() / PER_SQUARE_ANGSTROM))
    }

    /// Returns the displacement of the image of the site; `None` if it cannot be used.
    pub fn displacement(&self, operation: &Operation, cell: &Mat3) -> Option<DisplacementTensor> {
        let u = self.image(operation, cell);
        fault(&u).is_none().then(|| DisplacementTensor::of_symmetric(&u))
    }

    /// Returns a third of the trace in square Angstrom.
    pub fn mean(&self, cell: &Mat3) -> f64 {
        let u = self.image(&Operation::IDENTITY, cell);
        (u[0][0] + u[1][1] + u[2][2]) / 3.0
    }
}

/// Returns the anisotropic displacement of each site that has all six components. Six zeros are no displacement.
pub fn tensors(
    text: &SourceText,
    block: &DataBlock,
    cell: &Mat3,
    sites: &[CifSite],
) -> Result<Vec<Option<SiteTensor>>> {
    let mut rows: HashMap<&str, (&Loop, &[CifValue])> = HashMap::new();
    for key in [ID, LABEL] {
        for table in block.tables(&[key]) {
            let Some(column) = table.column(&[key]) else { continue };
            for row in table.rows() {
                if let Some(name) = row[column].known() {
                    rows.entry(name).or_insert((table, row));
                }
            }
        }
    }
    if rows.is_empty() {
        return Ok(vec![None; sites.len()]);
    }
    let Some(to_fraction) = inverse(cell) else { return Ok(vec![None; sites.len()]) };
    let reciprocal = [0, 1, 2].map(|i| norm([0, 1, 2].map(|k| to_fraction[k][i])));
    let of_site = |site: &CifSite| -> Result<Option<SiteTensor>> {
        let name = [site.label(), site.value(&["_atom_site_id"])];
        let Some((table, row)) = name.into_iter().flatten().find_map(|n| rows.get(n)) else {
            return Ok(None);
        };
        for (notation, letter) in Notation::ALL {
            let tag = |i, j| format!("_atom_site_aniso_{letter}_{}{}", i + 1, j + 1);
            if let Some(mut u) = matrix(text, table, row, tag)? {
                for [i, j] in COMPONENTS {
                    u[i][j] *= notation.scale([reciprocal[i], reciprocal[j]]);
                    u[j][i] = u[i][j];
                }
                return Ok(Some(SiteTensor(u)));
            }
        }
        // The components of mmCIF are along the axes of its Cartesian coordinates.
        for (letter, scale) in [("u", 1.0), ("b", 1.0 / (8.0 * PI * PI))] {
            let tag = |i, j| format!("_atom_site_anisotrop_{letter}[{}][{}]", i + 1, j + 1);
            if let Some(u) = matrix(text, table, row, tag)? {
                let frame = CartesianFrame::of(text, block, cell, &mut Vec::new())?;
                let u = frame.tensor_along_cell(&u.map(|row| row.map(|x| scale * x)));
                return Ok(Some(SiteTensor(u)));
            }
        }
        Ok(None)
    };
    sites.iter().map(of_site).collect()
}

/// Reads a symmetric matrix from a row; `None` if a component is missing or unknown, or if all are zero.
fn matrix(
    text: &SourceText,
    table: &Loop,
    row: &[CifValue],
    tag: impl Fn(usize, usize) -> String,
) -> Result<Option<Mat3>> {
    let mut found = [[0.0; 3]; 3];
    for [i, j] in COMPONENTS {
        let tag = tag(i, j);
        let Some(word) = table.column(&[&tag]).and_then(|c| row[c].known()) else {
            return Ok(None);
        };
        let value = with_uncertainty(text, row[0].line, &tag, word)?;
        (found[i][j], found[j][i]) = (value, value);
    }
    Ok(found.as_flattened().iter().any(|x| *x != 0.0).then_some(found))
}

/// Reports sites whose anisotropic displacement cannot be used.
///
/// # Errors
/// [`crate::Error::Parse`] for a displacement above 1 square Angstrom.
pub fn unusable(
    text: &SourceText,
    cell: &Mat3,
    sites: &[CifSite],
    tensors: &[Option<SiteTensor>],
) -> Result<Option<String>> {
    let mut names = Vec::new();
    for (site, tensor) in sites.iter().zip(tensors) {
        let Some(u) = tensor.map(|tensor| tensor.image(&Operation::IDENTITY, cell)) else {
            continue;
        };
        let [least, _, most] = principal_values(&u);
        match fault(&u) {
            Some(fault) if most > 1.0 => {
                let message = format!("anisotropic displacement of `{}`: {fault}", site.name());
                return Err(text.error(site.line, message));
            }
            Some(_) => names.push(format!("{} ({least:.4})", site.name())),
            None => {}
        }
    }
    Ok((!names.is_empty()).then(|| {
        let count = names.len();
        names.truncate(8);
        let others = if count > 8 { ", ..." } else { "" };
        format!(
            "the anisotropic displacements of {count} sites have a negative principal value (square Angstrom): {}{others}; the mean \
             isotropic displacement of the element is used for them",
            names.join(", ")
        )
    }))
}
