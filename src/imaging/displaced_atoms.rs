//! The displaced atoms of a field in each phonon configuration.

use crate::engine::Site;
use crate::engine::phonons::displaced;
use crate::recipe::region::Region;
use crate::recipe::tables::PhononTable;
use crate::specimen::atom_columns::AtomColumn;
use crate::specimen::sites::DISPLACED_NM;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::surface_layers::SurfaceLayers;

/// Displaced atoms of an area.
#[derive(Debug, Default)]
pub struct DisplacedAtoms {
    /// Displaced positions in Angstrom from the area's corner.
    pub sites: Vec<Site>,
    /// Mean heights of the atoms in Angstrom. They decide where slices are cut.
    pub heights: Vec<f64>,
}

/// The atoms of an area at their mean positions, in Angstrom from its corner.
pub fn mean_atoms(specimen: &dyn Specimen, area: &Region, phonons: &PhononTable) -> Vec<Site> {
    let corner = [area.x[0], area.y[0]];
    // A site may lie on the other side of the area's edge than its column.
    let mut sites = specimen.sites(&area.grown(DISPLACED_NM));
    sites.retain(|s| area.contains([s.position_nm[0], s.position_nm[1]]));
    sites.iter().filter_map(|s| s.atom(corner, phonons)).collect()
}

/// A phonon configuration, which with the key of an atom decides the displacement of the atom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrozenPhonons {
    /// Seed of the recipe.
    pub seed: u64,
    /// Number of the configuration.
    pub configuration: usize,
}

impl FrozenPhonons {
    fn displaced(self, atom: &Site) -> [f64; 3] {
        displaced(atom, self.seed, self.configuration as u32)
    }
}

/// The atoms of `area` in a phonon configuration.
pub(crate) fn displaced_by_seed(
    specimen: &dyn Specimen,
    area: &Region,
    which: FrozenPhonons,
    phonons: &PhononTable,
) -> DisplacedAtoms {
    displaced_atoms(specimen, area, which, phonons, |_| None::<fn(usize) -> [f64; 3]>)
}

/// Displaces atoms as [`displaced_by_seed`] does, except in columns for which `of_column` gives displacements: it returns the displacement
/// of the column's n-th site, in standard deviations along the axes of the field.
pub(crate) fn displaced_atoms<M: Fn(usize) -> [f64; 3]>(
    specimen: &dyn Specimen,
    area: &Region,
    which: FrozenPhonons,
    phonons: &PhononTable,
    of_column: impl Fn(&AtomColumn) -> Option<M>,
) -> DisplacedAtoms {
    // A displaced atom may lie on the other side of the edge than its column.
    let sites = specimen.query(&area.grown(DISPLACED_NM));
    let mut atoms = DisplacedAtoms::default();
    for column in &sites.columns {
        let moved = of_column(column);
        for (n, site) in sites.sites[column.sites.clone()].iter().enumerate() {
            let [x, y, _] = site.position_nm;
            let atom = site.atom([area.x[0], area.y[0]], phonons);
            let Some(atom) = atom.filter(|_| area.contains([x, y])) else { continue };
            let (mean, sigma) = (atom.position, atom.sigma_angstrom);
            let position = match &moved {
                Some(moved) => {
                    let moved = moved(n);
                    std::array::from_fn(|k| mean[k] + sigma * moved[k])
                }
                None => which.displaced(&atom),
            };
            atoms.sites.push(Site { position, sigma_angstrom: 0.0, ..atom });
            atoms.heights.push(mean[2]);
        }
    }
    atoms
}

/// Adds the atoms of the layers on the faces to the atoms of a specimen's area. Heights are in Angstrom from the face that the beam enters
/// first. A beam that moves by `slope` (x, y) per Angstrom of depth meets the specimen at the places where it would meet it without layers.
pub(crate) fn with_layers(
    layers: &SurfaceLayers,
    mut atoms: DisplacedAtoms,
    area: &Region,
    which: FrozenPhonons,
    slope: [f64; 2],
) -> DisplacedAtoms {
    for layer in layers.layers() {
        for atom in layer.atoms(area) {
            let position = which.displaced(&atom);
            atoms.heights.push(layer.slice_height_angstrom(atom.position[2]));
            atoms.sites.push(Site { position, sigma_angstrom: 0.0, ..atom });
        }
    }
    let down = layers.before_angstrom();
    let way = [slope[0] * down, slope[1] * down, down];
    for site in &mut atoms.sites {
        site.position = [0, 1, 2].map(|k| site.position[k] + way[k]);
    }
    atoms.heights.iter_mut().for_each(|z| *z += down);
    atoms
}
