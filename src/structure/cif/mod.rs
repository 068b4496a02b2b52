//! Crystallographic Information Files: cell, symmetry operations and sites.
//!
//! Cell vector a lies along x and b in the xy plane.

mod anisotropic_sites;
mod atom_labels;
mod atom_tables;
mod cartesian_sites;
mod cif_numbers;
mod disorder;
mod displacements;
mod formula_check;
mod group_operations;
mod symmetry;
mod tokens;

use std::collections::BTreeMap;

use super::lattice::{Mat3, Vec3, norm, row_times, wrap_unit};
use super::read::FileSigmas;
use super::source_text::SourceText;
use super::{Atom, Sigmas, Structure};
use crate::error::Result;
use atom_tables::{CifSite, holds_atoms, sites};
use cif_numbers::with_uncertainty;
use disorder::DisorderGroups;
use symmetry::Operation;
use tokens::DataBlock;

/// Images nearer than this fraction of the cell in every coordinate count as one atom ...
const SAME_FRACTION: f64 = 1e-3;
/// ... and so do images nearer than this, in Angstrom.
const SAME_DISTANCE: f64 = 0.01;
/// Largest number of atoms that symmetry may produce: a small file can announce any number.
const MOST_ATOMS: usize = 4_000_000;

/// Reads the one data block that has atoms. The second value of the result are warnings about the file.
pub(super) fn parse(text: &SourceText) -> Result<(Structure, Vec<String>)> {
    let blocks = tokens::blocks(text)?;
    let block = block_of_atoms(text, &blocks)?;
    let mut notes = Vec::new();
    let cell = cell(text, block)?;
    let operations = group_operations::operations(text, block, &cell, &mut notes)?;
    let formula = formula_check::formula(block);
    let sites = sites(text, block, &cell, formula.as_ref(), &mut notes)?;
    let count = sites.len().saturating_mul(operations.len());
    text.check_count_to(block.line, count, MOST_ATOMS)?;
    // Faults of displacements are reported where displacements are asked for.
    let tensors = anisotropic_sites::tensors(text, block, &cell, &sites).unwrap_or_default();
    let mut groups = DisorderGroups::of(&sites, &mut notes);
    let (mut atoms, mut counts, mut composition) = (Vec::new(), Vec::new(), BTreeMap::new());
    for (index, site) in sites.iter().enumerate() {
        let images = images(site, &operations, &cell);
        counts.push(images.len());
        *composition.entry(site.atom.number).or_insert(0.0) +=
            site.atom.occupancy * images.len() as f64;
        for (operation, image) in images {
            let position = row_times(image, &cell);
            let alternative = groups.alternative(index, operation);
            let tensor = tensors.get(index).copied().flatten();
            let displacement = tensor.and_then(|t| t.displacement(&operations[operation], &cell));
            atoms.push((site.line, Atom { position, alternative, displacement, ..site.atom }));
        }
    }
    notes.extend(formula_check::composition_note(block, &composition));
    notes.extend(formula_check::multiplicity_note(&sites, &counts));
    let structure = text.finish(cell, atoms)?;
    Ok((structure, notes))
}

/// Returns the displacements of the atoms: by element where atoms have no tensor of their own.
pub(super) fn displacements(text: &SourceText) -> Result<FileSigmas> {
    let blocks = tokens::blocks(text)?;
    let block = block_of_atoms(text, &blocks)?;
    let cell = cell(text, block)?;
    let formula = formula_check::formula(block);
    let sites = sites(text, block, &cell, formula.as_ref(), &mut Vec::new())?;
    let tensors = anisotropic_sites::tensors(text, block, &cell, &sites)?;
    let note = anisotropic_sites::unusable(text, &cell, &sites, &tensors)?;
    let by_element = displacements::displacements(text, block, &cell, &sites, &tensors)?;
    Ok(FileSigmas { sigmas: Sigmas::OfAtoms(by_element), notes: note.into_iter().collect() })
}

fn block_of_atoms<'b, 'a>(
    text: &SourceText,
    blocks: &'b [DataBlock<'a>],
) -> Result<&'b DataBlock<'a>> {
    let mut with_atoms = blocks.iter().filter(|b| holds_atoms(b));
    let Some(block) = with_atoms.next() else {
        let message = "no data block has a loop with _atom_site_fract_x, _y and _z (or with _atom_site_Cartn_x, _y and _z)";
        return Err(text.error(0, message));
    };
    if let Some(second) = with_atoms.next() {
        let message = format!(
            "data block `{}` is the second with atoms, after `{}`; keep only the one to simulate",
            second.name, block.name
        );
        return Err(text.error(second.line, message));
    }
    Ok(block)
}

