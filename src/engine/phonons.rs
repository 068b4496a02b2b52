//! Frozen phonons in the Einstein model: every atom vibrates independently of the others.

use crate::rng::{Purpose, normal3};
use crate::structure::Site;

/// Position (x, y, z) in Angstrom of the atom of `site` in phonon configuration `configuration`: its mean position plus
/// a normal displacement, whose Cartesian components are independent if the site has no anisotropy. The random numbers are a function of
/// (seed, configuration, key) alone.
pub fn displaced(site: &Site, seed: u64, configuration: u32) -> [f64; 3] {
    if site.sigma_angstrom == 0.0 {
        return site.position;
    }
    let n = normal3(seed, Purpose::Phonon, configuration, site.key);
    let n = site.anisotropy.map_or(n, |anisotropy| anisotropy.displacement(n));
    std::array::from_fn(|i| site.position[i] + site.sigma_angstrom * n[i])
}
