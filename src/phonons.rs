//! Frozen phonons: the Einstein model.

use crate::engine::Site;
use crate::rng::{Purpose, normal3};

/// Where the atom of `site` is in phonon configuration `configuration`: its mean position plus
/// independent normal displacements of each Cartesian component. A pure function of
/// (seed, configuration, key).
pub fn displaced(site: &Site, seed: u64, configuration: u32) -> [f64; 3] {
    if site.sigma_angstrom == 0.0 {
        return site.position;
    }
    let n = normal3(seed, Purpose::Phonon, configuration, site.key);
    std::array::from_fn(|i| site.position[i] + site.sigma_angstrom * n[i])
}
