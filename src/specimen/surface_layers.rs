//! Amorphous carbon on the faces of a specimen.
//!
//! The layers are no part of a [`Specimen`](super::Specimen), whose sites are the ground truth. They stand before and behind it, and
//! imaging adds their atoms.

use super::specimen_trait::ThinFilm;
use crate::engine::Site;
use crate::lengths;
use crate::models::carbon::block::atoms_per_nm2;
use crate::models::carbon::carbon_film::{Film, FilmAtom};
use crate::models::carbon::network::CARBON;
use crate::potential::slices::GROUP_ANGSTROM;
use crate::recipe::{Recipe, Region};
use crate::rng::{Purpose, words};

/// Distance in Angstrom from the outermost plane of the specimen to the carbon: between a bond and the layer distance of graphite.
const CONTACT_ANGSTROM: f64 = 2.0;
/// Bits in the keys of the atoms of the layers before and behind the specimen, which no other keys have.
const KEYS: [u64; 2] = [1 << 62, 1 << 61];
/// Edge in nm along y of the parts in which a layer is listed.
const PART_NM: f64 = 13.0;
/// Number of the draw that gives each layer a seed.
const SEED: u32 = 16;

/// A layer of carbon.
pub struct CarbonLayer {
    film: Film,
    key: u64,
    sigma_angstrom: f64,
    /// First and last depth along the beam, in Angstrom from the specimen's entrance face: negative before it.
    pub depth_angstrom: [f64; 2],
}

/// The layers on both faces.
pub struct SurfaceLayers {
    layers: Vec<CarbonLayer>,
    /// Distances in Angstrom from the first face to the specimen's entrance face, and from there to the last face.
    extent: [f64; 2],
}

impl SurfaceLayers {
    /// Returns the layers of a recipe on a specimen of this thickness, if it has any.
    pub fn of(recipe: &Recipe, thickness_nm: f64) -> Option<Self> {
        let table = recipe.surface?;
        let thickness = lengths::angstrom(thickness_nm);
        let [before, behind] = lengths::angstrom([table.entrance_nm, table.exit_nm]);
        let depths = [
            [-CONTACT_ANGSTROM - before, -CONTACT_ANGSTROM],
            [thickness + CONTACT_ANGSTROM, thickness + CONTACT_ANGSTROM + behind],
        ];
        let layer = |face: usize| {
            let depth_angstrom = depths[face];
            let [high, low, ..] = words(recipe.seed, Purpose::Carbon, SEED, face as u64);
            let film = Film::new(
                u64::from(high) << 32 | u64::from(low),
                depth_angstrom[1] - depth_angstrom[0],
            );
            CarbonLayer {
                film,
                key: KEYS[face],
                sigma_angstrom: table.sigma_angstrom,
                depth_angstrom,
            }
        };
        let there = [before > 0.0, behind > 0.0];
        let layers: Vec<CarbonLayer> = (0..2).filter(|face| there[*face]).map(layer).collect();
        let extent = [
            if there[0] { -depths[0][0] } else { 0.0 },
            if there[1] { depths[1][1] } else { thickness },
        ];
        (!layers.is_empty()).then_some(SurfaceLayers { layers, extent })
    }

    /// Returns the layers in the order of the beam.
    pub fn layers(&self) -> &[CarbonLayer] {
        &self.layers
    }

    /// Returns the layers in parts of a region, in the order of lists of atoms: layer by layer, from the top of the region down.
    pub fn parts(&self, region: &Region) -> Vec<(&CarbonLayer, Region)> {
        let [top, bottom] = region.y;
        let count = ((bottom - top) / PART_NM).ceil().max(1.0) as usize;
        let edge = |n: usize| top + (bottom - top) * n as f64 / count as f64;
        let part = |n: usize| Region { x: region.x, y: [edge(n), edge(n + 1)] };
        self.layers.iter().flat_map(|layer| (0..count).map(move |n| (layer, part(n)))).collect()
    }

    /// Returns the distance in Angstrom from the face that the beam enters to the face of the specimen.
    pub fn before_angstrom(&self) -> f64 {
        self.extent[0]
    }

