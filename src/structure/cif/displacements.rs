//! Thermal displacements that a CIF lists: U or B of each site.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::{COORDINATES, sites, with_uncertainty};
use crate::error::Result;
use crate::structure::cif::tokens::{self, Loop};
use crate::structure::source_text::SourceText;

const U: &str = "_atom_site_u_iso_or_equiv";
const B: &str = "_atom_site_b_iso_or_equiv";
const LABEL: &str = "_atom_site_label";
const ANISOTROPIC_LABEL: &str = "_atom_site_aniso_label";
const ANISOTROPIC: [[&str; 3]; 2] = [
    ["_atom_site_aniso_u_11", "_atom_site_aniso_u_22", "_atom_site_aniso_u_33"],
    ["_atom_site_aniso_b_11", "_atom_site_aniso_b_22", "_atom_site_aniso_b_33"],
];

/// The standard deviation of each Cartesian component in Angstrom, by element: the root of the mean U of its sites. Sites without a
/// value of their own take a third of the trace of their anisotropic one, which is exact in cells with right angles.
pub fn displacements(text: &SourceText) -> Result<BTreeMap<u8, f64>> {
    let blocks = tokens::blocks(text)?;
    let table = |block: &tokens::DataBlock| block.table(&COORDINATES).is_some();
    let Some(block) = blocks.iter().find(|b| table(b)) else {
        return Err(text.error(0, "no data block has a loop of atoms"));
    };
    let Some(table) = block.table(&COORDINATES) else { return Ok(BTreeMap::new()) };
    let anisotropic = block.table(&[ANISOTROPIC_LABEL]);
    let mut means: BTreeMap<u8, (f64, usize)> = BTreeMap::new();
    for site in sites(text, table)? {
        let Some(row) = table.rows().find(|r| r[0].line == site.line) else { continue };
        let value = |tag: &str| table.column(&[tag]).and_then(|c| row[c].known());
        let u = match (value(U), value(B)) {
            (Some(u), _) => Some(with_uncertainty(text, site.line, U, u)?),
            (None, Some(b)) => Some(of_b(with_uncertainty(text, site.line, B, b)?)),
            (None, None) => match (anisotropic, value(LABEL)) {
                (Some(table), Some(label)) => of_trace(text, table, label)?,
                _ => None,
            },
        };
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

/// U of B: B = 8 pi^2 U.
fn of_b(b: f64) -> f64 {
    b / (8.0 * PI * PI)
}

fn of_trace(text: &SourceText, table: &Loop, label: &str) -> Result<Option<f64>> {
    let labels = table.column(&[ANISOTROPIC_LABEL]);
    let row = table.rows().find(|r| labels.and_then(|c| r[c].known()) == Some(label));
    let Some(row) = row else { return Ok(None) };
    for (tags, convert) in ANISOTROPIC.iter().zip([std::convert::identity as fn(f64) -> f64, of_b])
    {
        let mut trace = Some(0.0);
        for tag in tags {
            let word = table.column(&[tag]).and_then(|c| row[c].known());
            trace = match (trace, word) {
                (Some(sum), Some(word)) => {
                    Some(sum + with_uncertainty(text, row[0].line, tag, word)?)
                }
                _ => None,
            };
        }
        if let Some(trace) = trace {
            return Ok(Some(convert(trace / 3.0)));
        }
    }
    Ok(None)
}
