//! Makes a recipe from a file of atoms alone.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use super::atoms_table::AtomsTable;
use super::resolved_recipe::Recipe;
use super::tables::{Field, PhononTable};
use crate::error::Result;
use crate::lengths;
use crate::structure::{Format, LabelledAtoms, Sigmas, elements, sigmas_of_file};

/// Edge of a pixel in nm.
const PIXEL_NM: f64 = 0.02;
/// Edge of a tile in pixels, and number of pixels that neighbours share.
const TILE_PX: usize = 128;
const OVERLAP_PX: usize = 4;
/// Least width of vacuum about the atoms in nm, so that the image shows the columns at the edge completely.
const MARGIN_NM: f64 = 0.25;
/// Space behind the last atom for its potential, in nm.
const BEHIND_NM: f64 = 0.2;
/// Number of phonon configurations if the file gives displacements.
const CONFIGURATIONS: usize = 8;
/// Greatest length of an id.
const LONGEST_ID: usize = 64;

impl Recipe {
    /// Makes a recipe for the atoms of a file: the field holds all of them, in whole tiles of 128 pixels of 0.02 nm; 200 kV, 21 mrad, 68 to
    /// 200 mrad, 1e4 electrons per square Angstrom. Atoms vibrate as a CIF states, and not at all if the file states nothing.
    ///
    /// # Errors
    /// Errors of the file.
    pub(crate) fn of_atoms_file(path: &Path) -> Result<Self> {
        let mut table = AtomsTable::new(&path.display().to_string());
        table.find(Path::new(""))?;
        let atoms = table.atoms(Path::new(""))?;
        let field = field_of(&atoms);
        let phonons = phonons_of(path, &atoms);
        let text = text_of(&id_of(path), &field, &phonons);
        let mut recipe = Recipe::from_toml_str(&path.display().to_string(), &text, None)?;
        recipe.atoms = Some(table);
        // The text was not written by a user, so errors name keys and not lines.
        recipe.origin.text = None;
        Ok(recipe)
    }
}

/// Makes an id from the name of the file without its ending.
fn id_of(path: &Path) -> String {
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let id: String = name.chars().map(plain).take(LONGEST_ID).collect();
    if id.is_empty() { "atoms".into() } else { id }
}

fn field_of(atoms: &LabelledAtoms) -> Field {
    let extent = atoms.extent().map(|[low, high]| lengths::nm(high - low));
    let stride = TILE_PX - OVERLAP_PX;
    let tiles = |nm: f64| {
        let pixels = ((nm + 2.0 * MARGIN_NM) / PIXEL_NM).ceil() + 1.0;
        (((pixels - OVERLAP_PX as f64) / stride as f64).ceil() as usize).max(1)
    };
    let grid = [tiles(extent[1]), tiles(extent[0])];
    Field {
        fov_nm: grid.map(|n| PIXEL_NM * (n * stride + OVERLAP_PX) as f64),
        grid,
        crop: None,
        tile_px: TILE_PX,
        overlap_px: OVERLAP_PX,
        thickness_nm: ((extent[2] + BEHIND_NM) * 1e3).ceil() * 1e-3,
    }
}

fn phonons_of(path: &Path, atoms: &LabelledAtoms) -> PhononTable {
    let cif = Format::from_path(path).is_ok_and(|format| format == Format::Cif);
    let stated = if cif { sigmas_of_file(path).ok() } else { None };
    let symbols = atoms.elements();
    let of = |sigmas: &Sigmas| -> Option<BTreeMap<String, f64>> {
        let sigma = |symbol: &String| sigmas.of(elements::atomic_number(symbol).ok()?).ok();
        symbols.iter().map(|symbol| Some((symbol.clone(), sigma(symbol)?))).collect()
    };
    match stated.and_then(|file| of(&file.sigmas)) {
        Some(sigma_angstrom) => {
            PhononTable { configurations: CONFIGURATIONS, library_seed: 0, sigma_angstrom }
        }
        None => {
            let still = symbols.iter().map(|symbol| (symbol.clone(), 0.0)).collect();
            PhononTable { configurations: 1, library_seed: 0, sigma_angstrom: still }
        }
    }
}

fn text_of(id: &str, field: &Field, phonons: &PhononTable) -> String {
    let mut text = format!("version = 1\nid = \"{id}\"\nstructure = \"atoms\"\nseed = 1\n");
    let Field { fov_nm, grid, tile_px, overlap_px, thickness_nm, .. } = field;
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "[field]\nfov_nm = {fov_nm:?}\ngrid = {grid:?}\ntile_px = {tile_px}\noverlap_px = {overlap_px}\n\
         thickness_nm = {thickness_nm:?}\n[phonons]\nconfigurations = {}\n[phonons.sigma_angstrom]\n",
        phonons.configurations
    );
    for (symbol, sigma) in &phonons.sigma_angstrom {
        let _ = writeln!(text, "{symbol} = {sigma:?}");
    }
    text + "[optics]\nenergy_kv = 200.0\nconvergence_mrad = 21.0\n[detector]\ninner_mrad = 68.0\nouter_mrad = 200.0\n\
            [dose]\nelectrons_per_angstrom2 = 1e4\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_holds_all_atoms_in_whole_tiles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two atoms.xyz");
        let rows = "2\nLattice=\"60 0 0 0 9 0 0 0 20\"\nSi 1 1 1\nO 51 2 11\n";
        std::fs::write(&path, rows).unwrap();
        let recipe = Recipe::from_file(&path, None).unwrap().checked().unwrap();
        assert_eq!((recipe.id.as_str(), recipe.field.grid), ("two_atoms", [1, 3]));
        assert!(recipe.field.fov_nm[1] > 5.0 && (recipe.field.pixel_nm() - PIXEL_NM).abs() < 1e-12);
        assert!((recipe.field.thickness_nm - 1.2).abs() < 1e-9);
        let notes = recipe.notes().unwrap();
        assert!(notes.len() == 1 && notes[0].contains("no atom vibrates"), "{notes:?}");
        let again = Recipe::from_toml_str("again", &recipe.to_toml(), None).unwrap();
        assert_eq!(again, *recipe.recipe());
        assert!(Recipe::tiers_of_file(&path).unwrap().is_empty());
    }
}
