//! Limits of a recipe for the atoms of a file.

use super::atoms_table::NO_CRYSTAL;
use super::fault::{Checked, crystal_fault, fault, needed, within};
use super::oriented_crystals::OrientedCrystals;
use super::resolved_recipe::Recipe;
use crate::lengths;
use crate::structure::LabelledAtoms;

/// Largest empty space of a specimen behind its last atom, in nm.
const MOST_BEHIND_NM: f64 = 100.0;
/// Greatest thickness of a specimen in nm.
const THICKEST_NM: f64 = 1000.0;
/// Components of cell vectors below this, in Angstrom, count as zero.
const ALONG_AXIS_ANGSTROM: f64 = 1e-4;

/// Checks the table of a file of atoms; returns the atoms, and all elements that the specimen may hold.
pub fn check_atoms(recipe: &Recipe) -> Checked<(OrientedCrystals, Vec<String>)> {
    if recipe.zone_axis != NO_CRYSTAL || recipe.y_axis.is_some() {
        let expected = "the atoms lie as their file says, with the beam along +z; expected no zone_axis and no y_axis";
        return fault("zone_axis", &recipe.zone_axis, expected);
    }
    if recipe.crystal.name != NO_CRYSTAL || recipe.crystal.text.is_some() {
        let expected = "the atoms come from the file of the table [atoms]; expected no crystal";
        return fault("crystal", &recipe.crystal.name, expected);
    }
    let table = needed("atoms", recipe.atoms.as_ref())?;
    if let Some(origin) = table.origin_angstrom {
        origin.iter().try_for_each(|x| within("atoms.origin_angstrom", *x, -1e7, 1e7))?;
    }
    let atoms = table.atoms(&recipe.origin.folder).map_err(|e| crystal_fault("atoms.file", e))?;
    check_thickness(recipe.field.thickness_nm, &atoms)?;
    if table.repeat {
        check_cell(&atoms)?;
    }
    let symbols = atoms.elements();
    if symbols.is_empty() {
        return fault(
            "atoms.file",
            &table.file,
            "expected an atom; all sites of the file are vacant",
        );
    }
    Ok((OrientedCrystals::Atoms(atoms), symbols))
}

fn check_thickness(thickness_nm: f64, atoms: &LabelledAtoms) -> Checked {
    let [_, _, [first, last]] = atoms.extent();
    let extent = lengths::nm(last - first);
    if extent > THICKEST_NM {
        let expected = format!(
            "the atoms reach over {extent:.1} nm along the beam, expected at most {THICKEST_NM}"
        );
        return fault("atoms.file", "(too thick)", expected);
    }
    // Positions are only as exact as the digits of their file.
    if !(extent - 1e-6..=extent + MOST_BEHIND_NM).contains(&thickness_nm) || thickness_nm <= 0.0 {
        let expected = format!(
            "expected {extent:.4} nm, the extent of the atoms along the beam, or up to {MOST_BEHIND_NM} nm more"
        );
        return fault("field.thickness_nm", thickness_nm, expected);
    }
    Ok(())
}

/// Checks that the cell can be repeated along x and y.
fn check_cell(atoms: &LabelledAtoms) -> Checked {
    let [a, b, _] = atoms.cell;
    let beside = [a[1], a[2], b[0], b[2]];
    if a[0] <= 0.0 || b[1] <= 0.0 || beside.iter().any(|c| c.abs() > ALONG_AXIS_ANGSTROM) {
        let expected = format!(
            "expected a cell whose first two vectors lie along x and y, not {a:?} and {b:?} A; orthogonalise the cell, or leave \
             repeat out"
        );
        return fault("atoms.repeat", true, expected);
    }
    Ok(())
}
