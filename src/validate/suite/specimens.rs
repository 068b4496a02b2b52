//! Specimens of the cases.

use crate::engine::{Phonons, Scan, Site};
use crate::structure::crystals;
use crate::{Result, engine::Settings};

/// Lattice parameter of SrTiO3 in Angstrom.
pub const SRTIO3_ANGSTROM: f64 = 3.905;

/// Returns `cells` unit cells of SrTiO3 along \[001\], the first plane a quarter cell below the surface, with the thermal displacements of
/// the worlds; and the edges of the box in Angstrom.
///
/// # Errors
/// An error if the crystal cannot be repeated.
pub fn srtio3(cells: [usize; 3]) -> Result<(Vec<Site>, [f64; 3])> {
    let crystal = crystals::crystal("srtio3")?.repeat(cells)?;
    let size = crystal.orthogonal_box()?;
    let site = |(key, atom): (usize, &crate::structure::Atom)| {
        let [x, y, z] = atom.position;
        let sigma_angstrom = match atom.number {
            38 => 0.084,
            22 => 0.060,
            _ => 0.085,
        };
        let position = [x, y, (z + 0.25 * SRTIO3_ANGSTROM).rem_euclid(size[2])];
        Site { position, number: atom.number, sigma_angstrom, anisotropy: None, key: key as u64 }
    };
    Ok((crystal.atoms.iter().enumerate().map(site).collect(), size))
}

/// Returns a scan of `n` x `n` probes over one unit cell, one cell from the corner.
pub fn unit_cell(n: usize) -> Scan {
    Scan {
        origin_angstrom: [SRTIO3_ANGSTROM; 2],
        step_angstrom: [SRTIO3_ANGSTROM / n as f64; 2],
        shape: [n, n],
    }
}

/// Returns our default settings with one configuration of displaced atoms.
pub fn displaced(seed: u64) -> Settings {
    Settings { phonons: Some(Phonons { configurations: 1, seed }), ..Settings::default() }
}
