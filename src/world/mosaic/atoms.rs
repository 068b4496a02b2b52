//! The atoms of a world, configuration by configuration.

use super::library::Library;
use crate::engine::Site;
use crate::engine::phonons::displaced;
use crate::world::recipe::Phonons;
use crate::world::specimen::{DISPLACED_NM, Region, Specimen};

/// Displaced atoms of an area.
#[derive(Debug, Default)]
pub struct DisplacedAtoms {
    /// The atoms where they are, in Angstrom from the area's corner.
    pub sites: Vec<Site>,
    /// Their mean heights, which decide where slices are cut.
    pub heights: Vec<f64>,
}

/// The atoms of `area` in phonon configuration `configuration` of a mosaic, displaced, in Angstrom from the
/// area's corner: those of units with a place in the library move as in the sheets that their images
/// come from, others as in all engines.
pub fn definite_atoms(
    specimen: &dyn Specimen,
    library: Option<&Library>,
    area: &Region,
    (seed, configuration): (u64, usize),
    phonons: &Phonons,
) -> DisplacedAtoms {
    // A displaced atom may lie on the other side of the edge than its column.
    let sites = specimen.query(&area.grown(DISPLACED_NM));
    let mut atoms = DisplacedAtoms::default();
    for column in &sites.columns {
        let single = library.zip(column.unit).and_then(|(library, tag)| {
            let shelf = library.shelf(tag.family)?;
            let singles = shelf.singles(tag.entry, (seed, tag.id), library.configurations());
            Some((tag, shelf, singles[configuration]))
        });
        for (n, site) in sites.sites[column.sites.clone()].iter().enumerate() {
            let [x, y, _] = site.position_nm;
            let atom = site.atom([area.x[0], area.y[0]], phonons);
            let Some(atom) = atom.filter(|_| area.contains([x, y])) else { continue };
            let (mean, sigma) = (atom.position, atom.sigma_angstrom);
            let position = match &single {
                Some((tag, shelf, single)) => {
                    let [a, b, c] = shelf.displacement(*single, tag.member, n);
                    let [u, v] = tag.frame;
                    let moved = [u[0] * a + u[1] * b, v[0] * a + v[1] * b, c];
                    std::array::from_fn(|k| mean[k] + sigma * moved[k])
                }
                None => displaced(&atom, seed, configuration as u32),
            };
            atoms.sites.push(Site { position, sigma_angstrom: 0.0, ..atom });
            atoms.heights.push(mean[2]);
        }
    }
    atoms
}