    /// Returns the thickness of specimen and layers in Angstrom.
    pub fn thickness_angstrom(&self) -> f64 {
        self.extent[0] + self.extent[1]
    }

    /// Returns the thickness of specimen and layers in nm.
    pub fn thickness_nm(&self) -> f64 {
        lengths::nm(self.thickness_angstrom())
    }
}

impl CarbonLayer {
    /// Estimates the number of atoms in an area.
    pub(crate) fn estimated_atoms(&self, area: &Region) -> u64 {
        let [width, height] = [area.x, area.y].map(|[low, high]| high - low);
        let [begin, end] = self.depth_angstrom;
        (atoms_per_nm2(lengths::nm(end - begin)) * width * height).round() as u64
    }

    /// Returns the height in Angstrom of the slice of an atom at `z_angstrom`. The layer is divided into equal slices, as thick as in any
    /// specimen without planes.
    pub fn slice_height_angstrom(&self, z_angstrom: f64) -> f64 {
        let depth_nm = lengths::nm(self.depth_angstrom);
        let atoms_per_nm2 = atoms_per_nm2(depth_nm[1] - depth_nm[0]);
        let film = ThinFilm { number: CARBON, depth_nm, atoms_per_nm2, other_keys: 0 };
        film.slice_height_angstrom(z_angstrom, GROUP_ANGSTROM)
    }

    /// Returns the atoms in an area at their mean positions, in Angstrom from the area's corner and from the specimen's entrance face.
    pub fn atoms(&self, area: &Region) -> Vec<Site> {
        let [x, y] = lengths::angstrom([area.x, area.y]);
        let site = |atom: FilmAtom| Site {
            position: [
                atom.position[0] - x[0],
                atom.position[1] - y[0],
                atom.position[2] + self.depth_angstrom[0],
            ],
            number: CARBON,
            sigma_angstrom: self.sigma_angstrom,
            anisotropy: None,
            key: self.key | atom.key,
        };
        self.film.atoms(&[x, y]).into_iter().map(site).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{Override, Recipe};

    fn layers(changes: &[&str]) -> Option<SurfaceLayers> {
        let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
        let recipe = Recipe::load("test", None).unwrap().with_overrides(&changes).unwrap();
        SurfaceLayers::of(&recipe, 4.0)
    }

    #[test]
    fn layers_have_their_thickness_density_and_place() {
        assert!(layers(&[]).is_none() && layers(&["surface.exit_nm=0"]).is_none());
        let both = layers(&["surface.entrance_nm=1.5", "surface.exit_nm=0.8"]).unwrap();
        assert_eq!(both.before_angstrom(), 17.0);
        assert_eq!(both.thickness_angstrom(), 17.0 + 40.0 + 10.0);
        let area = Region { x: [1.0, 13.0], y: [2.0, 17.0] };
        let mut keys = std::collections::HashSet::new();
        for (layer, [from, to]) in both.layers().iter().zip([[-17.0, -2.0], [42.0, 50.0]]) {
            let atoms = layer.atoms(&area);
            let inside = |s: &Site| {
                let [x, y, z] = s.position;
                (0.0..120.0).contains(&x) && (0.0..150.0).contains(&y) && (from..=to).contains(&z)
            };
            assert!(atoms.iter().all(inside));
            // 2.0 g/cm3 are 0.1003 atoms per cubic Angstrom
            let expected = 0.1003 * 120.0 * 150.0 * (to - from);
            assert!((atoms.len() as f64 / expected - 1.0).abs() < 0.06, "{}", atoms.len());
            assert!((layer.estimated_atoms(&area) as f64 / expected - 1.0).abs() < 0.001);
            keys.extend(atoms.iter().map(|s| s.key));
            let mine = both.parts(&area).into_iter().filter(|(l, _)| l.key == layer.key);
            let in_parts = mine.flat_map(|(l, part)| l.atoms(&part)).map(|s| s.key);
            let all: std::collections::HashSet<u64> = in_parts.collect();
            assert_eq!(all, atoms.iter().map(|s| s.key).collect());
        }
        let count: usize = both.layers().iter().map(|l| l.atoms(&area).len()).sum();
        assert_eq!(keys.len(), count);
    }
}
