//! The atoms of a world, configuration by configuration.

use super::library::Library;
use crate::engine::Site;
use crate::phonons::displaced;
use crate::world::recipe::Phonons;
use crate::world::specimen::{DISPLACED_NM, Region, SiteKind, Specimen};

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
            let [x, y, z] = site.position_nm;
            if site.kind == SiteKind::Vacancy || !area.contains([x, y]) {
                continue;
            }
            let mean = [10.0 * (x - area.x[0]), 10.0 * (y - area.y[0]), 10.0 * z];
            let still =
                Site { position: mean, number: site.number, sigma_angstrom: 0.0, key: site.key };
            let sigma = phonons.sigma_angstrom(site.number);
            let position = match &single {
                Some((tag, shelf, single)) => {
                    let [a, b, c] = shelf.displacement(*single, tag.member, n);
                    let [u, v] = tag.frame;
                    let moved = [u[0] * a + u[1] * b, v[0] * a + v[1] * b, c];
                    std::array::from_fn(|k| mean[k] + sigma * moved[k])
                }
                None => {
                    let site = Site { sigma_angstrom: sigma, ..still };
                    displaced(&site, seed, configuration as u32)
                }
            };
            atoms.sites.push(Site { position, ..still });
            atoms.heights.push(mean[2]);
        }
    }
    atoms
}
