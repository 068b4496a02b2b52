//! Reads the thermal displacements in a CIF: U or B of each site.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::anisotropic_sites::SiteTensor;
use super::atom_tables::CifSite;
use super::cif_numbers::with_uncertainty;
use super::tokens::{DataBlock, Loop};
use crate::error::Result;
use crate::structure::lattice::{Mat3, dot, inverse, norm};
use crate::structure::source_text::SourceText;

const U: &str = "_atom_site_u_iso_or_equiv";
const B: &str = "_atom_site_b_iso_or_equiv";
const ANISOTROPIC_LABEL: &str = "_atom_site_aniso_label";
/// Components of a symmetric tensor, in the order of the columns.
pub const COMPONENTS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];

/// Notation of an anisotropic displacement.
#[derive(Clone, Copy)]
pub enum Notation {
    /// U in square Angstrom, on the reciprocal axes.
    U,
    /// B = 8 pi^2 U.
    B,
    /// beta_ij = 2 pi^2 a*_i a*_j U_ij.
    Beta,
}

impl Notation {
    pub const ALL: [(Self, &str); 3] = [(Self::U, "u"), (Self::B, "b"), (Self::Beta, "beta")];

    /// Returns the contribution of a component of value 1 to U on the axes of the cell: `U_ij a*_i a*_j`.
    pub fn scale(self, reciprocal: [f64; 2]) -> f64 {
        match self {
            Notation::U => reciprocal[0] * reciprocal[1],
            Notation::B => reciprocal[0] * reciprocal[1] / (8.0 * PI * PI),
            Notation::Beta => 1.0 / (2.0 * PI * PI),
        }
    }
}

/// Returns the standard deviation of each Cartesian component in Angstrom, by element: the root of the mean U of its sites. Sites without
/// an isotropic value take the equivalent one of their anisotropic displacement, which is one of `tensors` if it is complete.
pub fn displacements(
    text: &SourceText,
    block: &DataBlock,
    cell: &Mat3,
    sites: &[CifSite],
    tensors: &[Option<SiteTensor>],
) -> Result<BTreeMap<u8, f64>> {
    let anisotropic = block.tables(&[ANISOTROPIC_LABEL]);
    let mut means: BTreeMap<u8, (f64, usize)> = BTreeMap::new();
    for (site, tensor) in sites.iter().zip(tensors) {
        let u = match (site.value(&[U]), site.value(&[B])) {
            (Some(u), _) => Some(with_uncertainty(text, site.line, U, u)?),
            (None, Some(b)) => Some(of_b(with_uncertainty(text, site.line, B, b)?)),
            (None, None) => match site.label() {
                Some(label) => equivalent(text, &anisotropic, cell, label)?,
                None => None,
            },
        };
        let u = u.or_else(|| tensor.map(|tensor| tensor.mean(cell)));
        let Some(u) = u else {
            let message =
                format!("this atom has neither `{U}` nor `{B}`; give a sigma for each element");
            return Err(text.error(site.line, message));
        };
        if !(0.0..=1.0).contains(&u) {
            return Err(text.error(site.line, format!("U is {u}, expected 0 to 1 square Angstrom")));
        }
        let (sum, count) = means.entry(site.atom.number).or_default();
        *sum += u;
        *count += 1;
    }
    Ok(means.into_iter().map(|(z, (sum, n))| (z, (sum / n as f64).sqrt())).collect())
}

/// Converts B to U: B = 8 pi^2 U.
fn of_b(b: f64) -> f64 {
    b / (8.0 * PI * PI)
}

/// Returns the equivalent isotropic U of a label in square Angstrom: `U_eq = 1/3 sum_ij U_ij a*_i a*_j (a_i . a_j)`, a third of the trace
/// in a Cartesian frame (R. X. Fischer, E. Tillmanns, Acta Cryst. C 44 (1988) 775).
fn equivalent(
    text: &SourceText,
    tables: &[&Loop],
    cell: &Mat3,
    label: &str,
) -> Result<Option<f64>> {
    let found = tables.iter().find_map(|table| {
        let labels = table.column(&[ANISOTROPIC_LABEL])?;
        table.rows().find(|r| r[labels].known() == Some(label)).map(|row| (table, row))
    });
    let Some((table, row)) = found else { return Ok(None) };
    let Some(inverse) = inverse(cell) else { return Ok(None) };
    // The columns of the inverse are the reciprocal vectors.
    let reciprocal = [0, 1, 2].map(|i| norm([inverse[0][i], inverse[1][i], inverse[2][i]]));
    for (notation, letter) in Notation::ALL {
        let mut sum = Some(0.0);
        for [i, j] in COMPONENTS {
            let tag = format!("_atom_site_aniso_{letter}_{}{}", i + 1, j + 1);
            let word = table.column(&[&tag]).and_then(|c| row[c].known());
            let angle = dot(cell[i], cell[j]);
            let twice = if i == j { 1.0 } else { 2.0 };
            sum = match (sum, word) {
                (Some(sum), Some(word)) => {
                    let value = with_uncertainty(text, row[0].line, &tag, word)?;
                    let scale = notation.scale([reciprocal[i], reciprocal[j]]);
                    Some(sum + twice * value * scale * angle)
                }
                // With axes at right angles this component does not contribute, so it may be missing.
                (sum, None) if i != j && angle == 0.0 => sum,
                _ => None,
            };
        }
        if let Some(sum) = sum {
            return Ok(Some(sum / 3.0));
        }
    }
    Ok(None)
}