/// Returns the cell in the standard orientation.
fn cell(text: &SourceText, block: &DataBlock) -> Result<Mat3> {
    let get = |tag: &str| -> Result<(usize, f64)> {
        let Some((line, word)) = block.get(&[tag]) else {
            return Err(text.error(block.line, format!("`{tag}` is missing")));
        };
        Ok((line, with_uncertainty(text, line, tag, word)?))
    };
    let (line, a) = get("_cell_length_a")?;
    let (b, c) = (get("_cell_length_b")?.1, get("_cell_length_c")?.1);
    for (tag, length) in ["a", "b", "c"].iter().zip([a, b, c]) {
        if length <= 0.0 {
            let message = format!("_cell_length_{tag} is {length}, expected a length in A");
            return Err(text.error(line, message));
        }
    }
    let mut cosines = [0.0; 3];
    for (cosine, tag) in
        cosines.iter_mut().zip(["_cell_angle_alpha", "_cell_angle_beta", "_cell_angle_gamma"])
    {
        let (line, degrees) = get(tag)?;
        if !(1.0..=179.0).contains(&degrees) {
            let message = format!("{tag} is {degrees}, expected degrees between 1 and 179");
            return Err(text.error(line, message));
        }
        *cosine = cos_degrees(degrees);
    }
    let [alpha, beta, gamma] = cosines;
    let sine = (1.0 - gamma * gamma).sqrt();
    let across = (alpha - beta * gamma) / sine;
    let height = 1.0 - beta * beta - across * across;
    if height <= 0.0 {
        let message = "no cell has these three angles";
        return Err(text.error(get("_cell_angle_alpha")?.0, message));
    }
    let cell =
        [[a, 0.0, 0.0], [b * gamma, b * sine, 0.0], [c * beta, c * across, c * height.sqrt()]];
    text.check_cell(line, &cell)?;
    Ok(cell)
}

/// Returns the cosine, exact where it is a rational number.
fn cos_degrees(degrees: f64) -> f64 {
    match degrees {
        60.0 => 0.5,
        90.0 => 0.0,
        120.0 => -0.5,
        _ => libm::cos(degrees.to_radians()),
    }
}

/// Returns the distinct images of a site in the cell, as fractions in [0, 1), each with the number of its operation.
fn images(site: &CifSite, operations: &[Operation], cell: &Mat3) -> Vec<(usize, Vec3)> {
    // In a file that lists all atoms, the atoms keep their positions.
    if operations.len() == 1 {
        return vec![(0, site.atom.position)];
    }
    let mut images: Vec<(usize, Vec3)> = Vec::new();
    for (number, operation) in operations.iter().enumerate() {
        let image = operation.apply(site.atom.position).map(wrap_unit);
        if !images.iter().any(|(_, other)| same_place(image, *other, cell)) {
            images.push((number, image));
        }
    }
    images
}

fn same_place(a: Vec3, b: Vec3, cell: &Mat3) -> bool {
    let d: Vec3 = std::array::from_fn(|i| {
        let d = a[i] - b[i];
        d - d.round()
    });
    d.iter().all(|x| x.abs() < SAME_FRACTION) || norm(row_times(d, cell)) < SAME_DISTANCE
}

#[cfg(test)]
mod tests {
    use super::super::read::{Format, parse as parse_format};
    use super::*;
    use std::path::Path;

    #[test]
    fn the_cell_stands_in_the_standard_orientation() {
        let body = "data_t\n_cell_length_a 5.0(1)\n_cell_length_b 6\n_cell_length_c 7\n\
                    _cell_angle_alpha 80\n_cell_angle_beta 95\n_cell_angle_gamma 110\nloop_\n\
                    _atom_site_label\n_atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n\
                    Si1 0.5 0.25 0\n";
        let s = parse_format(Format::Cif, body.as_bytes(), Path::new("t.cif")).unwrap();
        let angle = |i: usize, j: usize| {
            let (a, b) = (s.cell[i], s.cell[j]);
            (super::super::lattice::dot(a, b) / norm(a) / norm(b)).acos().to_degrees()
        };
        assert_eq!(s.cell[0], [5.0, 0.0, 0.0]);
        for (got, expected) in [(angle(1, 2), 80.0), (angle(0, 2), 95.0), (angle(0, 1), 110.0)] {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
        assert!((norm(s.cell[2]) - 7.0).abs() < 1e-12);
    }
}
